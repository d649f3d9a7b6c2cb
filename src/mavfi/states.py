"""The inter-kernel states: one table from which injector, detectors, logs, messages and docs are derived.

A published state is a `State`: a header of scalar fields and, for some, a list of elements (points, vertices,
voxels).  Both are packed NumPy structured arrays, so that a field is a byte range in which a fault can flip a bit.
The leading float64 fields of a header can be read as a plain vector with `floats`.
"""

from collections.abc import Collection
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal

import numpy as np

from mavfi.errors import BadInputError, allowed, not_known

_BYTE = np.dtype(np.uint8)
"""Type of a byte."""
AUTOPILOTS = ("published", "hardened")
"""Shipped autopilot profiles: the paper's, and one with protections."""
ODOMETRY = {"truth": "sensor.odometry", "estimator": "perception.odometry"}
"""By localization, the state that carries the vehicle's odometry; both begin with the same 13 fields."""


class Stage(StrEnum):
    """The paper's three stages, and the sensors before them."""

    SENSOR = "sensor"
    PERCEPTION = "perception"
    PLANNING = "planning"
    CONTROL = "control"


PPC_STAGES = (Stage.PERCEPTION, Stage.PLANNING, Stage.CONTROL)
"""The stages of the pipeline, which can be recomputed."""


@dataclass(frozen=True, slots=True)
class KernelSpec:
    """One row of the kernel table.

    Attributes:
        name: As in the latency table of a platform.
        stage: The stage that is recomputed on an alarm about its states.
        node: Process in which it runs and dies; also the name of its ROS node.
        trigger: "periodic" = stepped in every control period; "input" = stepped by its inputs.
        counts: Whether its latency is part of the stage's.
        on_flight_controller: Whether it runs there (some 10 us per step), at no cost on the modelled computer.
        functions: Attributes of `pipeline.functions.KernelFunctions` whose instructions can be injected.
        only_with: The only localization with which the kernel exists; "" = any.
    """

    name: str
    stage: Stage
    node: str
    trigger: Literal["periodic", "input"] = "input"
    counts: bool = True
    on_flight_controller: bool = False
    functions: tuple[str, ...] = ()
    only_with: str = ""


_KERNEL_TABLE = (
    KernelSpec(
        "state_estimation", Stage.PERCEPTION, "state_estimation", counts=False, on_flight_controller=True,
        only_with="estimator",
    ),
    KernelSpec("point_cloud", Stage.PERCEPTION, "point_cloud", functions=("back_project",)),
    KernelSpec("octomap", Stage.PERCEPTION, "octomap", functions=("insert_scan", "collect", "update_voxels")),
    KernelSpec(
        "collision_check", Stage.PERCEPTION, "collision_check",
        functions=("apply_updates", "time_to_collision", "known_free_distance"),
    ),
    KernelSpec("planner", Stage.PLANNING, "planner"),
    KernelSpec("trajectory", Stage.PLANNING, "planner"),
    KernelSpec("waypoint", Stage.PLANNING, "waypoint", "periodic", counts=False),
    KernelSpec("pid", Stage.CONTROL, "pid", "periodic", functions=("track",)),
)  # fmt: skip

KERNELS: dict[str, KernelSpec] = {spec.name: spec for spec in _KERNEL_TABLE}
"""Every kernel of the pipeline by name, in the order of the data flow.

`octomap` calls the first of its functions on a dense map, the others on an octree.  `collision_check` maintains its own
clearance map, whose updates are stored by `apply_updates`; the planner's copy is not injected.
"""

PLANNERS: dict[str, tuple[str, ...]] = {
    name: (f"plan_{name}", "shortcut_greedy", "shortcut_random") for name in ("rrt", "rrt_connect", "rrt_star")
}
"""Functions called by the kernel `planner`, by the mission's planner: path search and shortening."""


INJECTABLE: dict[str, tuple[str, ...]] = {}
for _spec in _KERNEL_TABLE:
    if _spec.name == "planner":
        INJECTABLE.update(PLANNERS)
    elif _spec.functions:
        INJECTABLE[_spec.name] = _spec.functions
"""Functions by the kernel names of instruction faults, as in the paper's Fig. 3; for the planner, planner names."""
INJECTED_KERNEL: dict[str, str] = {name: name for name in INJECTABLE} | dict.fromkeys(PLANNERS, "planner")
"""Row of `KERNELS` by the same name."""

