"""Vehicles and environments in the formats of other programs: extras read them, by the extension of the file name."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from mavfi.config import EnvironmentConfig, names
from mavfi.errors import BadInputError
from mavfi.files import is_file
from mavfi.plugins import extensions, known

VEHICLE_FILES = "mavfi.vehicle_files"
"""Entry points of this group are `VehicleReader`s, by extension."""
ENVIRONMENT_FILES = "mavfi.environment_files"
"""Entry points of this group are `EnvironmentReader`s, by extension."""
NO_EXTENSION = "no_extension"
"""Name of the reader of files without an extension."""


class ImportedVehicle(NamedTuple):
    """What a file says of a vehicle.

    Attributes:
        keys: Keys of a `VehicleConfig` with their values.
        notes: Where the value of a key is from, or that it was assumed, by key.
        assumed: Keys whose values are not from the file.
        remarks: What of the model is flown otherwise, or left out.
    """

    keys: dict[str, Any]
    notes: dict[str, str]
    assumed: tuple[str, ...]
    remarks: tuple[str, ...]

    def summary(self) -> str:
        """What was taken and what was assumed, on one line."""
        notes = [f"{key} {self.keys[key]}" for key in ("mass", "arm_length", "max_rotor_thrust") if key in self.keys]
        text = f"flown as {self.keys.get('name')} with {', '.join(notes)}"
        if self.remarks:
            text += f"; {'; '.join(self.remarks)}"
        if self.assumed:
            text += "; assumed " + ", ".join(f"{key}: {self.notes[key]}" for key in self.assumed)
        return text


VehicleReader = Callable[[Path, Mapping[str, Any]], ImportedVehicle]
"""Called with the file, and the keys that the user has set, which go before those of the file."""
EnvironmentReader = Callable[[Path], EnvironmentConfig | None]
"""None = the file has another format."""


def extensions_of(group: str) -> Iterator[str]:
    """Extensions of file names that the readers of a group take, with the dot; found when they are iterated."""
    for name in sorted(known(group, {})):
        if name != NO_EXTENSION:
            yield f".{name}"


def reader_of(group: str, name: str) -> Any | None:  # noqa: ANN401 - one of the group
    """The reader of a file by its name; None = that of no file, or no reader takes it."""
    path = Path(name)
    extension = path.suffix.lower().removeprefix(".")
    if not extension and not is_file(path):
        return None
    return extensions(group).get(extension or NO_EXTENSION)


def import_vehicle(path: Path, chosen: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of a vehicle from a model's file; a warning says what was taken and what was assumed.

    Args:
        path: The file.
        chosen: Keys that the user has set; they go before those of the file.

    Raises:
        BadInputError: No extra reads such files, or the file is not valid, or lacks what has no default.
    """
    reader: VehicleReader | None = reader_of(VEHICLE_FILES, str(path))
    if reader is None:
        allowed = ", ".join(extensions_of(VEHICLE_FILES)) or "none, no reader is installed"
        raise BadInputError(f"{path}: not a model of a vehicle; allowed: {allowed}")
    imported = reader(path, chosen)
    warnings.warn(f"{path}: {imported.summary()} (all values: mavfi vehicle {path})", stacklevel=2)
    return imported.keys


def vehicle_file(name: str) -> Path | None:
    """The model's file that a vehicle's name is; None = a name, or a file that no extra reads."""
    if reader_of(VEHICLE_FILES, name) is None or name in names("vehicles"):
        return None
    return Path(name)
