"""Compilation of a mission's kernels, stage by stage.

A flight compiles one function after the other, as it needs them.  Its stages need each other's results, but not each
other's code: processes that compile one stage each are done sooner, and every process then finds the code in the cache.
"""

from collections.abc import Callable

import numpy as np

from mavfi.flight.compose import new_loop
from mavfi.flight.loop import Loop
from mavfi.flight.state import EventKind
from mavfi.mission import Scenario
from mavfi.rewriting import check_flown
from mavfi.sim.camera import pixel_directions
from mavfi.sim.environments import World
from mavfi.states import new_state, rows

_LATER_US = 1_000_000
"""Simulated time within which the results of a stage have reached their readers (us)."""
_PERIODS = 3
"""Control periods after which the tracker follows a way-point."""
_STANDARD_GRAVITY = 9.81
"""What the accelerometer of a plant at rest measures (m/s^2)."""


class _Standing:
    """A plant that stays at the start and sees a wall: the pipeline's stages are compiled without the simulator's code.

    Attributes:
        odometry: See `mavfi.flight.plant.Plant`, as all others.
        collided: False.
        rejected_commands: 0.
        ray_directions: As of the mission's camera, read-only like these.
    """

    def __init__(self, world: World, scenario: Scenario) -> None:
        self.odometry = np.zeros(13)
        self.odometry[:3] = world.start
        self.odometry[6] = 1.0
        self.collided = False
        self.rejected_commands = 0
        self.ray_directions = pixel_directions(scenario.camera)
        self.ray_directions.flags.writeable = False
        self._ranges = np.full(len(self.ray_directions), 0.5 * scenario.camera.range, np.float32)

    def command(self, velocity_yaw_rate: np.ndarray, duration: float) -> None:
        """See `Plant.command`."""

    def advance(self, time_us: int) -> None:
        """See `Plant.advance`."""

    def depth(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Plant.depth`."""
        return self._ranges, np.concatenate([self.odometry[:3], self.odometry[6:10]])

    def imu(self) -> np.ndarray:
        """See `Plant.imu`."""
        return np.array([0.0, 0.0, _STANDARD_GRAVITY, 0.0, 0.0, 0.0])

    def position_fix(self) -> np.ndarray:
        """See `Plant.position_fix`."""
        return np.array([*self.odometry[:3], 0.0])

    def warnings(self) -> list[str]:
        """See `Plant.warnings`."""
        return []

    def snapshot(self) -> None:
        """See `Plant.snapshot`."""

    def restore(self, snapshot: None) -> None:
        """See `Plant.restore`."""

    def is_at(self, snapshot: None) -> bool:
        """See `Plant.is_at`."""
        return True

    def close(self) -> None:
        """See `Plant.close`."""


def follow_path(scenario: Scenario) -> None:
    """Compile what follows from a path with a corner: the trajectory, its check, and tracking."""
    loop = new_loop(scenario, make_plant=_Standing)
    corners = np.linspace(loop.world.start, loop.world.goal, 3)
    corners[1, :2] += 1.0
    path = new_state("planning.path", len(corners))
    rows(path.elements, 3)[:] = corners
    loop.sense(0)
    loop.publish(path, 0)
    _run(loop, periods=_PERIODS)


def plan_path(scenario: Scenario) -> None:
    """Compile the planner: a plan on an empty map."""
    loop = new_loop(scenario, make_plant=_Standing)
    loop.sense(0)
    loop.publish(new_state("perception.map_update"), 0)
    loop.start(loop.kernels["planner"], 0)


def see(scenario: Scenario) -> None:
    """Compile perception, and how a path around what it sees is shortened: what follows from a depth image."""
    loop = new_loop(scenario, make_plant=_Standing)
    loop.sense(0)
    loop.publish(loop.sensors.depth(loop.state), 0)
    _run(loop, periods=_PERIODS)


def move(scenario: Scenario) -> None:
    """Compile the plant: vehicle, flight controller, wind, and camera."""
    loop = new_loop(scenario)
    plant = loop.plant
    plant.command(np.zeros(4), 1.0)
    plant.advance(_LATER_US)
    plant.depth()
    plant.close()


def _run(loop: Loop, periods: int = 0) -> None:
    """Run until what was published has reached its readers, and for some control periods."""
    loop.state.schedule(_LATER_US, EventKind.TICK)
    loop.run(until=periods)


STAGES: dict[str, Callable[[Scenario], None]] = {
    "follow_path": follow_path,
    "plan_path": plan_path,
    "move": move,
    "see": see,
}
"""Parts of a flight by name, the one that takes longest first."""


def compile_stage(stage: str, scenario: Scenario) -> None:
    """Compile one of `STAGES`.

    Raises:
        BadInputError: The scenario cannot be flown, or its protection is for other code.
    """
    with np.errstate(all="ignore"):
        STAGES[stage](scenario)
    check_flown(scenario.protection)
