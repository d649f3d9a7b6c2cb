"""When, where and by which program a study was flown, kept in its folder: a resumed study adds to it."""

import json
import os
import platform
import subprocess
from datetime import UTC, datetime
from pathlib import Path

from mavfi.campaign.fingerprint import processor
from mavfi.errors import BadInputError, writing
from mavfi.files import make_folder
from mavfi.version import __version__

FILE = "runs.json"
"""Name of the file in the folder of a study."""


def load_runs(folder: Path) -> list[dict[str, str]]:
    """When each run of the command began (UTC), its machine and program; none if the folder has no file of them.

    Raises:
        BadInputError: The file is invalid.
    """
    path = folder / FILE
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        return [{key: str(run[key]) for key in ("begun", "machine", "program")} for run in stored]
    except FileNotFoundError:
        return []
    except (OSError, ValueError, KeyError, TypeError):
        raise BadInputError(f"{path}: does not list runs of a study; remove it") from None


def note_run(folder: Path, workers: int) -> None:
    """Add a run that begins now, on this machine."""
    begun = datetime.now(UTC).isoformat(" ", "seconds")
    where = f"{machine()}, {workers} worker{'s' * (workers != 1)}"
    runs = [*load_runs(folder), {"begun": begun, "machine": where, "program": program()}]
    path = folder / FILE
    new = folder / f".{FILE}"
    make_folder(folder)
    with writing(path):
        new.write_text(json.dumps(runs, indent=1) + "\n", "utf-8")
        os.replace(new, path)


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
    """The commit of the clone in a folder; "" if the folder is not a clone."""
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
