"""Memory of a worker over many flights: flat, or does it grow?

    python -m benchmarks.memory [--flights 1500] [--injections 300]

One worker flies two campaigns of short missions, one with faults in states, one with faults in instructions.  Its
resident memory is read at the begin of each mission, after the golden run, and at its largest.  Growth is the slope of
a straight line through the second half: caches fill in the first.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.run import Progress, run_campaign

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
    largest_kib: float  # so far


def campaign_of(level: str, runs: int) -> Campaign:
    """Short missions with about so many runs with a fault."""
    faults = max(1, runs // 3)  # of each of three stages or kernels
    missions = min(_MISSIONS[level], faults)
    content = {"name": level, "environments": ["sparse"], "first_seed": 7, "mission": _SHORT, "null_runs": 0}
    return Campaign.model_validate({**content, **_LEVELS[level], "missions": missions, "faults": faults})


def fly(campaign: Campaign, directory: Path) -> list[Look]:
    """Fly a campaign with one worker; what it had at the begin of each mission, after the golden run."""
    seen: list[Look] = []
    largest = 0.0

    def note(progress: Progress) -> None:
        nonlocal largest
        memory = max(map(resident_kib, children()), default=0.0)
        largest = max(largest, memory)
        if progress.settings.get("golden", (0, 0, 0))[1] > len(seen) and memory:
            seen.append(Look(progress.flown, memory, largest))

    run_campaign(campaign, directory, executor=LocalExecutor(1), progress=note)
    return seen


def children() -> list[int]:
    """Processes that this one has started."""
    return [
        int(word) for path in Path("/proc/self/task").glob("*/children") for word in path.read_text("ascii").split()
    ]


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
        with tempfile.TemporaryDirectory(prefix="mavfi-memory-") as folder:
            seen = fly(campaign_of(level, runs), Path(folder))
        print(f"{level}: {len(seen)} missions in {time.perf_counter() - start:.0f} s")
        print(f"{'runs':>8} {'memory MiB':>11} {'largest MiB':>12}")
        for look in [*seen[: -1 : max(1, len(seen) // _LINES)], seen[-1]]:
            print(f"{look.runs:>8} {look.memory_kib / 1024:>11.1f} {look.largest_kib / 1024:>12.1f}")
        found = growth(seen)
        grows |= found > MOST_GROWTH_KIB
        print(f"growth in the second half: {found:.0f} KiB per 100 runs; allowed: {MOST_GROWTH_KIB:.0f}")
    return 1 if grows else 0


if __name__ == "__main__":
    sys.exit(main())