_MESSAGES = ("status", "path", "trajectory", "waypoint", "command", "tracking")
"""Last parts of the names of states that the acceptance test checks."""
_ESTIMATE = ("judge_estimate", "note_estimate", "note_fix")
"""Functions of the acceptance test in flights with an estimator."""
_CODES = (*(f"measure_{name}" for name in _MESSAGES), "note_vehicle", "judge")
"""Functions of the detector `limits`, which watches all fields."""
DETECTORS: dict[str, tuple[str, ...]] = {
    "acceptance": (*(f"judge_{name}" for name in _MESSAGES), *(f"note_{name}" for name in _MESSAGES[:3]), *_ESTIMATE),
    **dict.fromkeys(("gaussian", "autoencoder"), ("judge",)),
    "physics_gate": ("judge_gate",),
    "limits": _CODES,
    "checksum": ("crc32c",),
}
"""Injectable functions of detectors, in flights with that detector, by their alarm source."""
WATCHING = tuple(name for name in DETECTORS if name != "checksum")
"""Targets of memory faults that exist only in flights with a detector; a checksum is not kept."""

KERNEL_STAGES: dict[str, Stage] = {name: KERNELS[row].stage for name, row in INJECTED_KERNEL.items()}
"""Stage by the same name."""


@dataclass(frozen=True, slots=True)
class PlugInSpec:
    """A kind of plug-in of a mission, whose compiled functions and arrays faults can be in.

    Attributes:
        kernel: The kernel in whose steps it is called; "" = none.
        stage: Its stage in tables; "" = none of the pipeline's.
    """

    kernel: str = ""
    stage: str = ""


PLUG_INS: dict[str, PlugInSpec] = {
    "planner": PlugInSpec("planner", str(Stage.PLANNING)),
    "map": PlugInSpec("octomap", str(Stage.PERCEPTION)),
    "trajectory": PlugInSpec("trajectory", str(Stage.PLANNING)),
    "waypoint": PlugInSpec("waypoint", str(Stage.PLANNING)),
    "pid": PlugInSpec("pid", str(Stage.CONTROL)),
    "flight_controller": PlugInSpec("", str(Stage.CONTROL)),
    "detector": PlugInSpec(),
}
"""Kinds of plug-ins by the key of a mission or an arm that names one."""
REPLACEABLE = ("trajectory", "waypoint", "pid")
"""Kernels for which a mission may name a class of its own, by a key of the same name."""

PERIODIC = tuple(spec.name for spec in _KERNEL_TABLE if spec.trigger == "periodic")
"""Kernels stepped at the control period, in this order; all others are stepped by their inputs."""
STAGE_KERNELS: dict[Stage, tuple[str, ...]] = {
    stage: tuple(spec.name for spec in _KERNEL_TABLE if spec.stage is stage and spec.counts) for stage in PPC_STAGES
}
"""Kernels whose latencies add up to a stage's."""


def in_node(kernel: str) -> tuple[str, ...]:
    """The kernels in the same node, which share its memory and crash together."""
    return tuple(spec.name for spec in _KERNEL_TABLE if spec.node == KERNELS[kernel].node)


@dataclass(frozen=True, slots=True)
class Field:
    """One number of a state.

    Attributes:
        name: Name, as in the paper if it has one.
        dtype: NumPy type string: "f8", "f4", "i4" or "?".
        unit: SI unit, "-" for counters and flags.
        read_in: Autopilot profiles in which some consumer reads the field; elsewhere it is dead: a fault in it has no
            effect.
    """

    name: str
    dtype: str
    unit: str
    read_in: tuple[str, ...] = AUTOPILOTS

    def dead_in(self, autopilot: str) -> bool:
        """Whether no consumer in the autopilot profile reads the field."""
        return autopilot not in self.read_in


