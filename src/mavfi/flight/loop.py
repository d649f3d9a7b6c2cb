"""Event loop of one flight in integer microseconds; plant, kernels and taps are injected dependencies.

The plant advances to the current instant; kernels step when their period elapses or their input arrives; results are
published through the taps after the platform's latency; the control command drives the plant; a status ends the flight.
"""

import hashlib
import heapq
import math
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol
from weakref import proxy

import numpy as np

from mavfi.config import LocalizationConfig, PlatformConfig
from mavfi.errors import BadInputError
from mavfi.flight.acted_on import ActedOn
from mavfi.flight.decide import SCANNING, Action, PendingResult, Response
from mavfi.flight.host import Flight
from mavfi.flight.plant import Plant
from mavfi.flight.taps import Taps
from mavfi.mission import FLY_AWAY_MARGIN, MissionStatus, Scenario, time_limit
from mavfi.numerics.jit import redirected
from mavfi.pipeline.functions import Compiled
from mavfi.pipeline.kernel import Kernel, repeat
from mavfi.pipeline.memory import Memory
from mavfi.record import AlarmRecord, Event, FlightLog, Injection, Profile
from mavfi.sim.environments import World
from mavfi.sim.scene import STEP_US
from mavfi.states import (
    KERNELS,
    ODOMETRY,
    PERIODIC,
    STAGE_KERNELS,
    STATES,
    Stage,
    State,
    StateSpec,
    floats,
    new_state,
    states_with,
)

CONTROL_PERIOD_US = 20_000
"""Period of the periodic kernels, of the status and of the log's rows (us)."""
_TICK = "tick"
"""Action of a control period."""
_REQUESTED_AT_TICKS = tuple(
    name for name, spec in KERNELS.items() if spec.stage is Stage.PLANNING and spec.trigger == "input"
)
"""Kernels whose requested recomputation starts at the next control period, not at the next input."""


# ---- modelled computers: latency of results in simulated time -------------------------------------------------------
def latency(platform: PlatformConfig, kernel: str) -> int:
    """Latency of a kernel (us); `BadInputError` if the platform does not define it."""
    if KERNELS[kernel].on_flight_controller:
        return 0
    try:
        return platform.latency_us[kernel]
    except KeyError:
        raise BadInputError(
            f"platform {platform.name}: key 'latency_us': no kernel {kernel!r}; it has {', '.join(platform.latency_us)}"
        ) from None


def stage_latency(platform: PlatformConfig, stage: Stage) -> int:
    """Cost of rerunning a stage (us)."""
    return sum(latency(platform, kernel) for kernel in STAGE_KERNELS[stage])


class Latencies:
    """Latencies as charged in a flight (us).

    On a real computer a kernel takes another time in each run.  With a jitter j, each latency is therefore multiplied
    by a factor drawn uniformly from 1 / (1 + j) to 1 + j.  The factor is a hash of seed, kernel and instant: no
    generator has a state that a checkpoint would have to contain.

    Args:
        platform: The computer.
        seed: Seed of the mission.
        jitter: The jitter j; 0 = none.
    """

    def __init__(self, platform: PlatformConfig, seed: int = 0, jitter: float = 0.0) -> None:
        self._platform = platform
        self._seed = seed
        self._jitter = jitter

    def of_kernel(self, kernel: str, now: int) -> int:
        """Latency of a kernel's step at an instant (us)."""
        nominal_us = latency(self._platform, kernel)
        if self._jitter == 0.0:
            return nominal_us
        return round(nominal_us * self._factor(kernel, now))

    def of_stage(self, stage: Stage, now: int) -> int:
        """Cost of rerunning a stage at an instant (us)."""
        return sum(self.of_kernel(kernel, now) for kernel in STAGE_KERNELS[stage])

    def of_recomputation(self, kernel: str, stage: Stage, now: int) -> int:
        """Cost of recomputing after an alarm on a kernel's result: its stage's; 0 on the flight controller."""
        if KERNELS[kernel].on_flight_controller:
            return 0
        return self.of_stage(stage, now)

    def _factor(self, kernel: str, now: int) -> float:
        """Latency / nominal latency of a kernel's step at an instant (us)."""
        digest = hashlib.blake2b(f"{self._seed} {kernel} {now}".encode(), digest_size=8).digest()
        share = (int.from_bytes(digest, "little") >> 11) / 2**53  # as many bits as a float has, in [0, 1)
        longest = 1.0 + self._jitter
        shortest = 1.0 / longest
        return shortest + (longest - shortest) * share


