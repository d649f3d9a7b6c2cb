"""Construction of the perception-planning-control pipeline: its kernels in data-flow order."""

from mavfi.pipeline.control import Tracker
from mavfi.pipeline.estimation import StateEstimator
from mavfi.pipeline.kernel import Kernel, PipelineConfig
from mavfi.pipeline.perception import CollisionCheck, OctoMap, PointCloud
from mavfi.pipeline.planning import MotionPlanner
from mavfi.pipeline.trajectories import TrajectoryGenerator
from mavfi.pipeline.waypoints import SetpointGenerator


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
        TrajectoryGenerator(config, planner.clearance_map),
        SetpointGenerator(config),
        Tracker(config),
    )
    return {kernel.name: kernel for kernel in kernels}
