"""Leak test: injects a kernel many times in forked children, and checks that no resources remain allocated.

    python -m benchmarks.many_injections [N]

Sampled periodically: children not waited for, open files, memory of this process, and files in a private temporary
folder.  The faults are of all kinds, so that children terminate normally, by a signal, and by their instruction budget.
"""

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mavfi.levels import instruction
from mavfi.numerics.jit import kernel_jit

N = 100_000
LOOKS = 20
"""Number of samples."""
_FAULTS = 500
_GROWTH_KIB, _GROWTH_BYTES = 2_048, 256
"""Memory growth after the first sample that counts as a leak: absolute (KiB), and per injection (bytes).  A child's
report alone is longer; smaller growth is due to loaded pages that are touched for the first time."""


@kernel_jit
def walk(values: np.ndarray, steps: np.ndarray) -> float:
    """A kernel with addresses, branches and arithmetic: a sum along a chain of indices."""
    total, here = 0.0, 0
    for _ in range(len(steps)):
        here = steps[here]
        if values[here] > 0.0:
            total += values[here]
    return total


@dataclass(frozen=True, slots=True)
class Look:
    """Resources of this process at an instant.

    Attributes:
        injections: Number of injections so far.
        files: Open files of this process.
        children: Running children, and zombies not waited for.
        memory_kib: Resident memory (KiB).
        left_behind: Entries of the temporary folder.
    """

    injections: int
    files: int
    children: int
    memory_kib: int
    left_behind: int


def look(injections: int) -> Look:
    """Sample all resources."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    memory = pages * os.sysconf("SC_PAGE_SIZE") // 1024
    left = len(os.listdir(tempfile.gettempdir()))
    return Look(injections, len(os.listdir("/proc/self/fd")), children(), memory, left)


def children() -> int:
    """Number of children of this process, including zombies."""
    own = str(os.getpid())
    found = 0
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            found += entry.read_text().rpartition(")")[2].split()[1] == own
        except OSError:
            continue  # it exited during the scan
    return found


def inject_often(count: int, looks: int = LOOKS) -> tuple[Counter[str], list[Look]]:
    """Inject repeatedly; returns the outcomes, and samples taken before, periodically, and at the end.

    Args:
        count: Number of injections.
        looks: Number of periodic samples.
    """
    args = np.linspace(-1.0, 1.0, 64), np.random.default_rng(1).permutation(64)
    faults = instruction.draw(walk, _FAULTS, *args, seed=1)
    instruction.run_forked(walk, faults[0], *args)  # one-time loading is not a leak
    seen = [look(0)]
    outcomes: Counter[str] = Counter()
    every = max(1, count // looks)
    for number in range(1, count + 1):
        outcomes[instruction.run_forked(walk, faults[number % len(faults)], *args).how] += 1
        if number % every == 0 or number == count:
            seen.append(look(number))
    return outcomes, seen


def leaks(seen: list[Look]) -> list[str]:
    """Descriptions of the leaks found; empty if there is none."""
    first, settled, last = seen[0], seen[min(1, len(seen) - 1)], seen[-1]
    found = [f"{later.children} children at injection {later.injections}" for later in seen if later.children][:1]
    if last.files > first.files:
        found.append(f"open files: {first.files} before, {last.files} after")
    room = max(_GROWTH_KIB, _GROWTH_BYTES * (last.injections - settled.injections) // 1024)
    if last.memory_kib > settled.memory_kib + room:
        found.append(
            f"memory: {settled.memory_kib:,} KiB at injection {settled.injections}, {last.memory_kib:,} KiB after"
        )
    if last.left_behind > first.left_behind:
        found.append(f"temporary files: {first.left_behind} before, {last.left_behind} after")
    return found


def main() -> int:
    """Inject, and report."""
    parser = argparse.ArgumentParser(description="Inject a kernel often, and look for what is left behind.")
    parser.add_argument("count", nargs="?", type=int, default=N, help=f"number of injections (default {N:,})")
    count = parser.parse_args().count
    if count < 1:
        parser.error(f"{count}: allowed: 1 and more")
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["TMPDIR"] = tempfile.tempdir = folder
        outcomes, seen = inject_often(count)
        tempfile.tempdir = None
    wall = time.perf_counter() - start
    print(f"{count:,} injections in {wall:.0f} s: {', '.join(f'{n:,} {how}' for how, n in outcomes.most_common())}")
    print(f"{'injections':>10} {'children':>9} {'files':>6} {'memory KiB':>11} {'temporary files':>16}")
    for one in seen:
        print(f"{one.injections:>10,} {one.children:>9} {one.files:>6} {one.memory_kib:>11,} {one.left_behind:>16}")
    found = leaks(seen)
    print("left behind: " + ("; ".join(found) or "nothing"))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
