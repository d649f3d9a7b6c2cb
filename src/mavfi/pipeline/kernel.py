"""Interface of a kernel: it receives states, does one step on its explicit memory, and returns states.

A kernel knows no faults, no detectors, no simulator and no middleware.  A host calls `receive` with every publication
that the kernel reads; where that makes a step due, the host calls `step` and publishes the result after the latency of
its platform.  `mark` and `rollback` let a host run a stage again from the same memory.

The memory of a kernel is explicit, see `mavfi.pipeline.memory`: a host can save it, put it back, and compare it.

A class may list in `quiet` the inputs that never make a step due: a host whose kernels are elsewhere then need not ask.
A class whose `rollback` takes inputs back, which are then received again, has `again`, which does not: see `repeat`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mavfi.config import CameraConfig, MapConfig, PlannerConfig, StackConfig
from mavfi.errors import BadInputError
from mavfi.kernels.perception.state_estimation import Noise
from mavfi.numerics.voxels import Grid
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.states import ODOMETRY, Stage, State


class Kernel(Protocol):
    """One computation of the pipeline (one node of a ROS graph)."""

    @property
    def name(self) -> str:
        """As in the latency table of a platform."""

    @property
    def stage(self) -> Stage:
        """The stage that is run again on an alarm."""

    @property
    def reads(self) -> tuple[str, ...]:
        """Names of the states that it reads, rows of the state table."""

    @property
    def writes(self) -> tuple[str, ...]:
        """Names of the states that it publishes, rows of the state table."""

    def receive(self, state: State, time_us: int) -> bool:
        """Note an input; says whether a step is due now."""

    def step(self, time_us: int) -> list[State]:
        """Compute once on the inputs noted last; gives the states to publish."""

    def mark(self) -> None:
        """Remember the memory as it is."""

    def rollback(self) -> None:
        """Put the memory back to the last mark; inputs stay."""

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """Begin where a node that died left off, before anything is received: read its own last outputs back.

        Args:
            last: The last publication of each state, as consumers saw it.
            time_us: Now.

        Returns:
            States whose last publication is taken in by this, and is not to be received again.
        """


def repeat(kernel: Kernel) -> None:
    """Prepare a kernel to take its last step again, on the inputs that it had."""
    getattr(kernel, "again", kernel.rollback)()


@dataclass(frozen=True, slots=True)
class PipelineConfig:
    """All that the pipeline knows of a mission.

    Attributes:
        stack: Rules of the autopilot profile.
        planner: Search.
        map: Update rule.
        camera: Geometry of the sensor.
        directions: Ray of each pixel, camera frame x forward, y left, z up. Shape (n, 3).
        arena_lower: Corner of the mapped volume, world frame (m). Shape (3,).
        arena_upper: Opposite corner of the arena (m). Shape (3,).
        flight_lower: Corner of the box in which paths may lie (m). Shape (3,).
        flight_upper: Opposite corner of the flight volume (m). Shape (3,).
        goal: World frame (m). Shape (3,).
        seed: Mission seed: planner randomness is drawn from it.
        v_max: m/s.
        a_max: m/s^2.
        plan_radius: m.
        check_radius: m.
        control_period_us: Between two commands.
        tracker_slowdown: Loop time of the tracker / reference time it advances.
        map_latency: From image to collision status (s).
        plan_latency: From request to trajectory (s).
        velocity_lag: Time constant of the vehicle's velocity loop (s).
        noise: Noise that the state estimator assumes; None = the pipeline receives the true state.
        rewindable: Whether maps keep journals, so that they can go back to any earlier instant.
        functions: Compiled functions of the kernels; a host may hand in instrumented ones.
    """

    stack: StackConfig
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

    @property
    def odometry(self) -> str:
        """The state that says where the vehicle is."""
        return ODOMETRY["truth" if self.noise is None else "estimator"]


HORIZONTAL_MARGIN = 5.0
VERTICAL_MARGIN = 0.5
LARGEST_GRID = 1 << 27
"""Voxels; the pipeline keeps about 25 bytes for each."""


def map_grid(config: PipelineConfig) -> Grid:
    """The grid of the map: the arena with a margin, offset by half a voxel so that the ground lies inside a layer.

    Raises:
        BadInputError: The resolution is too fine for this arena.
    """
    resolution = config.map.resolution
    margin = np.array([HORIZONTAL_MARGIN, HORIZONTAL_MARGIN, VERTICAL_MARGIN])
    first = np.floor((config.arena_lower - margin) / resolution + 0.5)
    last = np.ceil((config.arena_upper + margin) / resolution + 0.5)
    lower = (first - 0.5) * resolution
    nx, ny, nz = (int(n) for n in last - first)
    voxels = nx * ny * nz
    if voxels > LARGEST_GRID:
        finest = resolution * (voxels / LARGEST_GRID) ** (1.0 / 3.0)
        raise BadInputError(
            f"map resolution {resolution:g} m: {voxels:,} voxels in this arena; allowed: about {finest:.2g} m or more"
        )
    return Grid(float(lower[0]), float(lower[1]), float(lower[2]), 1.0 / resolution, nx, ny, nz)
