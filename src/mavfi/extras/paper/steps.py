"""Wall time of a study by step, and the machines that it ran on, kept in its folder: a resumed study adds to them."""

import json
import math
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

from mavfi.campaign.fingerprint import processor
from mavfi.errors import BadInputError, writing
from mavfi.files import make_folder
from mavfi.version import __version__

FILE = "steps.json"
"""Name of the file in the folder of a study."""
SET_UP = "set-up (make setup)"
"""The first step, which the Makefile times."""
FLIGHTS = "flights of all campaigns"
"""The step in which the campaigns fly, together."""
SET_UP_FILE = Path(sys.prefix) / "setup-seconds"
"""Written by `make setup` when it has made this virtual environment."""


@dataclass(frozen=True, slots=True)
class StepTimes:
    """Wall times (s) by step, and when and where each run of the command began."""

    folder: Path
    seconds: dict[str, float] = field(default_factory=dict)
    runs: list[dict[str, str]] = field(default_factory=list)  # "begun" (UTC), "machine" and "program"

    @staticmethod
    def load(folder: Path) -> "StepTimes":
        """The steps so far; without any if the folder has no file of them.

        Raises:
            BadInputError: The file is invalid.
        """
        path = folder / FILE
        try:
            stored = json.loads(path.read_text(encoding="utf-8"))
            seconds = {str(step): float(spent) for step, spent in stored["seconds"].items()}
            runs = [{key: str(run[key]) for key in ("begun", "machine", "program")} for run in stored["runs"]]
        except FileNotFoundError:
            return StepTimes(folder)
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            raise BadInputError(f"{path}: is not a file of wall times; remove it") from None
        return StepTimes(folder, seconds, runs)

    @staticmethod
    def begin(folder: Path, workers: int) -> "StepTimes":
        """The steps so far, and a new run on this machine; set-up counts once, as that of the first run."""
        steps = StepTimes.load(folder)
        spent = set_up_seconds()
        if spent is not None and SET_UP not in steps.seconds:
            steps = replace(steps, seconds={SET_UP: spent, **steps.seconds})
        begun = datetime.now(UTC).isoformat(" ", "seconds")
        where = f"{machine()}, {workers} worker{'s' * (workers != 1)}"
        steps.runs.append({"begun": begun, "machine": where, "program": program()})
        return steps

    @contextmanager
    def timed(self, step: str) -> Iterator[None]:
        """Add the wall time of a block to a step, and write the file, also if the block is interrupted."""
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[step] = self.seconds.get(step, 0.0) + time.perf_counter() - begun
            path = self.folder / FILE
            new = self.folder / f".{FILE}"
            make_folder(self.folder)
            with writing(path):
                new.write_text(json.dumps({"seconds": self.seconds, "runs": self.runs}, indent=1) + "\n", "utf-8")
                os.replace(new, path)


def set_up_seconds() -> float | None:
    """Wall time (s) in which `make setup` made this environment; None if it is unknown, or another way was taken."""
    try:
        spent = float(SET_UP_FILE.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # a damaged file is no reason not to fly: the time is unknown
        return None
    if 0 <= spent < math.inf:
        return spent
    return None


def machine() -> str:
    """This machine in words: processor, its number of cores, memory and system."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    system = f"{platform.system()} {platform.machine()}"
    return f"{processor()}, {os.cpu_count()} cores, {memory:.1f} GiB of memory, {system}"


def program() -> str:
    """This program in words: its version, and its commit if it runs in a clone."""
    commit = _commit(Path(__file__).parents[4])
    if commit:
        return f"mavfi {__version__}, commit {commit}"
    return f"mavfi {__version__}"


def _commit(root: Path) -> str:
    """The commit of the clone in a folder; "" if it is none."""
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "rev-parse", "--short=12", "HEAD"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError:
        return ""
    if result.returncode != 0:
        return ""
    return result.stdout.strip()
