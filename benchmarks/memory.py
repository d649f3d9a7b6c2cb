"""Memory of a worker over many flights: tests for growth.

    python -m benchmarks.memory [--flights 1500] [--injections 300]

One worker flies the short missions of two campaigns, one with state faults, one with instruction faults.  It reads its
resident memory at the start of each mission, after the memory of the previous one is released.  Growth is the
interquartile mean of the increments between readings of the second half: caches fill in the first, and a single step of
the heap (measured: 7 MiB once in 1500 runs) is no leak, while a leak shows in most increments.
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
from scipy import stats

from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.executor import Lost
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.mission import MissionPlan, fly_mission
from mavfi.campaign.plan import CompletedRun
from mavfi.campaign.resolve import resolve
from mavfi.errors import MavfiError

MOST_GROWTH_KIB = 1024.0
"""Tolerated growth (KiB per 100 runs): fragmented heap pages that cannot be returned to the system."""
_SHORT = {"start": [2.0, 0.0, 3.0], "goal": [9.0, 0.0, 3.0]}
_LEVELS: dict[str, dict[str, Any]] = {
    "state": {"sampling": {"level": "state"}},
    "instruction": {"sampling": {"level": "instruction", "kernels": ["pid", "point_cloud", "rrt_connect"]}},
}
_MISSIONS = {"state": 60, "instruction": 30}
_LINES = 12
_TRIMMED = 0.25  # share of the increments left out at each end


@dataclass(frozen=True, slots=True)
class Look:
    """Resources of a worker at an instant."""

    runs: int  # runs so far
    memory_kib: float  # resident
    peak_kib: float  # peak resident memory so far


def campaign_of(level: str, runs: int) -> Campaign:
    """Campaign of short missions with approximately `runs` injected runs."""
    faults = max(1, runs // 3)  # per stage or kernel, of which there are three
    missions = min(_MISSIONS[level], faults)
    content = {"name": level, "environments": ["sparse"], "first_seed": 7, "mission": _SHORT, "null_runs": 0}
    return Campaign.model_validate({**content, **_LEVELS[level], "missions": missions, "faults": faults})


def fly(campaign: Campaign) -> list[Look]:
    """Fly a campaign with one worker; returns its memory at the start of each mission."""
    resolved = resolve(campaign)
    missions = [MissionPlan(resolved, *place) for place in product(campaign.environments, campaign.seeds)]
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
    """Memory before a mission, current and peak (KiB), then the number of its runs."""
    yield resident_kib(os.getpid()), float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    yield sum(isinstance(item, CompletedRun) for item in fly_mission(mission))


def resident_kib(pid: int) -> float:
    """Resident memory of a process (KiB); 0 = it has exited."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1024
    except OSError:
        return 0.0


def growth(seen: Sequence[Look]) -> float:
    """Growth over the second half: interquartile mean of the increments (KiB per 100 runs)."""
    half = seen[len(seen) // 2 :]
    increments = np.diff([look.memory_kib for look in half])
    runs_per_increment = (half[-1].runs - half[0].runs) / len(increments)
    return 100 * float(stats.trim_mean(increments, _TRIMMED)) / runs_per_increment


def main() -> int:
    """Fly, and report."""
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