# ---- when a mission ends --------------------------------------------------------------------------------------------
class MissionJudge:
    """Termination conditions: goal, collision, arena, consecutive failed plans, and the time limit `limit_us` (us)."""

    def __init__(self, scenario: Scenario, world: World) -> None:
        self._goal = world.goal.tolist()
        self._arrival_radius = scenario.arrival_radius
        self._lower = world.arena_lower.tolist()
        self._upper = world.arena_upper.tolist()
        self._max_failed_plans = scenario.autopilot.max_failed_plans
        limit_s = time_limit(world.course, scenario.v_max, scenario.platform, scenario.time_limit_factor)
        self.limit_us = int(1e6 * limit_s)

    def status(self, plant: Plant, failed_plans: int, now: int) -> MissionStatus | None:
        """The final status; None = the mission continues."""
        state = plant.odometry.tolist()  # at 13 elements, NumPy's call overhead exceeds the computation
        if not all(map(math.isfinite, state)):
            return MissionStatus.INVALID_STATE
        if plant.collided:
            return MissionStatus.COLLISION
        if math.dist(state[:3], self._goal) < self._arrival_radius:
            return MissionStatus.SUCCESS
        for low, value, high in zip(self._lower, state, self._upper, strict=False):  # x, y, z
            if low - value > FLY_AWAY_MARGIN or value - high > FLY_AWAY_MARGIN:
                return MissionStatus.FLY_AWAY
        if failed_plans > self._max_failed_plans:
            return MissionStatus.NO_PATH
        if now >= self.limit_us:
            return MissionStatus.TIMEOUT
        return None


# ---- sensors --------------------------------------------------------------------------------------------------------
_ESTIMATE = ODOMETRY["estimator"]


@dataclass(slots=True)
class SensorMemory(Memory):
    """When the next position fix is due (us), and the last estimate published to consumers: position, quaternion."""

    next_fix_us: int = 0
    estimate: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))


class Sensors:
    """The sensors of one flight; `estimating`: whether an estimator is used; `memory`: their state.

    With an estimator, the true pose is published only through sensors: an image carries the last estimate published to
    consumers, whereas the camera renders from the true pose.
    """

    def __init__(self, plant: Plant, localization: LocalizationConfig) -> None:
        self.estimating = localization.kind == "estimator"
        self._plant = plant
        self._period_us = localization.position_period_us
        self.memory = SensorMemory()

    def samples_between(self, now: int, later: int) -> range:
        """Sampling instants of the IMU (us) between `now` and the next control period `later`, both exclusive."""
        if self.estimating:
            return range(now + STEP_US, later, STEP_US)
        return range(0)

    def depth(self) -> State:
        """A depth image with the pose at which consumers take it to be recorded."""
        ranges, pose = self._plant.depth()
        state = new_state("sensor.depth", len(ranges))
        if self.estimating:
            floats(state.header, 7)[:] = self.memory.estimate
        else:
            floats(state.header, 7)[:] = pose
        state.elements["range"] = ranges
        return state

    def motion(self, now: int) -> list[State]:
        """Motion sensors: the true odometry; or an IMU sample, preceded by a position fix when one is due."""
        if not self.estimating:
            return [_state(ODOMETRY["truth"], self._plant.odometry)]
        measured = []
        if now >= self.memory.next_fix_us:
            self.memory.next_fix_us += self._period_us
            measured.append(_state("sensor.position", self._plant.position_fix()))
        return [*measured, _state("sensor.imu", self._plant.imu())]

    def see(self, state: State) -> None:
        """Store the last estimate published to consumers."""
        if state.spec.name == _ESTIMATE:
            values = floats(state.header, 10)
            self.memory.estimate = np.concatenate([values[:3], values[6:]])


