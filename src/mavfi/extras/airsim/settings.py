"""AirSim's settings.json: the vehicles, their cameras, and the wind."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from mavfi.errors import BadInputError
from mavfi.extras.airsim.frames import Quaternion, looking
from mavfi.extras.shared.frames import Triple
from mavfi.files import read_file

_LARGEST = 1 << 20
MIN_FIELD_OF_VIEW = 1.0
MAX_FIELD_OF_VIEW = 170.0
"""Fields of view of cameras (deg)."""
MIN_PIXELS = 2
MAX_PIXELS = 4096
"""Sides of images."""
FIELD_OF_VIEW = 90.0
"""Of cameras unless chosen (deg), as in AirSim's default settings."""
_MULTIROTORS = ("Multirotor", "")
_VEHICLE_TYPES = ("SimpleFlight", "")
_STATES = ("Armed", "Disarmed", "Inactive", "")
_WITHOUT_MEANING = frozenset({"SettingsVersion", "SeeDocsAt", "ApiServerPort", "LocalHostIp", "RpcEnabled"})
"""Keys about the file, and about the connection, which mavfi makes."""


class CaptureSize(NamedTuple):
    """Size of a camera's images of one kind: width and height (pixels), horizontal field of view (deg)."""

    width: int
    height: int
    fov_deg: float


@dataclass(frozen=True)
class CameraSettings:
    """A camera of the settings.

    Attributes:
        position: In the body frame FRD (m).
        orientation: In the body frame FRD, w x y z; None = that of AirSim's camera of this name, or forward.
        captures: Size of images by kind.
    """

    position: Triple
    orientation: Quaternion | None
    captures: Mapping[int, CaptureSize]


@dataclass(frozen=True)
class VehicleSettings:
    """A vehicle of the settings.

    Attributes:
        name: Its name.
        start: In the scene's NED (m).
        yaw_deg: Heading (deg); None = not given.
        is_armed: Whether its motors run at the start.
        cameras: By name.
    """

    name: str
    start: Triple = (0.0, 0.0, 0.0)
    yaw_deg: float | None = None
    is_armed: bool = True
    cameras: Mapping[str, CameraSettings] = field(default_factory=dict)


@dataclass(frozen=True)
class AirsimSettings:
    """What settings.json says.

    Attributes:
        content: The file, as it is returned to programs.
        vehicles: The vehicles; empty = the file names none.
        captures: Size of images by kind, of all cameras.
        wind: NED (m/s); None = not given.
        unused: Keys that have no effect here.
    """

    content: Mapping[str, Any] = field(default_factory=dict)
    vehicles: tuple[VehicleSettings, ...] = ()
    captures: Mapping[int, CaptureSize] = field(default_factory=dict)
    wind: Triple | None = None
    unused: tuple[str, ...] = ()


def read_settings(path: Path, default: CaptureSize) -> AirsimSettings:
    """Read a settings.json.

    Args:
        path: The file.
        default: Size of images that it does not name.

    Raises:
        BadInputError: The file cannot be read, or names what does not exist here.
    """
    try:
        content = json.loads(read_file(path, _LARGEST).decode("utf-8-sig"))
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise BadInputError(f"--settings: {path}: is no JSON ({error})") from None
    try:
        return _SettingsReader(default).read(_Table("", content))
    except BadInputError as error:
        raise BadInputError(f"--settings: {path}: {error}") from None


class _Table:
    """An object of the file, which notes what was read of it."""

    def __init__(self, path: str, content: Any) -> None:  # noqa: ANN401 - a user's
        if not isinstance(content, dict):
            raise BadInputError(f"{path or 'the file'}: {content!r}: allowed: an object")
        self.path = path
        self._content = content
        self._unread = dict.fromkeys(content)

    def key(self, name: str) -> str:
        """A key with the path to it."""
        return ".".join(filter(None, (self.path, name)))

    def read(self, name: str, default: Any = None) -> Any:
        """A value."""
        self._unread.pop(name, None)
        return self._content.get(name, default)

    def number(self, name: str, least: float = -1e4, most: float = 1e4) -> float | None:
        """A number; None = not given, or NaN, which means the same in AirSim."""
        value = self.read(name)
        if value is None:
            return None
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if isinstance(value, float) and math.isnan(value):
            return None
        if not is_number or not least <= value <= most:
            raise BadInputError(f"{self.key(name)}: {value!r}: allowed: {least:g} to {most:g}")
        return float(value)

    def choice(self, name: str, allowed: tuple[str, ...]) -> str:
        """One of some values, in any case; the empty one means that none is given."""
        value = self.read(name, "")
        for choice in allowed:
            if str(value).lower() == choice.lower():
                return choice
        raise BadInputError(f"{self.key(name)}: {value!r}: allowed: {', '.join(filter(None, allowed))}")

    def tables(self, name: str) -> dict[str, "_Table"]:
        """The objects in an object, by their keys."""
        table = _Table(self.key(name), self.read(name) or {})
        return {key: _Table(table.key(key), value) for key, value in table._content.items()}

    def unused(self) -> list[str]:
        """Keys that were not read, with the path to them."""
        return [self.key(name) for name in self._unread]


