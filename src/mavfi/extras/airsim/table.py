"""The table of calls of AirSim's API: every call is a function of an `Api` and its arguments, registered by name."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from inspect import Parameter, signature
from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.airsim.fleet import collide, free_place, nearer
from mavfi.extras.airsim.frames import Quaternion, flipped
from mavfi.extras.airsim.piloted import PilotedVehicle
from mavfi.extras.airsim.settings import AirsimSettings, CaptureSize, VehicleSettings
from mavfi.extras.shared.frames import Triple
from mavfi.mission import MissionSpec
from mavfi.sim.scene import STEP_US

GROUND = "Ground"
"""Name of the ground plane."""
FILM_MM = (23.76, 13.365)
"""Width and height of Unreal's default film (mm)."""
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
        captures: Size of images by kind.
        default_capture: That of kinds that are not named.
        film_mm: Width and height of the film (mm).
        focus_distance: What the program has set (cm); all distances are in focus.
        aperture: What the program has set (f-number).
    """

    position: Triple
    orientation: Quaternion
    captures: dict[int, CaptureSize]
    default_capture: CaptureSize
    film_mm: tuple[float, float] = FILM_MM
    focus_distance: float = 100_000.0
    aperture: float = 2.8

    def capture(self, kind: int = 0) -> CaptureSize:
        """Size of the images of a kind; that of the scene unless named."""
        return self.captures.get(kind, self.default_capture)

    @property
    def fov_deg(self) -> float:
        """Field of view of the scene's images (deg); `set_fov` sets that of all kinds."""
        return self.capture().fov_deg

    def set_fov(self, fov_deg: float) -> None:
        """Set the field of view of all kinds of images (deg)."""
        self.default_capture = self.default_capture._replace(fov_deg=fov_deg)
        self.captures = {kind: capture._replace(fov_deg=fov_deg) for kind, capture in self.captures.items()}


@dataclass(slots=True)
class DetectionFilter:
    """What is detected in a camera's pictures: patterns of names, largest distance (m) of an object's centre."""

    names: list[str] = field(default_factory=list)
    radius: float = 200.0


@dataclass
class ApiScene:
    """What all vehicles share: time, objects, weather, and that they can collide.

    Attributes:
        default_capture: Size of images of cameras that no settings name.
        version: Version that the server reports: 1 for AirSim 1.8.1, 4 for Cosys-AirSim 3.
        settings: AirSim's settings.
        vehicles: By name; calls without a name mean the first one.
        paused: Whether simulated time is stopped.
        resume_until_us: Instant of the next pause; None = none is planned.
        objects: Names of the obstacles, in the order of the world's boxes.
        segments: Segmentation ids of objects, by name.
        weather: Parameters of the picture, by AirSim's number.
        weather_on: Whether they are drawn.
        wind: What the program has set (NED, m/s); None = the mission's.
        recording: Whether the program asked for a recording; nothing is written.
    """

    default_capture: CaptureSize
    version: int
    settings: AirsimSettings
    vehicles: dict[str, "Api"] = field(default_factory=dict)
    paused: bool = False
    resume_until_us: int | None = None
    objects: list[str] = field(default_factory=list)
    segments: dict[str, int] = field(default_factory=dict)
    weather: dict[int, float] = field(default_factory=dict)
    weather_on: bool = False
    wind: Triple | None = None
    recording: bool = False

    @property
    def first(self) -> "Api":
        """The vehicle that calls without a name mean."""
        return next(iter(self.vehicles.values()))

    def find(self, name: Any) -> "Api":  # noqa: ANN401 - a client's
        """A vehicle by name.

        Raises:
            BadInputError: There is none.
        """
        if name == "":
            return self.first
        if not isinstance(name, str) or name not in self.vehicles:
            allowed = ", ".join(self.vehicles)
            raise BadInputError(
                f"vehicle {name!r}: not known; allowed: {allowed}, or none; more by simAddVehicle, "
                "and by --settings with the program's settings.json"
            )
        return self.vehicles[name]

    def add(self, spec: MissionSpec, settings: VehicleSettings, *, on_ground: bool = True) -> None:
        """Add a vehicle, in the present world; beside its place if another vehicle stands there.

        Raises:
            BadInputError: An obstacle stands there.
        """
        begin_us = 0
        home = settings.start
        if self.vehicles:
            begin_us = self.now_us
            others = [api.vehicle for api in self.vehicles.values()]
            home = free_place(home, self.first.vehicle.radius, others)
        vehicle = PilotedVehicle(
            spec,
            home=home,
            yaw_deg=settings.yaw_deg,
            is_armed=settings.is_armed,
            number=len(self.vehicles),
            begin_us=begin_us,
            on_ground=on_ground,
        )
        if self.vehicles and not np.array_equal(vehicle.sim.world.lower, self.first.vehicle.sim.world.lower):
            world = self.first.vehicle.sim.world
            vehicle.sim.set_boxes(world.lower, world.upper)
        self.vehicles[settings.name] = Api(vehicle, settings.name, self, settings)
        if self.wind is not None:
            vehicle.sim.set_wind(flipped(self.wind))

    def name_objects(self) -> None:
        """Name the obstacles of a new world."""
        self.objects = [f"box_{n}" for n in range(len(self.first.vehicle.sim.world.lower))]

    @property
    def things(self) -> list[str]:
        """Names of all that a picture can show: the obstacles, then the vehicles."""
        return [*self.objects, *self.vehicles]

    def segment(self, name: str) -> int:
        """Segmentation id of a thing, or of the ground: the chosen one, or 1 for the ground, 2 to 254 for things.

        Raises:
            ValueError: There is no such thing.
        """
        if name in self.segments:
            return self.segments[name]
        if name == GROUND:
            return 1
        return 2 + self.things.index(name) % 253

    # ---- frames -----------------------------------------------------------------------------------------------------
    @property
    def origin(self) -> np.ndarray:
        """Origin of the scene's NED in the world (m): the mission's start. Shape (3,)."""
        vehicle = self.first.vehicle
        origin: np.ndarray = vehicle.origin - np.array(flipped(vehicle.home))
        return origin

    def to_world(self, ned: Triple) -> np.ndarray:
        """A place of the scene in the world's frame (m). Shape (3,)."""
        position: np.ndarray = np.array(flipped(ned)) + self.origin
        return position

    def to_ned(self, point: np.ndarray) -> Triple:
        """A place of the world in the scene's NED (m)."""
        return flipped(point - self.origin)

    # ---- time -------------------------------------------------------------------------------------------------------
    @property
    def now_us(self) -> int:
        """Time since the start (us)."""
        return self.first.vehicle.now_us

    @property
    def busy(self) -> bool:
        """Whether a task runs."""
        return any(api.vehicle.busy for api in self.vehicles.values())

    def step(self, until_us: int) -> None:
        """Let time pass up to an instant, a multiple of 4 ms; several vehicles advance together, and can collide."""
        if len(self.vehicles) == 1:
            self.first.vehicle.step(until_us)
            return
        while self.now_us < until_us:
            next_us = min(until_us, self.now_us + STEP_US)
            for api in self.vehicles.values():
                api.vehicle.step(next_us)
            collide([api.vehicle for api in self.vehicles.values()])

    def finish(self, longest_us: int) -> None:
        """Let time pass until a task ends, but not beyond an instant (us)."""
        if len(self.vehicles) == 1:
            self.first.vehicle.finish(longest_us)
            return
        while self.busy and not self._ended_tasks() and self.now_us < longest_us:
            self.step(self.now_us + STEP_US)

    def _ended_tasks(self) -> int:
        return sum(len(api.vehicle.ended_tasks) for api in self.vehicles.values())

    # ---- what happened ----------------------------------------------------------------------------------------------
    def digest(self) -> str:
        """SHA-256 of all states so far; see `PilotedVehicle.digest`."""
        digests = [api.vehicle.digest() for api in self.vehicles.values()]
        if len(digests) == 1:
            return digests[0]
        return hashlib.sha256(" ".join(digests).encode()).hexdigest()

    @property
    def has_ever_collided(self) -> bool:
        """Whether a vehicle has collided, also before a reset or a change of pose."""
        return any(api.vehicle.has_ever_collided for api in self.vehicles.values())

    def close(self) -> None:
        """Close the simulators."""
        for api in self.vehicles.values():
            api.vehicle.sim.close()


