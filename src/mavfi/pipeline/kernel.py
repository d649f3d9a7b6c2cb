"""Interface of a kernel: it receives states, executes a step on its explicit memory, and returns states.

A kernel is independent of faults, detectors, simulator and middleware.  A host calls `receive` with every publication
that the kernel reads; when this makes a step due, the host calls `step`, and publishes the result after the latency of
the platform.  `mark` and `rollback` allow a host to recompute a stage from the same memory.

The memory of a kernel is explicit, see `mavfi.pipeline.memory`: a host can save, restore and compare it.

A class may list in `quiet` the inputs that never make a step due, which spares a host with remote kernels a round trip.
A class whose `rollback` also discards inputs, to be received again, implements `again`, which keeps them: see `repeat`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from mavfi.config import AutopilotConfig, CameraConfig, MapConfig, PlannerConfig
from mavfi.errors import BadInputError
from mavfi.kernels.perception.state_estimation import Noise
from mavfi.numerics.voxels import Grid
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.states import ODOMETRY, Stage, State


class Kernel(Protocol):
    """One computation of the pipeline (one node of a ROS graph)."""

    @property
    def name(self) -> str:
        """Name, as in a platform's latency table."""

    @property
    def stage(self) -> Stage:
        """The stage that is recomputed on an alarm."""

    @property
    def reads(self) -> tuple[str, ...]:
        """Names of the states that it consumes, rows of the state table."""

    @property
    def writes(self) -> tuple[str, ...]:
        """Names of the states that it publishes, rows of the state table."""

    def receive(self, state: State, time_us: int) -> bool:
        """Store an input; returns whether a step is due now."""

    def step(self, time_us: int) -> list[State]:
        """Execute one step on the latest inputs; returns the states to publish."""

    def mark(self) -> None:
        """Save the current memory for `rollback`."""

    def rollback(self) -> None:
        """Restore the memory of the last mark; inputs are kept."""

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """Restore memory after a restart from the node's own last outputs, before any input is received.

        Args:
            last: The last publication of each state, as consumers received it.
            time_us: Current instant (us).

        Returns:
            States whose last publication is thereby consumed and must not be received again.
        """


def repeat(kernel: Kernel) -> None:
    """Prepare a kernel to repeat its last step on the same inputs."""
    getattr(kernel, "again", kernel.rollback)()


@dataclass(frozen=True, slots=True)
class PipelineConfig:
    """The pipeline's configuration for a mission.

    Attributes:
        autopilot: Autopilot profile.
        planner: Path search.
        map: Map kind, resolution and update rule.
        camera: Camera geometry.
        directions: Ray direction of each pixel, frame x forward, y left, z up. Shape (n, 3).
        arena_lower: Corner of the mapped volume, world frame (m). Shape (3,).
        arena_upper: Opposite corner of the arena (m). Shape (3,).
        flight_lower: Corner of the box that contains all paths (m). Shape (3,).
        flight_upper: Opposite corner of the flight volume (m). Shape (3,).
        goal: Goal, world frame (m). Shape (3,).
        seed: Mission seed, from which the planner's generator is seeded.
        v_max: Speed limit (m/s).
        a_max: Acceleration limit (m/s^2).
        plan_radius: Clearance of planned paths (m).
        check_radius: Clearance of the collision check (m).
        control_period_us: Period of commands (us).
        tracker_slowdown: Loop time of the tracker / reference time it advances.
        map_latency: Latency from image to collision status (s).
        plan_latency: Latency from request to trajectory (s).
        velocity_lag: Time constant of the vehicle's velocity loop (s).
        noise: Noise parameters of the state estimator; None = the pipeline receives the true state.
        rewindable: Whether maps keep undo logs, so that they can be restored to any earlier instant.
        functions: Compiled functions of the kernels; a host may supply instrumented ones.
        kernels: Classes of a user's own, by the names of the kernels in whose place they are, see `pipeline.ppc`.
    """

    autopilot: AutopilotConfig
    planner: PlannerConfig
    map: MapConfig
    camera: CameraConfig
    directions: np.ndarray
    arena_lower: np.ndarray
    arena_upper: np.ndarray
    flight_lower: np.ndarray
    flight_upper: np.ndarray
    goal: np.ndarray
    seed: int
    v_max: float
    a_max: float
    plan_radius: float
    check_radius: float
    control_period_us: int
    tracker_slowdown: float
    map_latency: float
    plan_latency: float
    velocity_lag: float
    noise: Noise | None = None
    rewindable: bool = False
    functions: KernelFunctions = PLAIN
    kernels: Mapping[str, str] = field(default_factory=dict)

    @property
    def odometry(self) -> str:
        """Name of the state that carries the vehicle's odometry."""
        if self.noise is None:
            return ODOMETRY["truth"]
        return ODOMETRY["estimator"]


HORIZONTAL_MARGIN = 5.0
"""Margin of the map beside the arena (m)."""
VERTICAL_MARGIN = 0.5
"""Margin of the map above and below the arena (m)."""
LARGEST_GRID = 1 << 27
"""Limit of voxels; the pipeline uses about 25 bytes per voxel."""


def map_grid(config: PipelineConfig) -> Grid:
    """Grid of the map: the arena plus a margin, offset by half a voxel so that the ground lies inside a layer.

    Raises:
        BadInputError: The resolution is too fine for this arena.
    """
    resolution = config.map.resolution
    first, last = _grid_corners(config, resolution)
    lower = (first - 0.5) * resolution
    nx, ny, nz = (int(n) for n in last - first)
    voxels = nx * ny * nz
    if voxels > LARGEST_GRID:
        raise BadInputError(
            f"map resolution {resolution:g} m: {voxels:,} voxels in this arena; allowed: "
            f"{_finest(config, resolution * (voxels / LARGEST_GRID) ** (1.0 / 3.0)):g} m or more (--map-resolution)"
        )
    return Grid(float(lower[0]), float(lower[1]), float(lower[2]), 1.0 / resolution, nx, ny, nz)


def _grid_corners(config: PipelineConfig, resolution: float) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of the map's grid, in voxels. Shapes (3,)."""
    margin = np.array([HORIZONTAL_MARGIN, HORIZONTAL_MARGIN, VERTICAL_MARGIN])
    first: np.ndarray = np.floor((config.arena_lower - margin) / resolution + 0.5)
    last: np.ndarray = np.ceil((config.arena_upper + margin) / resolution + 0.5)
    return first, last


def _finest(config: PipelineConfig, estimate: float) -> float:
    """The finest resolution of two digits that is allowed (m), from an estimate."""
    mantissa, exponent = f"{estimate:.1e}".split("e")
    tenths = round(10.0 * float(mantissa))
    while True:
        resolution = float(f"{0.1 * tenths:.1f}e{exponent}")
        first, last = _grid_corners(config, resolution)
        if np.prod(last - first) <= LARGEST_GRID:
            return resolution
        tenths += 1
