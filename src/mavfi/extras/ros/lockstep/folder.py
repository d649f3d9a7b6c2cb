"""The folder of a flight: files, environment, and the script `join` with which another terminal joins the ROS graph."""

import fcntl
import io
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import MachineError, MavfiError
from mavfi.extras.ros.lockstep.transport import Middleware
from mavfi.record import Injection, Profile

FOLDER_VARIABLE = "MAVFI_ROS_FLIGHT"
"""Environment variable: folder of the flight to which a node belongs."""
LOG = "log"
JOIN = "join"
PID = "pid"
FLIGHT = "flight.npz"
PROFILE = "profile.npz"
FAILURE = "failure.txt"
TIMES = "times.json"
INJECTIONS = "injections.json"
_PREFIX = "mavfi-ros-"
_OWNER = "owner"


def flight_folder() -> Path:
    """Folder of the flight to which this process belongs."""
    return Path(os.environ[FOLDER_VARIABLE])


@contextmanager
def new_folder() -> Iterator[Path]:
    """Create the folder of a flight, which is removed at its end; one with the logs of a failed flight remains.

    Folders of processes that were killed are removed, too: nobody holds the lock of their owner.

    Raises:
        MavfiError: As in the context, with the folder of the logs.
    """
    for owner in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*/{_OWNER}"):
        with suppress(OSError), owner.open() as file:  # in use, of another user, or being removed
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            remove_folder(owner.parent)
    folder = Path(tempfile.mkdtemp(prefix=_PREFIX))
    with (folder / f"new-{_OWNER}").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        os.rename(file.name, folder / _OWNER)  # never seen without its lock
        try:
            yield folder
        except BaseException as error:
            if isinstance(error, MavfiError) and not isinstance(error, MachineError):
                (folder / _OWNER).unlink()
                raise MavfiError(f"{error}; logs: {folder / LOG}") from None
            remove_folder(folder)
            raise
        remove_folder(folder)


def remove_folder(folder: Path) -> None:
    """Remove the folder of a flight, its owner last: if that is cut short, the next flight removes the rest."""
    with suppress(OSError):
        for path in folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != _OWNER:
                path.unlink()
    shutil.rmtree(folder, ignore_errors=True)


def write_file(name: str, content: bytes) -> None:
    """Write a file of the flight's folder atomically."""
    part = flight_folder() / f"part-{name}"
    part.write_bytes(content)
    part.rename(flight_folder() / name)


def write_profile(profile: Profile) -> None:
    """Write the profile of the flight."""
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {f"t:{name}": times for name, times in profile.times_us.items()}
    arrays |= {f"n:{name}": counts for name, counts in profile.counts.items()}
    np.savez_compressed(buffer, **arrays)
    write_file(PROFILE, buffer.getvalue())


def read_profile(folder: Path) -> Profile:
    """The profile of the flight of a folder."""
    with np.load(folder / PROFILE) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return Profile(
        {name[2:]: array for name, array in arrays.items() if name.startswith("t:")},
        {name[2:]: array for name, array in arrays.items() if name.startswith("n:")},
    )


def write_injections(injections: list[Injection]) -> None:
    """Save the injections so far: the injector's node may be restarted, and must not inject again."""
    write_file(INJECTIONS, json.dumps([injection.to_json() for injection in injections]).encode())


def read_injections() -> list[Injection]:
    """The injections so far."""
    path = flight_folder() / INJECTIONS
    if path.exists():
        return [Injection.from_json(done) for done in json.loads(path.read_text())]
    return []


def environment(folder: Path, middleware: Middleware) -> dict[str, str]:
    """Environment of all programs of a flight."""
    return {
        **os.environ,
        **middleware.variables(folder),
        FOLDER_VARIABLE: str(folder),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONUNBUFFERED": "1",
    }


def write_join(folder: Path, middleware: Middleware, command: list[str]) -> None:
    """Write the script `join`, which enters the namespaces that a command of `private_network` made, if any."""
    prefix = ""
    if command:
        enter = "--net --mount"
        if "-Urnm" in command:
            enter = "--user --preserve-credentials --net --mount"
        prefix = f'nsenter --target "$(cat \'{folder / PID}\')" {enter} --wdns="$PWD" '
    exports = " ".join(f"{name}='{value}'" for name, value in middleware.variables(folder).items())
    path = folder / JOIN
    path.write_text(f'#!/bin/sh\nexec {prefix}env {exports} "$@"\n')
    path.chmod(0o755)
