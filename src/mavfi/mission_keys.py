"""The keys of a mission as keyword arguments: for type checkers, for completion in notebooks, and in docstrings."""

import inspect
from collections.abc import Callable
from typing import Any, Literal, TypedDict, TypeVar

from mavfi.config import Vector
from mavfi.dropped import dropped_key
from mavfi.errors import BadInputError, allowed, hint
from mavfi.mission import DeadNode, DetectorPlace, MissionSpec

Function = TypeVar("Function", bound=Callable[..., Any])


class MissionKeysWithoutSeed(TypedDict, total=False):
    """The keys of a `MissionSpec`, which describes them; all but `seed`, which some functions use for a draw."""

    environment: str
    start: Vector | None
    goal: Vector | None
    autopilot: str
    planner: str
    platform: str
    map: str
    map_resolution: float | None
    unknown_space: Literal["solid", "free"]
    camera_range: float | None
    vehicle: str | None
    trajectory: str
    waypoint: str
    pid: str
    flight_controller: str
    v_max: float | None
    arrival_radius: float
    time_limit_factor: float
    latency_jitter: float
    planner_latency: float | None
    depth_noise: float
    wind: float
    localization: Literal["truth", "estimator"]
    coupling: Literal["inline", "observer"]
    detector_place: DetectorPlace
    grain: Literal["stage", "kernel", "message"]
    same_twice: Literal["accept", "escalate", "limit"]
    answer_s: float
    degraded: Literal["none", "hold"]
    trained_for: str
    dead_node: DeadNode
    protection: str
    alarm: Literal["one_shot", "repeated"] | None
    epoch_liveness: float | None


class MissionKeys(MissionKeysWithoutSeed, total=False):
    """All keys of a `MissionSpec`, which describes them."""

    seed: int


def takes_mission_keys(function: Function) -> Function:
    """Replace `**options` in the signature and the docstring of a function by the keys of a mission.

    Completion in notebooks reads the signature.  The function itself is not wrapped, so tracebacks stay short.
    """
    signature = inspect.signature(function)
    *parameters, _ = signature.parameters.values()
    argument_names = {parameter.name for parameter in parameters}
    keys = {name: field for name, field in MissionSpec.model_fields.items() if name not in argument_names}
    for name, field in keys.items():
        parameters.append(
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=field.annotation)
        )
    function.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    described_keys = "".join(f"\n    {name}: {field.description}" for name, field in keys.items())
    function.__doc__ = f"{inspect.cleandoc(function.__doc__ or '')}\n\nKeys of the mission:{described_keys}\n"
    return function


def check_keys(function: Callable[..., Any], options: MissionKeysWithoutSeed) -> None:
    """Refuse keyword arguments that are neither arguments of a function (see above) nor keys of a mission.

    Raises:
        BadInputError: A name is unknown.  Names of earlier versions pass: `MissionSpec` says what replaces them.
    """
    names = inspect.signature(function).parameters
    for name in options:
        if name not in names and not dropped_key(name):
            raise BadInputError(f"{name}: unknown argument{hint(name, names)}; allowed: {allowed(names, name)}")
