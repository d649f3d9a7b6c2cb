"""The table of calls of AirSim's API: every call is a function of an `Api` and its arguments, registered by name."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from inspect import Parameter, signature
from typing import Any

from mavfi.errors import BadInputError
from mavfi.flight.piloted import PilotedVehicle
from mavfi.numerics.frames import Quaternion, Triple

GROUND = "Ground"
"""Name of the ground plane."""
FILM_MM = (23.76, 13.365)
"""Width and height of Unreal's default film (mm)."""
MIN_FIELD_OF_VIEW = 1.0
MAX_FIELD_OF_VIEW = 170.0
"""Fields of view of cameras (deg)."""
DESTROYED = -3
"""`Contact.obstacle` of an obstacle that was destroyed after the contact."""

_DOUBLES = frozenset(
    "w_val x_val y_val z_val yaw_or_rate rad latitude longitude altitude pitch roll yaw throttle left_z right_z".split()
)
"""Numbers in objects that are doubles or floats in AirSim."""


@dataclass(slots=True)
class ApiCamera:
    """A camera.

    Attributes:
        position: In the body frame FRD (m).
        orientation: In the body frame FRD, w x y z.
        fov_deg: Horizontal field of view (deg).
        film_mm: Width and height of the film (mm).
        focus_distance: What the program has set (cm); all distances are in focus.
        aperture: What the program has set (f-number).
    """

    position: Triple
    orientation: Quaternion
    fov_deg: float = 90.0
    film_mm: tuple[float, float] = FILM_MM
    focus_distance: float = 100_000.0
    aperture: float = 2.8


@dataclass(slots=True)
class DetectionFilter:
    """What is detected in a camera's pictures: patterns of names, largest distance (m) of an object's centre."""

    names: list[str] = field(default_factory=list)
    radius: float = 200.0


@dataclass
class Api:
    """The vehicle and the state that calls read and change.

    Attributes:
        vehicle: The vehicle.
        name: Its name; calls with another one are refused.
        pixels: Width and height of images.
        version: Version that the server reports: 1 for AirSim 1.8.1, 4 for Cosys-AirSim 3.
        cameras: By name, filled when first used.
        paused: Whether simulated time is stopped.
        resume_until_us: Instant of the next pause; None = none is planned.
        objects: Names of the obstacles, in the order of the world's boxes.
        segments: Segmentation ids of objects, by name.
        detected: What is detected in pictures, by camera and kind of image.
        weather: Parameters of the picture, by AirSim's number.
        weather_on: Whether they are drawn.
        sticks: Last data of moveByRC.
        recording: Whether the program asked for a recording; nothing is written.
    """

    vehicle: PilotedVehicle
    name: str
    pixels: tuple[int, int]
    version: int
    cameras: dict[str, ApiCamera] = field(default_factory=dict)
    paused: bool = False
    resume_until_us: int | None = None
    objects: list[str] = field(default_factory=list)
    segments: dict[str, int] = field(default_factory=dict)
    detected: dict[tuple[str, int], DetectionFilter] = field(default_factory=dict)
    weather: dict[int, float] = field(default_factory=dict)
    weather_on: bool = False
    sticks: dict[str, float] = field(default_factory=dict)
    recording: bool = False

    def __post_init__(self) -> None:
        self.name_objects()

    def name_objects(self) -> None:
        """Name the obstacles of a new world."""
        self.objects = [f"box_{n}" for n in range(len(self.vehicle.sim.world.lower))]

    def segment(self, name: str) -> int:
        """Segmentation id of an object, or of the ground: the chosen one, or 1 for the ground, 2 to 254 for obstacles.

        Raises:
            ValueError: There is no such object.
        """
        if name in self.segments:
            return self.segments[name]
        if name == GROUND:
            return 1
        return 2 + self.objects.index(name) % 253


