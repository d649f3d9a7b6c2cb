"""Runs the long-running tests of ledgers, workers and readers, and writes docs/generated/reliability.md.

python -m tools.reliability        (SHARE=0.1 = a tenth of the tries; ONLY="chaos damage")
"""

import os
import subprocess
import sys
import time
from dataclasses import dataclass

from mavfi.hosts.ros1 import finder
from tools.markers import GENERATED, banner

PAGE = GENERATED / "reliability.md"
LAST_LINES = 24


@dataclass(frozen=True)
class Long:
    """A test that takes minutes to hours."""

    name: str
    tries: int
    unit: str
    asks: str
    only: str = ""

    @property
    def module(self) -> str:
        """Module of the test; `only` names a part of it."""
        return f"tests.robustness.{self.name.partition('-')[0]}"


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
)


def run(test: Long, share: float) -> tuple[str, int, float]:
    """Run a test and show its output as it comes; returns it, the exit code and the duration (s)."""
    tries = max(1, round(test.tries * share))
    started = time.monotonic()
    environment = {key: value for key, value in os.environ.items() if key != "ONLY"}
    environment |= {"N": str(tries)} | ({"ONLY": test.only} if test.only else {})
    command = [sys.executable, "-m", test.module]
    output = ""
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout or ():
            sys.stdout.write(line)  # it takes hours
            sys.stdout.flush()
            output += line
    return output, process.returncode, time.monotonic() - started


def section(test: Long, share: float) -> str:
    """The test's section of the page."""
    output, code, seconds = run(test, share)
    tries = max(1, round(test.tries * share))
    last_lines = "\n".join(f"    {line}" for line in output.rstrip().splitlines()[-LAST_LINES:] if "Done." not in line)
    return (
        f"## {test.name}: {'passed' if code == 0 else 'FAILED'}\n\n{test.asks} {tries:,} {test.unit} "
        f"(of {test.tries:,} in a full run), {seconds / 60:.1f} min.\n\n{last_lines}\n"
    )


def _written() -> dict[str, str]:
    """Sections of the existing page, by test."""
    text = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    parts = [f"## {part.rstrip()}\n" for part in text.split("\n## ")[1:]]
    return {part[3:].partition(":")[0]: part for part in parts}


def main() -> int:
    """Run the tests sequentially, and write the page."""
    share = float(os.environ.get("SHARE", "1"))
    wanted = os.environ.get("ONLY", "").split()
    sections = {}
    for test in TESTS:
        if test.only == "ros" and finder.missing():
            sys.stdout.write(f"{test.name}: ROS is not installed\n")
        elif not wanted or test.name in wanted:
            sys.stdout.write(f"{test.name} ...\n")
            sys.stdout.flush()
            sections[test.name] = section(test, share)
    sections = _written() | sections  # read now: another run may have written its own
    PAGE.write_text(
        banner("make reliability") + "# Reliability\n\nLong tests of ledgers, workers and readers, each with the last "
        "lines that it printed. Short versions of all run with `make test`. What they found, and what became of it: "
        "[reliability](../reliability.md).\n\n" + "\n".join(sections.values()),
        encoding="utf-8",
    )
    failed = [text for text in sections.values() if ": FAILED" in text]
    sys.stdout.write(f"wrote {PAGE.name}, {len(failed)} of {len(sections)} failed\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