@dataclass(frozen=True, slots=True)
class StateSpec:
    """One row of the state table.

    Attributes:
        name: `<stage>.<state>`.
        writer: Kernel that publishes it.
        stage: Stage of the writer.
        rate: Publication rate, in words.
        header: Scalar fields, float64 first.
        elements: Fields of each list element; empty = no list.
        element: Name of one element.
        acted_on: Integer header field whose increment makes consumers act on a publication; "" = they act on every
            publication.
        only_with: The only localization with which the state exists; "" = any.
    """

    name: str
    writer: str
    stage: Stage
    rate: str
    header: tuple[Field, ...]
    elements: tuple[Field, ...] = ()
    element: str = ""
    acted_on: str = ""
    only_with: str = ""
    header_dtype: np.dtype = field(init=False, repr=False)
    element_dtype: np.dtype = field(init=False, repr=False)
    no_elements: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "header_dtype", np.dtype([(f.name, f.dtype) for f in self.header]))
        object.__setattr__(self, "element_dtype", np.dtype([(f.name, f.dtype) for f in self.elements]))
        object.__setattr__(self, "no_elements", np.zeros(0, self.element_dtype))

    def exists_with(self, localization: str) -> bool:
        """Whether the state is published in flights with that localization."""
        return self.only_with in ("", localization)

    @property
    def fields(self) -> tuple[Field, ...]:
        """All fields: those of the elements first, if any, then the header's."""
        return self.elements + self.header

    @property
    def lengths(self) -> tuple[Field, ...]:
        """Lengths of the lists of a serialized message, one per field of the elements (see `levels.state.carriers`)."""
        return tuple(Field(f"length_{f.name}", "u4", "-") for f in self.elements)

    def offset(self, name: str) -> int:
        """Byte offset of a field of the header."""
        columns = self.header_dtype.fields
        assert columns is not None and self.header_dtype.names is not None
        # by position: the only value of a program's call has no name, and NumPy gives it one
        position = [f.name for f in self.header].index(name)
        return int(columns[self.header_dtype.names[position]][1])

    def in_elements(self, name: str) -> bool:
        """Whether the named field belongs to the elements (which take precedence if a name is in both)."""
        return any(f.name == name for f in self.elements)

    def find(self, name: str) -> Field:
        """The named field, or length of a list; raises a BadInputError if it is unknown."""
        for candidate in self.fields + self.lengths:
            if candidate.name == name:
                return candidate
        raise BadInputError(f"state {self.name}: field {not_known(name, [field.name for field in self.fields])}")


@dataclass(slots=True)
class State:
    """One publication of an inter-kernel state.

    Attributes:
        spec: Its row in the table.
        header: Scalar fields. Shape (1,), structured.
        elements: List of elements. Shape (n,), structured; (0,) if the state has none.
    """

    spec: StateSpec
    header: np.ndarray
    elements: np.ndarray

    def copy(self) -> "State":
        """A copy that shares no memory with this one."""
        return State(self.spec, self.header.copy(), self.elements.copy())

    def value(self, name: str) -> Any:
        """The value of a field of the header."""
        return self.header[name].item()

    def same_bits(self, other: "State") -> bool:
        """Whether both have the same bits (NaNs compare as bit patterns)."""
        return self.header.tobytes() == other.header.tobytes() and self.elements.tobytes() == other.elements.tobytes()


