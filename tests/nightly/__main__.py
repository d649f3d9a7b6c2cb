"""Tests that take minutes to hours: at full size here, small among the others.  Writes docs/results/reliability.md.

make nightly        (SHARE=0.1 = a tenth of the tries; ONLY="chaos damage")
"""

import csv
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from mavfi.analysis.table import Table
from mavfi.extras.ros.ros2.environment import installations
from tools import results
from tools.markers import ROOT

PAGE = "reliability"
HEADINGS = ("test", "asks", "tries", "result", "minutes", "date", "last line")
TEXT = (
    "Long tests of ledgers, workers and readers: none found a wrong ledger, a damaged one that was read as sound, or a "
    "file that was neither read nor refused. Short versions run with `make test`. What they found, and what "
    "became of it: [reliability](../concepts/reliability.md)."
)
Row = dict[str, str]


@dataclass(frozen=True)
class Long:
    """A test that takes minutes to hours."""

    name: str
    tries: int
    unit: str
    asks: str
    part: str = ""
    """Part of the module that is run; empty = all of it."""
    marker: str = ""
    """Tests of pytest with this marker; empty = a module of this package, named like the test."""

    def command(self) -> list[str]:
        """Arguments of Python that run the test."""
        if self.marker:
            options = ["-rfEs", "-n", str(os.cpu_count()), "--dist=worksteal", "--hypothesis-profile=night"]
            return ["-m", "pytest", *options, "-m", self.marker]
        return ["-m", f"tests.nightly.{self.name.partition('-')[0]}"]


TESTS = (
    Long(
        "chaos",
        500,
        "signals",
        "Do campaigns that are killed, hung up and stopped leave the ledger of undisturbed ones?",
    ),
    Long("chaos-ros", 100, "signals", "Do campaigns on ROS, treated like that?", "ros"),
    Long("failures", 200, "failures", "Is a disk that is full, or a lack of memory or file handles, ever a result?"),
    Long("damage", 1000, "flipped bits and other damage", "Is a damaged ledger ever read as a sound one?"),
    Long(
        "tracers", 200, "kills of each of two targets", "Does a process survive the death of who injects its registers?"
    ),
    Long("fuzz", 100_000, "inputs", "Does a file of a stranger do anything but be read, or be refused in one line?"),
    Long("storm", 100_000, "flipped bits", "Do kernels end, within their bounds, whatever is flipped in their memory?"),
    Long("nojit", 1, "run", "Do kernels pass their tests as plain Python, without the compiler?"),
    Long("machines", 1, "run", "Have flights and campaigns the same bits on every x86-64 machine?", marker="machines"),
    Long("properties", 1, "run", "Do properties hold for examples that were never tried?", marker="properties"),
    Long("settings", 1, "run", "Do tests pass in the settings that the short ones leave out?", marker="long"),
)


def run(test: Long, share: float) -> tuple[str, int, float]:
    """Run a test and show its output as it comes; returns it, the exit code and the duration (s)."""
    tries = max(1, round(test.tries * share))
    started = time.monotonic()
    environment = {key: value for key, value in os.environ.items() if key != "ONLY"}
    environment |= {"N": str(tries)} | ({"ONLY": test.part} if test.part else {})
    command = [sys.executable, *test.command()]
    output = ""
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout or ():
            sys.stdout.write(line)  # it takes hours
            sys.stdout.flush()
            output += line
    return output, process.returncode, time.monotonic() - started


def row_of(test: Long, share: float) -> Row:
    """Run a test; returns its row."""
    tries = max(1, round(test.tries * share))
    output, code, seconds = run(test, share)
    lines = [line.strip() for line in output.rstrip().splitlines() if "Done." not in line]
    return {
        "test": test.name,
        "asks": test.asks,
        "tries": f"{tries:,} {test.unit}",
        "result": "passed" if code == 0 else "FAILED",
        "minutes": f"{seconds / 60:.1f}",
        "date": str(date.today()),
        "last line": lines[-1] if lines else "",
    }


def _written() -> dict[str, Row]:
    """Rows of the existing table, by test."""
    path = results.TABLES / PAGE / "tests.csv"
    if not path.is_file():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        return {row["test"]: row for row in csv.DictReader(file)}


def write_page(rows: Mapping[str, Row]) -> Path:
    """Write the page from the rows of all tests."""
    full = Table.of_text(
        "Long tests", HEADINGS, [tuple(row[heading] for heading in HEADINGS) for row in rows.values()], []
    )
    shown = results.Excerpt("tests", columns=("asks", "tries", "result", "minutes"))
    return results.write(PAGE, "Reliability", TEXT, {"tests": full}, [shown])


def main() -> int:
    """Run the tests one after another, and write the page."""
    share = float(os.environ.get("SHARE") or "1")
    wanted = os.environ.get("ONLY", "").split()
    rows = {}
    for test in TESTS:
        if test.part == "ros" and not any(installations()):
            sys.stdout.write(f"{test.name}: ROS 2 is not installed\n")
        elif not wanted or test.name in wanted:
            sys.stdout.write(f"{test.name} ...\n")
            sys.stdout.flush()
            rows[test.name] = row_of(test, share)
    failed = [name for name, row in rows.items() if row["result"] == "FAILED"]
    if share == 1:  # a page shows full runs only
        page = write_page(_written() | rows)  # read now: another run may have written its own
        sys.stdout.write(f"wrote {page.relative_to(ROOT)}\n")
    sys.stdout.write(f"{len(failed)} of {len(rows)} failed\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