def _state(name: str, values: np.ndarray) -> State:
    state = new_state(name)
    floats(state.header, len(values))[:] = values
    return state


# ---- what a flight leaves -------------------------------------------------------------------------------------------
class PublicationCounts:
    """Counts publications by state; if `want_profile`, also records their times, from which faults are sampled."""

    def __init__(self, states: Iterable[StateSpec], *, want_profile: bool) -> None:
        self.want_profile = want_profile
        self._acted_on = {spec.name: ActedOn(spec) for spec in states}
        self.count = dict.fromkeys(self._acted_on, 0)
        self._times: dict[str, list[int]] = {name: [] for name in self._acted_on}
        self._sizes: dict[str, list[int]] = {name: [] for name in self._acted_on}

    def note(self, state: State, time_us: int) -> None:
        """Count a publication."""
        name = state.spec.name
        self.count[name] += 1
        if self.want_profile and self._acted_on[name](state):
            self._times[name].append(time_us)
            self._sizes[name].append(len(state.elements))

    def profile(self) -> Profile | None:
        """The profile; None unless requested."""
        if not self.want_profile:
            return None
        return Profile(
            {name: np.array(times, np.int64) for name, times in self._times.items()},
            {name: np.array(sizes, np.int32) for name, sizes in self._sizes.items()},
        )


class LoopRecord:
    """Record of one flight: rows, events, alarms with the outcomes known so far, and modelled times (us).

    `calls` counts the calls of compiled functions, by name, in flights that address faults by them; else it is empty.
    """

    def __init__(self, kernels: Iterable[str], publications: PublicationCounts) -> None:
        self.rows: list[np.ndarray] = []
        self.events: list[Event] = []
        self.alarms: list[AlarmRecord] = []
        self.compute_us = dict.fromkeys(kernels, 0)
        self.recompute_us = {stage.value: 0 for stage in STAGE_KERNELS}
        self.publications = publications
        self.calls: dict[str, int] = {}

    def write_row(self, now: int, odometry: np.ndarray, command: np.ndarray, reference: np.ndarray) -> None:
        """Append the row of a control period, see `record.COLUMNS`: shapes (13,), (4,) and (3,)."""
        self.rows.append(np.concatenate(([1e-6 * now], odometry, command, reference)))

    def note(self, now: int, kind: str, data: dict[str, object]) -> None:
        """Append an event."""
        self.events.append(Event(now, kind, data))

    def published(self, state: State, now: int) -> None:
        """Count a publication and record the corresponding event, if any."""
        self.publications.note(state, now)
        name = state.spec.name
        header = state.header
        if name == "planning.path":
            vertices = len(state.elements)
            kind = "plan" if vertices else "plan_failed"
            self.note(now, kind, {"vertices": vertices})
        elif name == "planning.trajectory":
            self.note(now, "trajectory", {"seq": int(header["trajectory_seq"][0]), "points": len(state.elements)})
        elif name == "perception.collision_status" and bool(header["collision"][0]):
            self.note(now, "collision_predicted", {"time_to_collision": float(header["time_to_collision"][0])})

    def counts(self) -> tuple[int, ...]:
        """Calls of functions, modelled compute times of kernels, recompute times of stages, and publication counts."""
        tables = self.calls, self.compute_us, self.recompute_us, self.publications.count
        return tuple(number for table in tables for number in table.values())

    def set_counts(self, counts: Iterable[int]) -> None:
        """Inverse of `counts`; tables returned earlier are not modified."""
        rest = iter(counts)
        self.calls = {name: next(rest) for name in self.calls}
        self.compute_us = {name: next(rest) for name in self.compute_us}
        self.recompute_us = {name: next(rest) for name in self.recompute_us}
        self.publications.count = {name: next(rest) for name in self.publications.count}


