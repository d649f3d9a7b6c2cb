"""Construction of the perception-planning-control pipeline: its kernels in data-flow order.

A mission may name a class of its own for a trajectory generator, setpoint generator or tracker: a subclass of ours,
whose memory, marks and inputs it inherits.
"""

from typing import Any

from mavfi.errors import BadInputError
from mavfi.pipeline.control import Tracker
from mavfi.pipeline.estimation import StateEstimator
from mavfi.pipeline.kernel import Kernel, PipelineConfig
from mavfi.pipeline.perception import CollisionCheck, OctoMap, PointCloud
from mavfi.pipeline.planning import MotionPlanner
from mavfi.pipeline.trajectories import TrajectoryGenerator
from mavfi.pipeline.waypoints import SetpointGenerator
from mavfi.plugins import build, load_object

GROUP = "mavfi.kernels"
"""Entry-point group of such classes."""
_REPLACEABLE: dict[str, type] = {"trajectory": TrajectoryGenerator, "waypoint": SetpointGenerator, "pid": Tracker}


def find_kernel(name: str, address: str) -> Any:  # noqa: ANN401 - a user's own
    """The class of a user's own in the place of a kernel.

    Args:
        name: The kernel.
        address: An entry point of `mavfi.kernels`, or "package.module:Class".

    Raises:
        BadInputError: It is not known, not allowed, cannot be imported, or is no subclass of ours.
    """
    ours = _REPLACEABLE[name]
    kind = load_object(name, address, GROUP, {})
    if not (isinstance(kind, type) and issubclass(kind, ours)):
        raise BadInputError(f"{name} {address!r}: allowed: a subclass of {ours.__module__}.{ours.__qualname__}")
    return kind


def _kernel(name: str, config: PipelineConfig, *arguments: object) -> Kernel:
    """A kernel that may be a user's own."""
    if name not in config.kernels:
        ours: Kernel = _REPLACEABLE[name](config, *arguments)
        return ours
    address = config.kernels[name]
    kernel: Kernel = build(name, address, find_kernel(name, address), config, *arguments)
    return kernel


def build_pipeline(config: PipelineConfig) -> dict[str, Kernel]:
    """All kernels by name: seven, plus the state estimator if the pipeline does not receive the true state."""
    kernels: list[Kernel] = []
    if config.noise is not None:
        kernels.append(StateEstimator(config.noise))
    planner = MotionPlanner(config)
    kernels += (
        PointCloud(config),
        OctoMap(config),
        CollisionCheck(config),
        planner,
        _kernel("trajectory", config, planner.clearance_map),
        _kernel("waypoint", config),
        _kernel("pid", config),
    )
    return {kernel.name: kernel for kernel in kernels}