@dataclass
class Api:
    """One vehicle, and the state of it that calls read and change.

    Attributes:
        vehicle: The vehicle.
        name: Its name.
        scene: What it shares with others.
        settings: What the settings say of it.
        cameras: By name, filled when first used.
        detected: What is detected in pictures, by camera and kind of image.
        sticks: Last data of moveByRC.
    """

    vehicle: PilotedVehicle
    name: str
    scene: ApiScene = field(repr=False)
    settings: VehicleSettings
    cameras: dict[str, ApiCamera] = field(default_factory=dict)
    detected: dict[tuple[str, int], DetectionFilter] = field(default_factory=dict)
    sticks: dict[str, float] = field(default_factory=dict)

    def in_scene(self, ned: Triple) -> Triple:
        """A place of the vehicle's NED, whose origin is its start, in the scene's (m)."""
        north, east, down = (place + start for place, start in zip(ned, self.vehicle.home, strict=True))
        return north, east, down

    def from_scene(self, ned: Triple) -> Triple:
        """Inverse of `in_scene`."""
        north, east, down = (place - start for place, start in zip(ned, self.vehicle.home, strict=True))
        return north, east, down

    def cast(self, directions: np.ndarray, limit: float, mount: Sequence[float]) -> np.ndarray:
        """Ranges along rays (m), float32, infinity beyond the limit; see `Grounded.cast`.  Other vehicles are seen."""
        return self.with_others(self.vehicle.sim.cast(directions, limit, mount), directions, limit, mount)

    def with_others(
        self, ranges: np.ndarray, directions: np.ndarray, limit: float, mount: Sequence[float]
    ) -> np.ndarray:
        """Ranges along rays (m) with other vehicles in their way."""
        others = [api.vehicle for api in self.scene.vehicles.values() if api is not self]
        return nearer(ranges, directions, limit, self.vehicle.sim.sensor_pose(mount), others)


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

    def addressed(self, scene: ApiScene, values: list[Any]) -> Api:
        """The vehicle that a call means.

        Raises:
            BadInputError: There is none of this name.
        """
        index = self._vehicle_index
        if index is None or index >= len(values):
            return scene.first
        try:
            return scene.find(values[index])
        except BadInputError as error:
            raise BadInputError(f"{self.name}: {error}") from None

    @cached_property
    def _vehicle_index(self) -> int | None:
        """Place of the vehicle's name among the arguments; None = it is about no vehicle, or about a new one."""
        if "vehicle_name" not in self.arguments or self.name == "simAddVehicle":
            return None
        return self.arguments.index("vehicle_name")

    @property
    def names_vehicle(self) -> bool:
        """Whether it is about one vehicle."""
        return self._vehicle_index is not None

    def check(self, values: list[Any]) -> None:
        """Check the number and the types of arguments.

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
            if name == "external" and value:
                raise BadInputError(f"{self.name}: external: {value!r}: allowed: False, as all cameras are of vehicles")


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
        raise BadInputError(
            f"server could not find function '{name}': mavfi does not have this call (docs/how-to/airsim.md)"
        )
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
