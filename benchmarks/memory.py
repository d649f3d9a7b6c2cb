"""Memory of a worker over many flights: flat, or does it grow?

    python -m benchmarks.memory [--flights 1500] [--injections 300]

One worker flies the short missions of two campaigns, one with faults in states, one with faults in instructions.  It
reads its resident memory at the begin of each mission, when that of the last one is free.  Growth is the slope of a
straight line through the second half: caches fill in the first.
"""

import argparse
import os
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.executor import Lost
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.mission import Flown, MissionPlan, fly_mission
from mavfi.errors import MavfiError

MOST_GROWTH_KIB = 1024.0
"""Growth that is no leak (KiB per 100 runs): pages of the heap that cannot be returned, as a part of them is in use."""
_SHORT = {"start": [2.0, 0.0, 3.0], "goal": [9.0, 0.0, 3.0]}
_LEVELS: dict[str, dict[str, Any]] = {
    "state": {"sampling": {"level": "state"}},
    "instruction": {"sampling": {"level": "instruction", "kernels": ["pid", "point_cloud", "rrt_connect"]}},
}
_MISSIONS = {"state": 60, "instruction": 30}
_LINES = 12


@dataclass(frozen=True, slots=True)
class Look:
    """A worker at an instant."""

    runs: int  # since it began
    memory_kib: float  # resident
    peak_kib: float  # largest resident memory so far


def campaign_of(level: str, runs: int) -> Campaign:
    """Short missions with about so many runs with a fault."""
    faults = max(1, runs // 3)  # of each of three stages or kernels
    missions = min(_MISSIONS[level], faults)
    content = {"name": level, "environments": ["sparse"], "first_seed": 7, "mission": _SHORT, "null_runs": 0}
    return Campaign.model_validate({**content, **_LEVELS[level], "missions": missions, "faults": faults})


def fly(campaign: Campaign) -> list[Look]:
    """Fly a campaign with one worker; what it had at the begin of each mission."""
    missions = [MissionPlan(campaign, *place) for place in product(campaign.environments, campaign.seeds)]
    seen: list[Look] = []
    runs = 0
    for item in (item for _, items in LocalExecutor(1).map(_fly, missions) for item in items):
        match item:
            case Lost():
                raise MavfiError(item.reason)
            case int():
                runs += item
            case (float(memory), float(peak)):
                seen.append(Look(runs, memory, peak))
    return seen


def _fly(mission: MissionPlan) -> Iterator[tuple[float, float] | int]:
    """Memory before a mission, now and at its largest (KiB), and the number of its runs."""
    yield resident_kib(os.getpid()), float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    yield sum(isinstance(item, Flown) for item in fly_mission(mission))


def resident_kib(pid: int) -> float:
    """Resident memory of a process (KiB); 0 = it is gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1024
    except OSError:
        return 0.0


def growth(seen: Sequence[Look]) -> float:
    """Slope over the second half (KiB per 100 runs)."""
    half = seen[len(seen) // 2 :]
    slope: float = np.polyfit([look.runs for look in half], [look.memory_kib for look in half], 1)[0]
    return 100 * slope


def main() -> int:
    """Fly, and tell."""
    parser = argparse.ArgumentParser(description="Measure the memory of a worker over many flights.")
    parser.add_argument("--flights", type=int, default=1500, help="with a fault in a state")
    parser.add_argument("--injections", type=int, default=300, help="with a fault in an instruction")
    given = parser.parse_args()
    grows = False
    for level, runs in (("state", given.flights), ("instruction", given.injections)):
        if runs < 1:
            continue
        start = time.perf_counter()
        seen = fly(campaign_of(level, runs))
        print(f"{level}: {len(seen)} missions in {time.perf_counter() - start:.0f} s")
        print(f"{'runs':>8} {'memory MiB':>11} {'peak MiB':>10}")
        for look in [*seen[: -1 : max(1, len(seen) // _LINES)], seen[-1]]:
            print(f"{look.runs:>8} {look.memory_kib / 1024:>11.1f} {look.peak_kib / 1024:>10.1f}")
        found = growth(seen)
        grows |= found > MOST_GROWTH_KIB
        print(f"growth in the second half: {found:.0f} KiB per 100 runs; allowed: {MOST_GROWTH_KIB:.0f}")
    return 1 if grows else 0


if __name__ == "__main__":
    sys.exit(main())
