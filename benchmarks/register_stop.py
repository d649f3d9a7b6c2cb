"""Measures the stop time of a target of `mavfi inject`, by length of walk; `--write` updates the page.

The target is a Python program that computes without system calls; ROS is not required.  A null fault performs every
operation except the flip.  Run as `.venv/bin/python -m benchmarks.register_stop [--injections 300] [--write]`.
"""

import argparse
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np

from mavfi.extras.registers import inject
from mavfi.extras.registers.fault import DEFAULT_WALK, RegisterFault
from tools.markers import between

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "registers.md"
TARGET = "import math\nprint(flush=True)\nx = 0.0\nwhile True:\n    x = math.sin(x) + 1.0"
WALKS = (1, DEFAULT_WALK // 2, DEFAULT_WALK, 2 * DEFAULT_WALK)
REGISTERS = ("all", "general", "fp")


def stops(pid: int, registers: str, walk: int, count: int) -> tuple[np.ndarray, int]:
    """Stop time of the target at each injection (ms, shape (count,)), and number of distinct instructions."""
    found = inject(pid, RegisterFault(registers, "either", walk=walk, null=True, timeout=30.0), count)
    stopped = [injection.details["stopped_us"] for injection in found]
    return 1e-3 * np.array(stopped), len({injection.details["address"] for injection in found})


def measure(count: int) -> str:
    """The table: median, 95 % quantile and maximum, and number of distinct injected instructions."""
    lines = [
        "| registers | `--walk` | p50 (ms) | p95 (ms) | max (ms) | instructions injected |",
        "|---|---|---|---|---|---|",
    ]
    with subprocess.Popen([sys.executable, "-c", TARGET], stdout=subprocess.PIPE) as target:
        try:
            assert target.stdout is not None
            target.stdout.readline()
            for registers in REGISTERS:
                for walk in WALKS:
                    found, places = stops(target.pid, registers, walk, count)
                    times = " | ".join(f"{value:.2f}" for value in (*np.quantile(found, (0.5, 0.95)), found.max()))
                    lines.append(f"| {registers} | {walk} | {times} | {places} |")
        finally:
            target.kill()
    return "\n".join(lines)


def main() -> None:
    """Print the table, and write it on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--injections", type=int, default=300, help="for each row")
    parser.add_argument("--write", action="store_true", help="put the table into docs/reference/registers.md")
    given = parser.parse_args()
    busy = os.getloadavg()[0]
    where = f"{given.injections} injections each; {os.cpu_count()} cores, load {busy:.1f}, Linux {platform.release()}"
    block = f"{measure(given.injections)}\n\n{where}."
    print(block)
    if given.write:
        PAGE.write_text(between(PAGE.read_text(encoding="utf-8"), "stop", block), encoding="utf-8")


if __name__ == "__main__":
    main()