def differing_rows(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Indices at which two arrays of one type and length differ bitwise, NaNs and signed zeros included."""
    size = first.dtype.itemsize
    bits = [np.ascontiguousarray(values).view(np.uint8).reshape(-1, size) for values in (first, second)]
    return np.flatnonzero((bits[0] != bits[1]).any(axis=1))


def floats(header: np.ndarray, count: int) -> np.ndarray:
    """The `count` leading float64 fields of a header, as a plain array that shares its memory. Shape (count,)."""
    # built on the same buffer: several times as fast as `view`, which inspects the fields of a structured array
    return np.ndarray(count, np.float64, header)


def rows(elements: np.ndarray, width: int) -> np.ndarray:
    """The `width` leading float64 fields of n elements, as a table that shares their memory. Shape (n, width)."""
    return np.ndarray((len(elements), width), np.float64, elements, 0, (elements.dtype.itemsize, 8))


def bytes_of(header: np.ndarray) -> np.ndarray:
    """The bytes of a header, as an array that shares its memory. Shape (size,), uint8."""
    base: Any = header.base
    if type(base) is np.ndarray and base.dtype is _BYTE and base.size == header.nbytes:
        return base  # as in `new_state`: a view takes several times as long
    return header.view(np.uint8)


def new_state(name: str, count: int = 0) -> State:
    """A zeroed state with `count` elements."""
    spec = STATES[name]
    # on plain bytes: NumPy takes several times as long to create a structured array of zeros
    header: np.ndarray = np.ndarray(1, spec.header_dtype, np.zeros(spec.header_dtype.itemsize, np.uint8))
    elements = spec.no_elements
    if count:
        elements = np.zeros(count, spec.element_dtype)
    return State(spec, header, elements)


_HARDENED = ("hardened",)
"""Read by consumers in the hardened profile only."""
_PUBLISHED = ("published",)
"""Read by consumers in the published profile only."""


def _vector(prefix: str, unit: str, read_in: tuple[str, ...] = AUTOPILOTS, dtype: str = "f8") -> tuple[Field, ...]:
    """Components of a vector."""
    return tuple(Field(f"{prefix}{axis}", dtype, unit, read_in) for axis in "xyz")


_XYZ = _vector("", "m")
"""A position."""
_VELOCITY = _vector("v", "m/s")
"""A velocity."""
_QUATERNION = tuple(Field(f"q{axis}", "f8", "-") for axis in "wxyz")
"""An attitude."""
_DEAD_RATES = _vector("w", "rad/s", ())
"""A turn rate, which no consumer reads."""
_POINT = (
    *_XYZ, Field("yaw", "f8", "rad"), *_VELOCITY, *_vector("a", "m/s^2", _HARDENED), Field("duration", "f8", "s"),
)  # fmt: skip
"""One "MultiDOF" point of the paper: position, yaw, velocity, acceleration, and its duration."""

_TABLE = (
    StateSpec(
        "sensor.depth", "camera", Stage.SENSOR, "when perception is ready, 10 Hz at most",
        header=(*_XYZ, *_QUATERNION), elements=(Field("range", "f4", "m"),), element="pixel",
    ),
    StateSpec(
        "sensor.odometry", "localization", Stage.SENSOR, "50 Hz",
        header=(*_XYZ, *_VELOCITY, *_QUATERNION, *_DEAD_RATES), only_with="truth",
    ),
    StateSpec(
        "sensor.imu", "imu", Stage.SENSOR, "250 Hz",
        header=(*_vector("f", "m/s^2"), *_vector("w", "rad/s")), only_with="estimator",
    ),
    StateSpec(
        "sensor.position", "positioning", Stage.SENSOR, "10 Hz",
        header=(*_XYZ, Field("heading", "f8", "rad")), only_with="estimator",
    ),
    StateSpec(
        "perception.odometry", "state_estimation", Stage.PERCEPTION, "per sample of the IMU",
        header=(
            *_XYZ, *_VELOCITY, *_QUATERNION, *_DEAD_RATES,
            *_vector("bias_f", "m/s^2", ()), *_vector("bias_w", "rad/s", ()),
        ),
        only_with="estimator",
    ),
    StateSpec(
        "perception.point_cloud", "point_cloud", Stage.PERCEPTION, "per depth image",
        header=_XYZ, elements=_vector("", "m", dtype="f4"), element="point",
    ),
    StateSpec(
        "perception.map_update", "octomap", Stage.PERCEPTION, "per point cloud",
        header=(Field("scan", "i4", "-", ()),),
        elements=(Field("voxel", "i4", "-"), Field("log_odds", "f4", "-")), element="voxel",
    ),
    StateSpec(
        "perception.collision_status", "collision_check", Stage.PERCEPTION, "per map update",
        header=(
            Field("time_to_collision", "f8", "s", _PUBLISHED),
            Field("distance_to_blocked", "f8", "m", _HARDENED), Field("distance_to_unknown", "f8", "m", _HARDENED),
            Field("future_collision_seq", "i4", "-"), Field("trajectory_seq", "i4", "-", _HARDENED),
            Field("collision", "?", "-"),
        ),
        acted_on="future_collision_seq",
    ),
    StateSpec(
        "planning.path", "planner", Stage.PLANNING, "per plan",
        header=(
            Field("entry_speed", "f8", "m/s"), Field("future_collision_seq", "i4", "-"),
            Field("junction", "i4", "-", _HARDENED),
        ),
        elements=_XYZ, element="vertex",
    ),
    StateSpec(
        "planning.trajectory", "trajectory", Stage.PLANNING, "per plan",
        header=(Field("trajectory_seq", "i4", "-"), Field("future_collision_seq", "i4", "-")),
        elements=_POINT, element="point",
    ),
    StateSpec(
        "planning.waypoint", "waypoint", Stage.PLANNING, "per way-point (published 0.5 s, hardened 20 ms)",
        header=(
            *_POINT[:-1], Field("duration", "f8", "s", _PUBLISHED), Field("trajectory_seq", "i4", "-"),
            Field("future_collision_seq", "i4", "-", _PUBLISHED), Field("index", "i4", "-"),
        ),
    ),
    StateSpec(
        "control.command", "pid", Stage.CONTROL, "50 Hz",
        header=(*_VELOCITY, Field("yaw_rate", "f8", "rad/s"), Field("duration", "f8", "s")),
    ),
    StateSpec(
        "control.tracking", "pid", Stage.CONTROL, "50 Hz", header=(Field("remaining", "f8", "s", _PUBLISHED),),
    ),
)  # fmt: skip

STATES: dict[str, StateSpec] = {spec.name: spec for spec in _TABLE}
"""Every inter-kernel state by name, in the order of the data flow."""


VECTORS: tuple[tuple[str, ...], ...] = tuple(tuple(f"{prefix}{axis}" for axis in "xyz") for prefix in ("", "v", "a"))
"""Names of fields that are the components of one vector: position, velocity, acceleration."""


def states_with(localization: str) -> dict[str, StateSpec]:
    """The states published in flights with that localization, by name, in the order of the data flow."""
    return {name: spec for name, spec in STATES.items() if spec.exists_with(localization)}


_MONITORED_POINT = {
    "paper-13": "x y z yaw vx vy vz",
    "published-19": "x y z vx vy vz ax ay az yaw duration trajectory_seq future_collision_seq",
}
"""Monitored fields of a way-point, by the name of the set."""
MONITORED_SETS: dict[str, tuple[tuple[str, str], ...]] = {
    name: (
        ("perception.collision_status", "time_to_collision"),
        ("perception.collision_status", "future_collision_seq"),
        *(("planning.waypoint", field) for field in point.split()),
        *(("control.command", field) for field in ("vx", "vy", "vz", "yaw_rate")),
    )
    for name, point in _MONITORED_POINT.items()
}
"""Fields monitored by detectors, by the name of the set: (state, field), in the order of the input vector."""


_PUBLISHED_FIELDS = {
    "perception.collision_status": "time_to_collision future_collision_seq collision",
    "planning.trajectory": "x y z yaw vx vy vz ax ay az duration trajectory_seq future_collision_seq",
    "control.command": "vx vy vz yaw_rate duration",
}
PUBLISHED_SITES: dict[str, tuple[str, ...]] = {
    state: tuple(names.split()) for state, names in _PUBLISHED_FIELDS.items()
}
"""Fields that the authors' injector of states can change, by state, whether or not a consumer reads them.

From MAVBench/MAV_apps, branch mavfi; its flags of a trajectory, `blocking_yaw`, `append` and `reverse`, are not here.
"""


def find_state(name: str) -> StateSpec:
    """The named state.

    Raises:
        BadInputError: Unknown state.
    """
    if name not in STATES:
        raise BadInputError(unknown("state", name, STATES))
    return STATES[name]


def unknown(kind: str, name: str, names: Collection[str]) -> str:
    """The message on a name that is no state or no kernel, which tells what it is instead.

    Args:
        kind: "state" or "kernel".
        name: The name.
        names: States or kernels that are allowed.
    """
    if name in set(Stage):
        of_states = {state.name: state.stage for state in STATES.values()}
        stages = KERNEL_STAGES | {kernel.name: kernel.stage for kernel in KERNELS.values()} | of_states
        in_stage = [each for each in names if stages.get(each) == name]
        return f"{kind} {name!r}: is a stage; allowed: {allowed(in_stage)}"
    for other, others in (("state", STATES), ("kernel", KERNEL_STAGES.keys() | KERNELS.keys())):
        if name in others:
            reason = f"is a {other}"
            if other == kind:
                reason = "is not part of this mission"
            return f"{kind} {name!r}: {reason}; allowed: {allowed(names)}"
    return f"{kind} {not_known(name, names)}"
