"""Our vehicle as AirSim's API shows it: NED, tasks that take time, collisions, reset; its owner advances the time."""

import hashlib
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavfi.extras.airsim.frames import Triple, flipped, turned
from mavfi.faults.levels.sensor.failures import Failures
from mavfi.flight.compose import resolve
from mavfi.flight.sensor_faults import FailingController
from mavfi.mission import MissionSpec, Scenario
from mavfi.numerics.rotations import yaw_of
from mavfi.sim.environments import build_world
from mavfi.sim.environments.world import World
from mavfi.sim.grounded import Contact, Grounded
from mavfi.sim.scene import STEP_US

TICK_US = 20_000
"""Period of a task: AirSim's getCommandPeriod."""
EPOCH_NS = 1_600_000_000_000_000_000
"""Time stamp of the start of a simulation (ns)."""
LANDED, FLYING = 0, 1
_AIRBORNE = 0.3
"""Height above which an armed vehicle counts as flying (m)."""
_LANDED_HEIGHT = 0.1
"""Height below which a vehicle at rest counts as landed (m)."""

Task = Generator[None, None, Any]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Ended:
    """A task that ended: its number, and its result or the exception that it raised."""

    number: int
    result: Any


class ApiVehicle:
    """One vehicle in one world, under the API.

    Its state is what its sensors measure, failures included; tasks fly by it.

    Args:
        spec: The mission, of which environment, seed, vehicle, wind and speed limit count.
        on_ground: Whether it starts on the ground with the motors idle, and NED has its origin there; else it hovers at
            the mission's start, and NED is the world's frame, turned.

    Attributes:
        spec: Its mission.
        scenario: The mission, resolved.
        sim: The simulator since the last reset.
        origin: Origin of NED in the world (m). Shape (3,).
        landed: Whether it stands on the ground.
        api: Whether a program controls it.
        failures: Failures of its sensors and motors; they persist across resets.
        ended: Tasks that ended; the owner removes them.

    Raises:
        BadInputError: The mission cannot be flown from the ground.
    """

    spec: MissionSpec
    scenario: Scenario
    sim: Grounded

    def __init__(self, spec: MissionSpec, *, on_ground: bool = True) -> None:
        self.on_ground = on_ground
        self._base_us, self._collided_before = 0, False
        self.ended: list[Ended] = []
        self._task: Task | None = None
        self.failures = Failures()
        self._number, self._task_us = 0, 0
        self._digest = hashlib.sha256()
        self.load(spec)

    def load(self, spec: MissionSpec) -> None:
        """Fly in another world from now on.

        Raises:
            BadInputError: The mission cannot be flown from the ground; the vehicle stays where it is.
        """
        scenario = resolve(spec)
        self._start_in(build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal), scenario)
        self.spec = spec

    def _start_in(self, world: World, scenario: Scenario) -> None:
        """Replace the simulator."""
        sim = Grounded(world, scenario, on_ground=self.on_ground)
        if hasattr(self, "sim"):
            self.cancel()
            self._collided_before = self.has_ever_collided
            self._base_us += self.sim.time_us
            self.sim.close()
        self.sim, self.scenario = sim, scenario
        self._begin()

    def _begin(self) -> None:
        """Set the state of a new simulator."""
        self.origin = self.sim.world.start.copy() if self.on_ground else np.zeros(3)
        self.landed, self.api = self.on_ground, False
        if self.on_ground:
            self.sim.arm(True)  # AirSim's default: the rotors turn from the start on

    def reset(self) -> None:
        """Return to the start, and end a running task with False; time and obstacles are not reset."""
        self._start_in(self.sim.world, self.scenario)

    # ---- state, in NED and FRD --------------------------------------------------------------------------------------
    @property
    def now_us(self) -> int:
        """Time since the first start (us)."""
        return self._base_us + self.sim.time_us

    @property
    def stamp(self) -> int:
        """Time stamp (ns)."""
        return EPOCH_NS + 1000 * self.now_us

    @property
    def believed(self) -> np.ndarray:
        """The state that its sensors measure, as in `Simulator.odometry`. Shape (13,)."""
        return self.failures.state(self.now_us, self.sim.odometry)

    def in_ned(self, odometry: np.ndarray) -> tuple[Triple, Quaternion, Triple, Triple]:
        """Position (m), orientation, velocity (m/s) and rates (rad/s) of a state."""
        place, velocity, rates = odometry[:3] - self.origin, odometry[3:6], odometry[10:13]
        return flipped(place), turned(odometry[6:10]), flipped(velocity), flipped(rates)

    @property
    def position(self) -> Triple:
        """NED (m)."""
        return flipped(self.believed[:3] - self.origin)

    @property
    def velocity(self) -> Triple:
        """NED (m/s)."""
        return flipped(self.believed[3:6])

    @property
    def orientation(self) -> Quaternion:
        """Body FRD to NED. w x y z."""
        return turned(self.believed[6:10])

    @property
    def rates(self) -> Triple:
        """FRD (rad/s)."""
        return flipped(self.believed[10:13])

    def imu(self) -> np.ndarray:
        """Specific force (m/s^2) and rates (rad/s), body frame (z up), with noise. Shape (6,)."""
        return self.failures.imu(self.now_us, self.sim.imu())

    @property
    def yaw(self) -> float:
        """Clockwise from north (rad)."""
        return float(yaw_of(np.array(self.orientation)))

    @property
    def collision(self) -> Contact | None:
        """The last contact that is a collision: with an obstacle, and for a start in the air also with the ground."""
        if self.sim.touched is not None or self.on_ground:
            return self.sim.touched
        return self.sim.landed_at

    @property
    def has_collided(self) -> bool:
        """Whether there was a collision; for a start in the air, by the rule of missions."""
        return self.sim.touched is not None if self.on_ground else self.sim.collided

    @property
    def has_ever_collided(self) -> bool:
        """Whether there was a collision, also before a reset or a change of pose."""
        return self._collided_before or self.has_collided

    def to_world(self, ned: Triple) -> np.ndarray:
        """A place in the world's frame (m). Shape (3,)."""
        place: np.ndarray = np.array(flipped(ned)) + self.origin
        return place

    def to_ned(self, place: np.ndarray) -> Triple:
        """A place of the world in NED (m)."""
        return flipped(place - self.origin)

    def digest(self) -> str:
        """SHA-256 of all states so far, every 20 ms and at the end of each step."""
        return self._digest.hexdigest()

    # ---- time -------------------------------------------------------------------------------------------------------
    def step(self, until_us: int) -> None:
        """Let time pass up to an instant, a multiple of 4 ms; a task acts every 20 ms from its start."""
        while self.now_us < until_us:
            upto = min(until_us, self.now_us + TICK_US)
            if self._task is not None:
                upto = min(upto, self._task_us)
            self._let_controller_fail()
            self.sim.advance(upto - self._base_us)
            self._digest.update(self.sim.odometry.tobytes())
            if self.sim.armed and self.sim.height > _AIRBORNE:
                self.landed = False
            elif self.sim.resting:
                self.landed = True
            if self._task is not None and self.now_us >= self._task_us:
                self._act()

    def _let_controller_fail(self) -> None:
        """With failures, the controller reads and commands through them; arming and placing replace it."""
        sim = self.sim
        if self.failures.active and not isinstance(sim.controller, FailingController):
            sim.controller = FailingController(sim.controller, self.failures, sim.max_thrust, self._base_us)

    def _act(self) -> None:
        """One period of the task."""
        assert self._task is not None  # precondition
        try:
            next(self._task)
        except StopIteration as end:
            self._end(end.value)
        except Exception as error:  # noqa: BLE001 - becomes the answer
            self._end(error)
        else:
            self._task_us = self.now_us + TICK_US

    # ---- tasks ------------------------------------------------------------------------------------------------------
    @property
    def busy(self) -> bool:
        """Whether a task runs."""
        return self._task is not None

    def start(self, task: Task) -> int:
        """Start a task, whose first period is now, and end the previous one with False; returns its number."""
        self.cancel()
        self._number += 1
        self._task = task
        self._act()
        return self._number

    def cancel(self) -> None:
        """End the running task, if any, with False."""
        if self._task is not None:
            self._task.close()
            self._end(False)

    def _end(self, result: Any) -> None:
        self._task = None
        self.ended.append(Ended(self._number, result))
        self.sim.rotors = None
        self.sim.command(np.zeros(4), 0.0)

    def finish(self, longest_us: int) -> None:
        """Let time pass until the task ends, but not beyond an instant (us)."""
        while self._task is not None and self.now_us < longest_us:
            self.step(min(longest_us, max(self._task_us, self.now_us + STEP_US)))

    def send(self, velocity: Triple, yaw_rate: float, seconds: float) -> None:
        """Command a velocity (NED, m/s) and yaw rate (rad/s, clockwise) for a time (s)."""
        self.sim.command(np.array([*flipped(velocity), -yaw_rate]), seconds)

    def place(self, position: Triple, orientation: tuple[float, float, float, float]) -> None:
        """Put it to a pose (NED)."""
        collided = self.has_ever_collided
        self.sim.place(self.to_world(position), np.array(turned(orientation)))
        self._collided_before = collided
        self.note_landing()

    def note_landing(self) -> None:
        """Set `landed` by the height."""
        self.landed = self.sim.height < _LANDED_HEIGHT