class _SettingsReader:
    """Reads the objects of the file."""

    def __init__(self, default: CaptureSize) -> None:
        self._default = default
        self._unused: list[str] = []

    def read(self, table: _Table) -> AirsimSettings:
        """Read the whole file."""
        table.choice("SimMode", _MULTIROTORS)
        for name in _WITHOUT_MEANING:
            table.read(name)
        wind = table.read("Wind")
        wind_ned = None
        if wind is not None:
            wind_ned = self._position(_Table("Wind", wind))

        # defaults first: cameras of vehicles begin with them
        defaults = _Table("CameraDefaults", table.read("CameraDefaults") or {})
        captures = self._captures(defaults, {})
        self._unused += defaults.unused()
        vehicles = []
        for name, vehicle in table.tables("Vehicles").items():
            if vehicle.read("AutoCreate", True) is not False:
                vehicles.append(self._vehicle(name, vehicle, captures))
        self._unused += table.unused()
        return AirsimSettings(table._content, tuple(vehicles), captures, wind_ned, tuple(self._unused))

    def _vehicle(self, name: str, table: _Table, captures: Mapping[int, CaptureSize]) -> VehicleSettings:
        """Read a vehicle."""
        table.choice("VehicleType", _VEHICLE_TYPES)
        is_armed = table.choice("DefaultVehicleState", _STATES) in ("Armed", "")
        cameras = {
            camera_name: self._camera(camera, captures) for camera_name, camera in table.tables("Cameras").items()
        }
        for angle in ("Pitch", "Roll"):
            table.number(angle, 0.0, 0.0)
        vehicle = VehicleSettings(name, self._position(table), table.number("Yaw"), is_armed, cameras)
        self._unused += table.unused()
        return vehicle

    def _camera(self, table: _Table, captures: Mapping[int, CaptureSize]) -> CameraSettings:
        """Read a camera."""
        pitch = table.number("Pitch")
        roll = table.number("Roll")
        yaw = table.number("Yaw")
        orientation = None
        if (pitch, roll, yaw) != (None, None, None):
            orientation = looking(yaw or 0.0, pitch or 0.0, roll or 0.0)
        camera = CameraSettings(self._position(table), orientation, self._captures(table, captures))
        self._unused += table.unused()
        return camera

    @staticmethod
    def _position(table: _Table) -> Triple:
        """Read X, Y and Z, 0 unless given."""
        return table.number("X") or 0.0, table.number("Y") or 0.0, table.number("Z") or 0.0

    def _captures(self, table: _Table, captures: Mapping[int, CaptureSize]) -> dict[int, CaptureSize]:
        """Read CaptureSettings on top of others."""
        read = dict(captures)
        entries = table.read("CaptureSettings", [])
        if not isinstance(entries, list):
            raise BadInputError(f"{table.key('CaptureSettings')}: {entries!r}: allowed: a list")
        for number, entry in enumerate(entries):
            capture = _Table(f"{table.key('CaptureSettings')}.{number}", entry)
            kind = int(capture.number("ImageType", -1, 100) or 0)
            before = read.get(kind, self._default)
            width = capture.number("Width", MIN_PIXELS, MAX_PIXELS)
            height = capture.number("Height", MIN_PIXELS, MAX_PIXELS)
            fov_deg = capture.number("FOV_Degrees", MIN_FIELD_OF_VIEW, MAX_FIELD_OF_VIEW)
            read[kind] = CaptureSize(
                int(width or before.width), int(height or before.height), fov_deg or before.fov_deg
            )
            self._unused += capture.unused()
        return read