@dataclass(frozen=True)
class ApiCall:
    """A call of the API.

    Attributes:
        name: As on the wire.
        function: Takes an `Api` and the arguments; returns plain data, or a generator if it `is_task`.
        is_task: Whether the answer comes when a task has ended.
        ending: Last parameters of the call, which the function does not take.
    """

    name: str
    function: Callable[..., Any]
    is_task: bool
    ending: tuple[Parameter, ...] = ()

    @cached_property
    def parameters(self) -> list[Parameter]:
        """Its parameters, without the `Api`."""
        return [*list(signature(self.function).parameters.values())[1:], *self.ending]

    def run(self, api: Api, values: list[Any]) -> Any:
        """What the function returns for arguments that `check` accepts."""
        if self.ending:
            values = values[: len(self.parameters) - len(self.ending)]
        return self.function(api, *values)

    @property
    def arguments(self) -> list[str]:
        """Names of its parameters."""
        return [parameter.name for parameter in self.parameters]

    def is_double(self, path: Sequence[str | int]) -> bool:
        """Whether AirSim's signature has a double or float at a path, which begins with the place of an argument."""
        index, *inside = path
        if inside:
            return inside[-1] in _DOUBLES
        return isinstance(index, int) and index < len(self.parameters) and self.parameters[index].annotation is float

    def check(self, api: Api, values: list[Any]) -> None:
        """Check the number and the types of arguments and the name of the vehicle.

        Raises:
            BadInputError: They do not fit.
        """
        if any(parameter.kind is Parameter.VAR_POSITIONAL for parameter in self.parameters):
            return
        needed = sum(parameter.default is Parameter.empty for parameter in self.parameters)
        if not needed <= len(values) <= len(self.parameters):
            allowed = ", ".join(self.arguments) or "none"
            raise BadInputError(f"{self.name}: {len(values)} arguments; allowed: {allowed}")
        for parameter, value in zip(self.parameters, values, strict=False):
            name = parameter.name
            if parameter.annotation in (bool, int, float) and not isinstance(value, (int, float)):
                raise BadInputError(f"{self.name}: {name}: {value!r}: allowed: a number")
            if name == "vehicle_name" and value not in ("", api.name):
                raise BadInputError(f"{self.name}: vehicle {value!r}: not known; allowed: {api.name}, or none")


CALLS: dict[str, ApiCall] = {}


_KIND = Parameter.POSITIONAL_OR_KEYWORD
_VEHICLE = Parameter("vehicle_name", _KIND, default="", annotation=str)
_EXTERNAL = Parameter("external", _KIND, default=False)
"""Whether a camera is one of the scene, not of the vehicle; there is none."""


def call(
    function: Callable[..., Any], name: str = "", *, is_task: bool = False, ending: tuple[Parameter, ...] = ()
) -> Callable[..., Any]:
    """Register a function as the call of its own or another name."""
    name = name or function.__name__
    CALLS[name] = ApiCall(name, function, is_task, ending)
    return function


vehicle_call = partial(call, ending=(_VEHICLE,))
"""Register a function as a call that may end with the name of the vehicle."""
camera_call = partial(call, ending=(_VEHICLE, _EXTERNAL))
"""Register a function as a call about a camera, which may end with the name of the vehicle and `external`."""
task = partial(vehicle_call, is_task=True)
"""Register a function that returns a `Task`, which needs running motors."""


def add_readings(register: Callable[..., Any], readings: Mapping[str, Callable[[Api], Any]]) -> None:
    """Register functions of the `Api` alone, by name; `register`: `call` or `vehicle_call`."""
    for name, read in readings.items():
        register(read, name)


def find_call(name: Any) -> ApiCall:
    """The call of a name.

    Raises:
        BadInputError: There is none; the message names it, as AirSim's server does.
    """
    if not isinstance(name, str) or name not in CALLS:
        raise BadInputError(f"server could not find function '{name}': mavfi does not have this call (docs/airsim.md)")
    return CALLS[name]


def require_ready(api: Api, name: str) -> None:
    """Check that a task can fly.

    Raises:
        BadInputError: API control is off, or the motors are.
    """
    if not api.vehicle.api:
        raise BadInputError(f"{name}: API control is off; allowed: after enableApiControl(True)")
    if not api.vehicle.sim.armed:
        raise BadInputError(f"{name}: the motors are off; allowed: after armDisarm(True)")
