"""Recordings of training flights on disk, kept until the models are saved, so that training can be resumed."""

import contextlib
import hashlib
import io
import json
import os
import shutil
from collections.abc import Iterable
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from mavfi.campaign.run import versions
from mavfi.detectors.recorder import Recording
from mavfi.errors import BadInputError
from mavfi.mission import Scenario

FOLDER = ".flights"
_PARTS = ("kinds", "times_us", "content")


class KeptRecordings:
    """Recordings by seed, in a subfolder named after what decides them: scenario, versions and code of mavfi.

    Args:
        folder: Of the models.
        scenario: Mission whose seed is the first one.
    """

    def __init__(self, folder: Path, scenario: Scenario) -> None:
        self._parent = folder / FOLDER
        self._folder = self._parent / _key(scenario)

    def load(self, seeds: Iterable[int]) -> dict[int, Recording]:
        """Recordings of these seeds; a file that cannot be read counts as absent."""
        found = {}
        for seed in seeds:
            try:
                with np.load(io.BytesIO(self._path(seed).read_bytes())) as archive:
                    found[seed] = Recording(*(archive[name] for name in _PARTS))
            except (OSError, ValueError, KeyError, EOFError, BadZipFile):
                continue
        return found

    def save(self, seed: int, recording: Recording) -> None:
        """Write a recording, atomically.

        Raises:
            BadInputError: The folder cannot be written.
        """
        path = self._path(seed)
        part = path.with_suffix(".part")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with part.open("wb") as file:
                np.savez_compressed(file, **{name: getattr(recording, name) for name in _PARTS})
            os.replace(part, path)
        except OSError as error:
            raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None

    def delete(self) -> None:
        """Remove these recordings, and the parent folder if it is empty then."""
        shutil.rmtree(self._folder, ignore_errors=True)
        with contextlib.suppress(OSError):  # absent, or another training is under way
            self._parent.rmdir()

    def _path(self, seed: int) -> Path:
        return self._folder / f"{seed}.npz"


def _key(scenario: Scenario) -> str:
    """Hash of all that a recording depends on but the seed."""
    parts = {"scenario": scenario.model_copy(update={"seed": 0}).key(), "versions": versions(), "code": _code()}
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def _code() -> str:
    """Hash of the package's source."""
    content = hashlib.sha256()
    package = Path(__file__).parents[1]
    for path in sorted(package.rglob("*.py")):
        content.update(f"{path.relative_to(package)}\n".encode() + path.read_bytes())
    return content.hexdigest()