# ---- what else takes part in a flight -------------------------------------------------------------------------------
class Listener:
    """What hosts, forks and observers may do in a flight; every hook is without effect by default."""

    def begin(self, loop: "Loop") -> None:
        """The flight is about to start; see `Loop.attach`."""

    def before_tick(self, now: int) -> None:
        """A control period begins at this instant (us)."""

    def after_tick(self, now: int) -> None:
        """Status and sensors of a control period are known, and periodic kernels have been started."""

    def after_step(self, kernel: Kernel, states: list[State], now: int) -> None:
        """A kernel has made a step with these results, which are not yet published."""

    def published(self, state: State, now: int) -> None:
        """A value, as consumers receive it."""

    def before_end(self) -> None:
        """The mission has a status."""


# ---- the loop -------------------------------------------------------------------------------------------------------
@dataclass(slots=True)
class LoopMemory(Memory):
    """State of a loop, excluding plant, kernels and taps; attributes as of `Loop`."""

    now: int
    order: int
    queue: list[tuple[int, int, str, tuple[Any, ...]]]
    busy: dict[str, State | None]
    awaited: dict[str, PendingResult]
    requests: dict[str, Action]
    down: set[str]
    mapped: bool
    captured_us: int
    failed_plans: int
    command: np.ndarray
    reference: np.ndarray
    sensing: SensorMemory


