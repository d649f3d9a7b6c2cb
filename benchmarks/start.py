"""How long commands take from invocation to exit: the first flight on a machine, later ones, and help.

Each figure is the shortest of a few runs on the wall.  Next to a later flight stands, from the same run, a program that
does nothing but import the libraries which every flight needs.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence

from benchmarks.rows import Row
from mavfi.cli.commands import VERBS

_FLIGHT = ("fly", "--environment", "sparse", "--seed", "7", "--json")
_FAULT = ("--fault", "instruction:octomap", "--fault-seed", "3")
_LIBRARIES = "import mujoco, numba, pydantic, rich, typer"
_REPEATS = 5
FIRST_S = 15.0
FIRST_FAULT_S = 8.0
WARM_S = 1.3
HELP_S = 0.25
"""Targets on an idle machine with two cores (s)."""


def seconds(words: Sequence[str], variables: Mapping[str, str]) -> float:
    """Wall time of a Python program (s), given by the words after `python`."""
    start = time.perf_counter()
    subprocess.run([sys.executable, *words], check=True, capture_output=True, env=os.environ | dict(variables))
    return time.perf_counter() - start


def mavfi_seconds(words: Sequence[str], variables: Mapping[str, str], repeats: int = _REPEATS) -> float:
    """Shortest wall time of some runs of a command (s)."""
    return min(seconds(("-m", "mavfi", *words), variables) for _ in range(repeats))


def start_rows() -> list[Row]:
    """Times of commands, with their targets."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        cache = {"XDG_CACHE_HOME": folder}
        first = mavfi_seconds(_FLIGHT, cache, repeats=1)
        rows.append(Row("mavfi fly, empty cache", f"{first:.1f} s", first, FIRST_S, at_most=True))
        fault = mavfi_seconds((*_FLIGHT, *_FAULT), cache, repeats=1)
        rows.append(
            Row(
                "mavfi fly --fault instruction:octomap, the first", f"{fault:.1f} s", fault, FIRST_FAULT_S, at_most=True
            )
        )
        settings: dict[str, dict[str, str]] = {
            "mavfi fly, prompt to prompt, warm cache": {},
            "the same with PYTHONDONTWRITEBYTECODE=1": {"PYTHONDONTWRITEBYTECODE": "1"},
        }
        for name, variables in settings.items():
            libraries = min(seconds(("-c", _LIBRARIES), variables) for _ in range(_REPEATS))
            warm = mavfi_seconds(_FLIGHT, cache | variables)
            text = f"{warm:.2f} s, {warm / libraries:.1f} x the import of its libraries"
            rows.append(Row(name, text, warm, WARM_S, at_most=True))
        slowest, command = max((mavfi_seconds((verb, "--help"), cache), verb) for verb in VERBS)
        overview = mavfi_seconds(("--help",), cache)
        rows.append(Row("mavfi --help", f"{overview:.2f} s", overview, HELP_S, at_most=True))
        rows.append(
            Row("slowest help of a command of the core", f"{slowest:.2f} s ({command})", slowest, HELP_S, at_most=True)
        )
    return rows


def main() -> None:
    """Measure and print."""
    for row in start_rows():
        sys.stdout.write(f"{row.what:60s} {row.value}  {row.verdict}\n")
    load = ", ".join(f"{value:.2f}" for value in os.getloadavg())
    sys.stdout.write(f"load {load}\n")


if __name__ == "__main__":
    main()