class Loop:
    """One flight.

    Args:
        scenario: The mission.
        world: Its world.
        plant: The vehicle, in its initial state.
        make_kernels: Constructs the kernels by name; they may be proxies of remote ones.
        want_profile: Whether to record the publication times of each state.
        marks: Whether kernels are marked before their steps, which allows recomputation.

    Attributes:
        taps: Taps of every published state; hosts install theirs before the flight.
        actions: Additional actions of hosts for the event queue, by name.
        listeners: Called at the named moments of the flight, in list order.
        busy: Kernels whose latency has not elapsed, each with its pending input.
        awaited: Recomputations in progress, by state.
        requests: Recomputations requested for the kernel's next step, by kernel (coupling `observer`).
        down: Kernels whose node is down.
        renew: Constructs the kernels of a dead node, given one of them (others are ignored); {} = it never returns.
        verify: Called with a kernel, the results of a step, and the instant (us); returns the results to publish and
            the additional time (us).  None = results are published unverified.
        stand_ins: Functions of plug-ins, each with what is called instead while the loop runs.
        repeating: Whether the current step repeats another one for verification.
        forked: Whether this process was forked for an injected call.
        mapped: Whether the map contains the scan in progress, whose collision check has not ended.
        captured_us: Instant of the last image (us).
        failed_plans: Number of consecutive plans without a path.
        command: The command in force: velocity (m/s) and yaw rate (rad/s). Shape (4,).
        reference: Position of the way-point in force (m). Shape (3,).
        single_image: Whether an image is requested only if none is scheduled: scans that arrive twice or out of order
            would otherwise multiply.
        status: The final status; None = the mission continues.
    """

    def __init__(
        self,
        scenario: Scenario,
        world: World,
        plant: Plant,
        make_kernels: Callable[[], dict[str, Kernel]],
        *,
        want_profile: bool = False,
        marks: bool = False,
    ) -> None:
        # the mission, and what it is flown with
        self.scenario = scenario
        self.world = world
        self.plant = plant
        self.marks = marks
        self.renew: Callable[[str], Mapping[str, Kernel]] = lambda kernel: make_kernels()
        self.kernels = make_kernels()
        for name in self.kernels:
            latency(scenario.platform, name)  # refuses a platform that lacks a kernel
        self.latencies = Latencies(scenario.platform, scenario.seed, scenario.latency_jitter)
        self.readers: dict[str, list[Kernel]] = {
            name: [kernel for kernel in self.kernels.values() if name in kernel.reads] for name in STATES
        }
        self.sensors = Sensors(plant, scenario.localization)
        self.judge = MissionJudge(scenario, world)
        publications = PublicationCounts(states_with(scenario.localization.kind).values(), want_profile=want_profile)
        self.record = LoopRecord(self.kernels, publications)

        # what takes part in the flight
        self.taps = Taps()
        self.actions: dict[str, Callable[..., None]] = {}
        self.listeners: list[Listener] = []
        self.verify: Callable[[Kernel, list[State], int], tuple[list[State], int]] | None = None
        self.stand_ins: tuple[tuple[Compiled, Compiled], ...] = ()

        # the state of the flight, see `LoopMemory`
        self.queue: list[tuple[int, int, str, tuple[Any, ...]]] = []
        self.order = 0
        self.now = 0
        self.busy: dict[str, State | None] = {}
        self.awaited: dict[str, PendingResult] = {}
        self.requests: dict[str, Action] = {}
        self.down: set[str] = set()
        self.repeating = False
        self.forked = False
        self.single_image = False
        self.mapped = False
        self.captured_us = 0
        self.failed_plans = 0
        self.command = np.zeros(4)
        self.reference = plant.odometry[:3].copy()
        self.status: MissionStatus | None = None

    @property
    def injected(self) -> bool:
        """Whether a fault has been injected."""
        injections: Sequence[Injection] = getattr(self.taps.injector, "injections", ())
        return self.forked or any(injection.activated for injection in injections)

    def attach(self, listener: Listener) -> None:
        """Let a listener take part in the flight, which has not started: it receives publications, too."""
        self.listeners.append(listener)
        self.taps.recorders.append(listener.published)
        listener.begin(self)

    # ---- time -------------------------------------------------------------------------------------------------------
    def at(self, time_us: int, action: str, *arguments: Any) -> None:  # noqa: ANN401 (as the action wants)
        """Schedule a method, or one of `actions`, by name; events of equal time keep the order of their requests."""
        self.order += 1
        heapq.heappush(self.queue, (time_us, self.order, action, arguments))

    def fly(self) -> Flight:
        """Run until the mission has a status; deterministic, byte for byte."""
        with np.errstate(all="ignore"):  # overflow of corrupted values is expected behaviour
            self.begin()
            self.run()
            return self.flight()

    def begin(self) -> None:
        """Schedule the first actions; with an estimator, the first image requires an estimate."""
        if self.sensors.estimating:
            self.at(0, _TICK)
            self.at(0, "capture")
        else:
            self.at(0, "capture")
            self.at(0, _TICK)

    def run(self, until: int = sys.maxsize) -> None:
        """Run until the mission has a status, or until `until` control periods have elapsed and the next is due."""
        with redirected(self.stand_ins):
            self._run(until)

    def _run(self, until: int) -> None:
        """The actions of `run`."""
        while self.status is None:
            _, _, action, _ = self.queue[0]
            if action == _TICK and len(self.record.rows) >= until:
                return
            self.now, _, action, arguments = heapq.heappop(self.queue)
            # the plant stops at the first physics step at or after this instant
            self.plant.advance(-(-self.now // STEP_US) * STEP_US)
            method = self.actions.get(action) or getattr(self, action)
            method(self.now, *arguments)

    def flight(self) -> Flight:
        """The flight; requires that the mission has a status."""
        assert self.status is not None  # precondition
        for listener in self.listeners:
            listener.before_end()
        for text in self.plant.warnings():
            self.record.note(self.now, "warning", {"text": text})
        log = self.log(self.status, self.plant.rejected_commands)
        return Flight(log, self.record.publications.profile(), self.world, self.kernels)

    # ---- sensors and the control period -----------------------------------------------------------------------------
    def capture(self, now: int) -> None:
        """Take a depth image, or reuse the last one if a recomputation of perception is requested."""
        self.captured_us = now
        self.mapped = False
        request = self.requests.pop(SCANNING[0], None)
        if request is not None:
            self.recompute(request, now)
            return
        if self.marks:
            for name in SCANNING:
                self.kernels[name].mark()
        self.deliver(self.sensors.depth(), now)

    def tick(self, now: int) -> None:
        """One control period: evaluate the status, sample the motion sensors, start the periodic kernels."""
        for listener in self.listeners:
            listener.before_tick(now)
        self.status = self.status or self.judge.status(self.plant, self.failed_plans, now)
        self.record.write_row(now, self.plant.odometry, self.command, self.reference)
        if self.status is None:
            self._control_period(now)
        for listener in self.listeners:
            listener.after_tick(now)

    def _control_period(self, now: int) -> None:
        """Sample the sensors, start the periodic kernels, and schedule the next control period."""
        self.sense(now)
        for later in self.sensors.samples_between(now, now + CONTROL_PERIOD_US):
            self.at(later, "sense")
        for name in PERIODIC:
            if name not in self.busy:
                self.start(self.kernels[name], now)
        self.at(now + CONTROL_PERIOD_US, _TICK)
        for name in _REQUESTED_AT_TICKS:
            if name in self.requests and name not in self.busy:
                self.start(self.kernels[name], now)

    def sense(self, now: int) -> None:
        """Publish the motion sensors: odometry, or the estimator's inputs."""
        for state in self.sensors.motion(now):
            self.deliver(state, now)

    # ---- kernels ----------------------------------------------------------------------------------------------------
    def start(self, kernel: Kernel, now: int, latency_us: int | None = None) -> None:
        """Step an idle kernel, or repeat its step on request; results are published after its latency.

        `latency_us` overrides the kernel's latency.
        """
        if kernel.name not in SCANNING:  # perception is recomputed and marked as a whole, by `capture`
            request = self.requests.pop(kernel.name, None)
            if request is not None:
                if request.kind is not Response.RECOMPUTE:
                    kernel.mark()  # the request replaces the step of this period
                self.recompute(request, now)
                return
            if self.marks:
                kernel.mark()
        states = kernel.step(now)
        cost_us = latency_us
        if cost_us is None:
            cost_us = self.latencies.of_kernel(kernel.name, now)
        if self.verify is not None:
            states, verification_us = self.verify(kernel, states, now)
            cost_us += verification_us
        self.finish(kernel, states, now, cost_us)

    def finish(self, kernel: Kernel, states: list[State], now: int, latency_us: int) -> None:
        """Publish a kernel's results after a latency; results of a dead node are lost."""
        for listener in self.listeners:
            listener.after_step(kernel, states, now)
        if kernel.name in self.down:
            return
        self.record.compute_us[kernel.name] += self.latencies.of_kernel(kernel.name, now)
        if latency_us == 0:
            self._deliver_all(kernel.name, states, now)
            return
        self.busy[kernel.name] = None
        self.at(now + latency_us, "done", kernel.name, states)

    def done(self, now: int, name: str, states: list[State]) -> None:
        """Publish the results of a kernel whose latency has elapsed, and start its pending input."""
        if name in self.down:
            return
        waiting = self.busy.pop(name, None)
        self._deliver_all(name, states, now)
        if waiting is None or name in self.down:
            return
        kernel = self.kernels[name]
        if name in self.busy:  # it is being recomputed: the pending input remains pending
            self.busy[name] = self.busy[name] or waiting
        elif kernel.receive(waiting, now):
            self.start(kernel, now)

    def _deliver_all(self, name: str, states: list[State], now: int) -> None:
        """Publish a kernel's results; the response to an alarm may terminate its node midway."""
        for state in states:
            if name not in self.down:
                self.deliver(state, now)

    # ---- publications -----------------------------------------------------------------------------------------------
    def deliver(self, state: State, now: int) -> None:
        """Pass a value through the taps to its consumers."""
        seen = self.taps(state, now)
        if seen is not None:
            self.publish(seen, now)

    def watch_losses(self) -> None:
        """From now on, take the next image when the injector loses a message that perception waits for."""
        loop = proxy(self)  # no cycle, so that maps are freed at once
        self.taps.note_loss = lambda state, now: loop.lost(state, now)

    def watch_transit(self) -> None:
        """From now on, the injector may lose whole messages, or let them arrive late or repeatedly.

        Nobody notices that a message did not arrive, except perception, which takes the next image.
        """
        self.watch_losses()
        self.taps.loses_unnoticed = True
        self.single_image = True

    def lost(self, state: State, now: int) -> None:
        """A message is lost in transit: without this scan, perception is ready for the next image."""
        if state.spec.name == "sensor.depth" or state.spec.writer in SCANNING:
            self._next_image(now)

    def _next_image(self, now: int) -> None:
        """Schedule the next image: now, but not before the camera has one."""
        if self.single_image and any(action == "capture" for _, _, action, _ in self.queue):
            return
        self.at(max(now, self.captured_us + self.scenario.camera.period_us), "capture")

    def transmit(self, now: int, state: State) -> None:
        """A value arrives that the injector has held back, or sends once more."""
        seen = self.taps.arrive(state, now)
        if seen is not None:
            self.publish(seen, now)

    def resend(self, now: int, state: State) -> None:
        """Retransmit the producer's copy of a value."""
        self.deliver(state, now)

    def publish(self, state: State, now: int) -> None:
        """Hand a value to its consumers, and start the steps that it makes due."""
        name = state.spec.name
        self.record.published(state, now)
        if name == "planning.path":
            if len(state.elements):
                self.failed_plans = 0
            else:
                self.failed_plans += 1
        for kernel in self.readers[name]:
            if kernel.receive(state, now) and kernel.name not in PERIODIC:
                if kernel.name in self.busy:
                    self.busy[kernel.name] = state
                else:
                    self.start(kernel, now)
        route = _ROUTES.get(name)
        if route is not None:
            route(self, state, now)

    def _command_vehicle(self, state: State, now: int) -> None:
        """The flight controller receives a command."""
        values = floats(state.header, 5)
        self.command = values[:4].copy()
        self.plant.command(self.command, float(values[4]))

    def _see_estimate(self, state: State, now: int) -> None:
        """Later images carry the pose of this estimate."""
        self.sensors.see(state)

    def _set_reference(self, state: State, now: int) -> None:
        """Later rows of the record have this way-point as their reference."""
        self.reference = floats(state.header, 3).copy()

    def _end_mapping(self, state: State, now: int) -> None:
        """The map contains the scan: the collision check that follows ends perception."""
        self.mapped = True

    def _end_perception(self, state: State, now: int) -> None:
        """The collision check of a scan has ended: perception is ready for the next image."""
        if self.mapped:
            self.mapped = False
            self._next_image(now)

    # ---- recovery ---------------------------------------------------------------------------------------------------
    def recompute(self, action: Action, now: int) -> None:
        """Restore memory and repeat the step, or request another way-point; charges the latency again."""
        kernel: Any = self.kernels[action.kernel]
        cost_us = self.charge(action, now)
        # requests to the setpoint generator
        if action.kind is Response.STOP:
            self.finish(kernel, kernel.stop(), now, cost_us)
            return
        if action.kind is Response.ABANDON:
            self.finish(kernel, kernel.abandon(now), now, cost_us)
            return
        # the step of one kernel, or that of its stage
        if action.alone:
            repeat(kernel)
            self.start(kernel, now)
            return
        for name in action.restores:
            self.kernels[name].rollback()
        if action.kernel in SCANNING:
            self.start(kernel, now)  # the kernels after it charge their own latencies
        else:
            self.start(kernel, now, cost_us)

    def charge(self, action: Action, now: int) -> int:
        """Charge a recomputation to its stage; returns its modelled time (us)."""
        if action.alone:
            cost_us = self.latencies.of_kernel(action.kernel, now)
        elif action.kernel:
            cost_us = self.latencies.of_recomputation(action.kernel, action.stage, now)
        else:
            cost_us = self.latencies.of_stage(action.stage, now)
        self.record.recompute_us[action.stage.value] += cost_us
        return cost_us

    # ---- memory -----------------------------------------------------------------------------------------------------
    def memory(self) -> LoopMemory:
        """The loop's state by reference; a checkpoint copies it."""
        return LoopMemory(*(getattr(self, name) for name in LoopMemory.__slots__))

    @property
    def sensing(self) -> SensorMemory:
        """State of the sensors."""
        return self.sensors.memory

    @sensing.setter
    def sensing(self, memory: SensorMemory) -> None:
        self.sensors.memory = memory

    def restore(self, memory: LoopMemory) -> None:
        """Continue from the state `memory`, which remains valid for further restores."""
        restored = memory.copy()
        for name in restored.__slots__:
            setattr(self, name, getattr(restored, name))

    # ---- record -----------------------------------------------------------------------------------------------------
    def log(self, status: MissionStatus, rejected_commands: int) -> FlightLog:
        """The log of a completed flight."""
        record = self.record
        injector = self.taps.injector
        meta = {
            "scenario": self.scenario.to_json(),
            "start": self.world.start.tolist(),
            "goal": self.world.goal.tolist(),
            "course_m": self.world.course,
            "time_limit_s": 1e-6 * self.judge.limit_us,
            "world": self.world.digest(),
            "compute_us": record.compute_us,
            "recompute_us": record.recompute_us,
            "publications": record.publications.count,
            "rejected_commands": rejected_commands,
        }
        injections = [] if injector is None else injector.finish()
        return FlightLog(np.array(record.rows), status, record.events, injections, record.alarms, meta)


_ROUTES: dict[str, Callable[[Loop, State, int], None]] = {
    "control.command": Loop._command_vehicle,
    ODOMETRY["estimator"]: Loop._see_estimate,
    "planning.waypoint": Loop._set_reference,
    "perception.map_update": Loop._end_mapping,
    "perception.collision_status": Loop._end_perception,
}
"""What the loop itself does with a published state, after the kernels that read it."""


# ---- observers ------------------------------------------------------------------------------------------------------
FlightItem = Event | AlarmRecord | Injection


class Observer(Protocol):
    """Receives a running flight; it must not change what it receives."""

    def begin(self, loop: Loop) -> None:
        """The flight is about to start."""

    def published(self, state: State, time_us: int) -> None:
        """A publication, as consumers receive it, and its instant (us)."""

    def tick(self, row: np.ndarray, items: list[FlightItem], status: MissionStatus | None) -> None:
        """A control period has elapsed.

        Args:
            row: Its row in the flight log, see `record.COLUMNS`. Shape (21,).
            items: Events, alarms and injections since the last one.
            status: Status at the end of the mission; None = it has not ended.
        """


class ObserverListener(Listener):
    """Shows a flight to an observer; alarms are reported with the outcome known at the end of their control period.

    Args:
        observer: The observer.
        pace: Flight time per wall time; 0 = as fast as possible.
    """

    def __init__(self, observer: Observer, pace: float = 0.0) -> None:
        self._observer = observer
        self._pace = pace

    def begin(self, loop: Loop) -> None:
        """See `Listener`."""
        self._loop = loop
        self._items_shown = [0, 0, 0]
        self._began = time.monotonic()
        self._observer.begin(loop)

    def published(self, state: State, now: int) -> None:
        """See `Listener`."""
        self._observer.published(state, now)

    def after_tick(self, now: int) -> None:
        """See `Listener`."""
        loop = self._loop
        self._observer.tick(loop.record.rows[-1], _new_items(loop, self._items_shown), loop.status)
        if self._pace > 0 and loop.status is None:
            time.sleep(max(0.0, self._began + 1e-6 * now / self._pace - time.monotonic()))


def _new_items(loop: Loop, seen: list[int]) -> list[FlightItem]:
    """Items since the last call; `seen` counts the earlier ones, by table, and is updated."""
    injections: Any = getattr(loop.taps.injector, "injections", ())
    tables = (injections, loop.record.events, loop.record.alarms)
    counts = [len(table) for table in tables]
    if counts == seen:
        return []
    items = [item for table, count in zip(tables, seen, strict=True) for item in table[count:]]
    seen[:] = counts
    return items
