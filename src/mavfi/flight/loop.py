"""Event loop of one flight in integer microseconds; plant, kernels and taps are injected dependencies.

The plant advances to the current instant; kernels step when their period elapses or their input arrives; results are
published through the taps after the platform's latency; the control command drives the plant; a status ends the flight.
"""

import heapq
import math
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any
from weakref import proxy

import numpy as np

from mavfi.config import LocalizationConfig
from mavfi.faults.acted_on import ActedOn
from mavfi.flight.decide import SCANNING, Action, Response
from mavfi.flight.host import Flight
from mavfi.flight.latencies import Latencies, latency
from mavfi.flight.plant import Plant
from mavfi.flight.state import EventKind, FlightState
from mavfi.flight.taps import Taps
from mavfi.mission import FLY_AWAY_MARGIN, DeadNode, MissionStatus, Scenario, time_limit
from mavfi.numerics.jit import redirected
from mavfi.pipeline.functions import Compiled
from mavfi.pipeline.kernel import Kernel, repeat
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
_REQUESTED_AT_TICKS = tuple(
    name for name, spec in KERNELS.items() if spec.stage is Stage.PLANNING and spec.trigger == "input"
)
"""Kernels whose requested recomputation starts at the next control period, not at the next input."""


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
class Sensors:
    """The sensors of one flight; `estimating`: whether an estimator is used.

    With an estimator, the true pose is published only through sensors: an image carries the last estimate published to
    consumers, whereas the camera renders from the true pose.
    """

    def __init__(self, plant: Plant, localization: LocalizationConfig) -> None:
        self.estimating = localization.kind == "estimator"
        self._plant = plant
        self._period_us = localization.position_period_us

    def samples_between(self, now: int, later: int) -> range:
        """Sampling instants of the IMU (us) between `now` and the next control period `later`, both exclusive."""
        if self.estimating:
            return range(now + STEP_US, later, STEP_US)
        return range(0)

    def depth(self, flight: FlightState) -> State:
        """A depth image with the pose at which consumers take it to be recorded."""
        ranges, pose = self._plant.depth()
        if self.estimating:
            pose = flight.estimate
        state = new_state("sensor.depth", len(ranges))
        floats(state.header, 7)[:] = pose
        state.elements["range"] = ranges
        return state

    def motion(self, flight: FlightState) -> list[State]:
        """Motion sensors: the true odometry; or an IMU sample, preceded by a position fix when one is due."""
        if not self.estimating:
            return [_state(ODOMETRY["truth"], self._plant.odometry)]
        measured = []
        if flight.now >= flight.next_fix_us:
            flight.next_fix_us += self._period_us
            measured.append(_state("sensor.position", self._plant.position_fix()))
        return [*measured, _state("sensor.imu", self._plant.imu())]


def _state(name: str, values: np.ndarray) -> State:
    state = new_state(name)
    floats(state.header, len(values))[:] = values
    return state


# ---- what a flight leaves -------------------------------------------------------------------------------------------
class Profiler:
    """Recorder of the publication times of each state, from which faults are sampled."""

    def __init__(self, states: Iterable[StateSpec]) -> None:
        self._acted_on = {spec.name: ActedOn(spec) for spec in states}
        self._times: dict[str, list[int]] = {name: [] for name in self._acted_on}
        self._sizes: dict[str, list[int]] = {name: [] for name in self._acted_on}

    def __call__(self, state: State, time_us: int) -> None:
        """Note a publication that consumers act on."""
        name = state.spec.name
        if self._acted_on[name](state):
            self._times[name].append(time_us)
            self._sizes[name].append(len(state.elements))

    def profile(self) -> Profile:
        """Times and sizes so far."""
        return Profile(
            {name: np.array(times, np.int64) for name, times in self._times.items()},
            {name: np.array(sizes, np.int32) for name, sizes in self._sizes.items()},
        )


class LoopRecord:
    """Record of one flight: rows, events, alarms with the outcomes known so far, counts, and modelled times (us).

    Attributes:
        publications: Number of publications of each state.
        calls: Number of calls of compiled functions, in flights that address faults by them; else it is empty.
    """

    def __init__(self, kernels: Iterable[str], states: Iterable[str]) -> None:
        self.rows: list[np.ndarray] = []
        self.events: list[Event] = []
        self.alarms: list[AlarmRecord] = []
        self.compute_us = dict.fromkeys(kernels, 0)
        self.recompute_us = {stage.value: 0 for stage in STAGE_KERNELS}
        self.publications = dict.fromkeys(states, 0)
        self.calls: dict[str, int] = {}

    def note(self, now: int, kind: str, data: dict[str, object]) -> None:
        """Append an event."""
        self.events.append(Event(now, kind, data))

    def published(self, state: State, now: int) -> None:
        """Count a publication and record the corresponding event, if any."""
        name = state.spec.name
        self.publications[name] += 1
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
        tables = self.calls, self.compute_us, self.recompute_us, self.publications
        return tuple(number for table in tables for number in table.values())

    def set_counts(self, counts: Iterable[int]) -> None:
        """Inverse of `counts`; tables returned earlier are not modified."""
        rest = iter(counts)
        self.calls = {name: next(rest) for name in self.calls}
        self.compute_us = {name: next(rest) for name in self.compute_us}
        self.recompute_us = {name: next(rest) for name in self.recompute_us}
        self.publications = {name: next(rest) for name in self.publications}


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
class Loop:
    """One flight.

    In its methods, `flight` is the state of the flight, `state` a published value.

    Args:
        scenario: The mission.
        world: Its world.
        plant: The vehicle, in its initial state.
        make_kernels: Constructs the kernels by name; they may be proxies of remote ones.
        marks: Whether kernels are marked before their steps, which allows recomputation.

    Attributes:
        state: All that changes in the flight, besides plant, kernels and record.
        taps: Taps of every published state; hosts install theirs before the flight.
        listeners: Called at the named moments of the flight, in list order.
        profiler: One of the recorders, whose profile becomes part of the flight; None = no profile is wanted.
        renew: Constructs the kernels of a dead node, given one of them (others are ignored); {} = it never returns.
        restart: Starts the node of a kernel again, see `flight.restarts`; set by what schedules restarts.
        verify: Called with a kernel, the results of a step, and the instant (us); returns the results to publish and
            the additional time (us).  None = results are published unverified.
        stand_ins: Functions of plug-ins, each with what is called instead while the loop runs.
        repeating: Whether the current step repeats another one for verification; never between two events.
        forked: Whether this process was forked for an injected call.
    """

    def __init__(
        self,
        scenario: Scenario,
        world: World,
        plant: Plant,
        make_kernels: Callable[[], dict[str, Kernel]],
        *,
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
        self.record = LoopRecord(self.kernels, states_with(scenario.localization.kind))

        # what takes part in all flights of this loop
        self.listeners: list[Listener] = []
        self.profiler: Profiler | None = None
        self.stand_ins: tuple[tuple[Compiled, Compiled], ...] = ()
        self.repeating = False
        self.forked = False
        self._start_position = plant.odometry[:3].copy()
        self.reset()

    def reset(self) -> None:
        """Prepare for another flight: state before take-off, no taps.

        Plant, kernels and record are restored from a checkpoint, see `flight.checkpoints`.
        """
        self.state = FlightState(self._start_position.copy())
        self.taps = Taps()
        self.verify: Callable[[Kernel, list[State], int], tuple[list[State], int]] | None = None
        # Set by `Restarts`, without which no event asks for a restart.
        self.restart: Callable[[int, str, DeadNode], None]

    @property
    def now(self) -> int:
        """The current instant (us)."""
        return self.state.now

    @property
    def status(self) -> MissionStatus | None:
        """The final status; None = the mission continues."""
        return self.state.status

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
    def call_at(self, time_us: int, function: Callable[[int], None]) -> None:
        """Call a function with an instant (us) at that instant; checkpoints must not be taken until then."""
        self.state.schedule(time_us, EventKind.CALL, function)

    def fly(self) -> Flight:
        """Run until the mission has a status; deterministic, byte for byte."""
        with np.errstate(all="ignore"):  # overflow of corrupted values is expected behaviour
            self.begin()
            self.run()
            return self.flight()

    def begin(self) -> None:
        """Schedule the first events; with an estimator, the first image requires an estimate."""
        first_events = [EventKind.CAPTURE, EventKind.TICK]
        if self.sensors.estimating:
            first_events.reverse()
        for kind in first_events:
            self.state.schedule(0, kind)

    def run(self, until: int = sys.maxsize) -> None:
        """Run until the mission has a status, or until `until` control periods have elapsed and the next is due."""
        with redirected(self.stand_ins):
            self._run(until)

    def _run(self, until: int) -> None:
        """Handle the events of `run`, in order."""
        flight = self.state
        while flight.status is None:
            _, _, kind, _ = flight.queue[0]
            if kind is EventKind.TICK and len(self.record.rows) >= until:
                return
            flight.now, _, kind, arguments = heapq.heappop(flight.queue)
            # The plant stops at the first physics step at or after this instant: -(-a // b) rounds a / b up.
            self.plant.advance(-(-flight.now // STEP_US) * STEP_US)
            HANDLERS[kind](self, flight.now, *arguments)

    def fly_until(self, may_stop: Callable[[], bool]) -> Flight | None:
        """Fly until `may_stop`, called after each control period, is true, which returns None; or to the end."""
        self.begin()
        while self.status is None and not may_stop():
            self.run(len(self.record.rows) + 1)
        if self.status is None:
            return None
        return self.flight()

    def end(self, status: MissionStatus) -> None:
        """End the mission after the event in progress."""
        self.state.status = status

    def flight(self) -> Flight:
        """The flight; requires that the mission has a status."""
        assert self.status is not None  # precondition
        for listener in self.listeners:
            listener.before_end()
        for text in self.plant.warnings():
            self.record.note(self.now, "warning", {"text": text})
        log = self.log(self.status, self.plant.rejected_commands)
        profile = None
        if self.profiler is not None:
            profile = self.profiler.profile()
        return Flight(log, profile, self.world, self.kernels)

    # ---- sensors and the control period -----------------------------------------------------------------------------
    def capture(self, now: int) -> None:
        """Take a depth image, or reuse the last one if a recomputation of perception is requested."""
        self.state.captured_us = now
        self.state.is_mapped = False
        request = self.state.requests.pop(SCANNING[0], None)
        if request is not None:
            self.recompute(request, now)
            return
        if self.marks:
            for name in SCANNING:
                self.kernels[name].mark()
        self.deliver(self.sensors.depth(self.state), now)

    def tick(self, now: int) -> None:
        """One control period: evaluate the status, sample the motion sensors, start the periodic kernels."""
        flight = self.state
        for listener in self.listeners:
            listener.before_tick(now)
        flight.status = flight.status or self.judge.status(self.plant, flight.failed_plans, now)
        # The row of this control period, see `record.COLUMNS`.
        row = np.concatenate(([1e-6 * now], self.plant.odometry, flight.command, flight.reference))
        self.record.rows.append(row)
        if flight.status is None:
            self._control_period(now)
        for listener in self.listeners:
            listener.after_tick(now)

    def _control_period(self, now: int) -> None:
        """Sample the sensors, start the periodic kernels, and schedule the next control period."""
        flight = self.state
        self.sense(now)
        for later in self.sensors.samples_between(now, now + CONTROL_PERIOD_US):
            flight.schedule(later, EventKind.SENSE)
        for name in PERIODIC:
            if name not in flight.busy:
                self.start(self.kernels[name], now)
        flight.schedule(now + CONTROL_PERIOD_US, EventKind.TICK)
        for name in _REQUESTED_AT_TICKS:
            if name in flight.requests and name not in flight.busy:
                self.start(self.kernels[name], now)

    def sense(self, now: int) -> None:
        """Publish the motion sensors: odometry, or the estimator's inputs."""
        for state in self.sensors.motion(self.state):
            self.deliver(state, now)

    # ---- kernels ----------------------------------------------------------------------------------------------------
    def start(self, kernel: Kernel, now: int, latency_us: int | None = None) -> None:
        """Step an idle kernel, or repeat its step on request; results are published after its latency.

        `latency_us` overrides the kernel's latency.
        """
        if kernel.name not in SCANNING:  # perception is recomputed and marked as a whole, by `capture`
            request = self.state.requests.pop(kernel.name, None)
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
        if kernel.name in self.state.down:
            return
        self.record.compute_us[kernel.name] += self.latencies.of_kernel(kernel.name, now)
        if latency_us == 0:
            self._deliver_all(kernel.name, states, now)
            return
        self.state.busy[kernel.name] = None
        self.state.schedule(now + latency_us, EventKind.STEP_DONE, kernel.name, states)

    def _step_done(self, now: int, name: str, states: list[State]) -> None:
        """Publish the results of a kernel whose latency has elapsed, and start its pending input."""
        flight = self.state
        if name in flight.down:
            return
        pending_input = flight.busy.pop(name, None)
        self._deliver_all(name, states, now)
        if pending_input is None or name in flight.down:
            return
        kernel = self.kernels[name]
        if name in flight.busy:  # it is being recomputed: the pending input remains pending
            flight.busy[name] = flight.busy[name] or pending_input
        elif kernel.receive(pending_input, now):
            self.start(kernel, now)

    def _deliver_all(self, name: str, states: list[State], now: int) -> None:
        """Publish a kernel's results; the response to an alarm may terminate its node midway."""
        for state in states:
            if name not in self.state.down:
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

    def lost(self, state: State, now: int) -> None:
        """A message is lost in transit: without this scan, perception is ready for the next image."""
        if state.spec.name == "sensor.depth" or state.spec.writer in SCANNING:
            self._next_image(now)

    def _next_image(self, now: int) -> None:
        """Schedule the next image: now, but not before the camera has one."""
        flight = self.state
        if self.taps.loses_unnoticed and any(kind is EventKind.CAPTURE for _, _, kind, _ in flight.queue):
            return  # else scans that arrive twice or out of order would multiply
        flight.schedule(max(now, flight.captured_us + self.scenario.camera.period_us), EventKind.CAPTURE)

    def transmit(self, state: State, time_us: int) -> None:
        """Let a message arrive at an instant (us) that the injector has held back, or sends once more."""
        self.state.schedule(time_us, EventKind.ARRIVE, state)

    def _arrive(self, now: int, state: State) -> None:
        """Hand a message that was held back or sent once more to its consumers."""
        seen = self.taps.arrive(state, now)
        if seen is not None:
            self.publish(seen, now)

    def publish(self, state: State, now: int) -> None:
        """Hand a value to its consumers, and start the steps that it makes due."""
        flight = self.state
        name = state.spec.name
        self.record.published(state, now)

        # Its consumers: a kernel whose step becomes due starts at once, or when its step in progress is done.
        for kernel in self.readers[name]:
            if kernel.receive(state, now) and kernel.name not in PERIODIC:
                if kernel.name in flight.busy:
                    flight.busy[kernel.name] = state
                else:
                    self.start(kernel, now)

        # What the loop itself does with the value.
        match name:
            case "control.command":  # the flight controller receives it
                values = floats(state.header, 5)
                flight.command = values[:4].copy()
                self.plant.command(flight.command, float(values[4]))
            case "planning.waypoint":  # later rows of the record have it as their reference
                flight.reference = floats(state.header, 3).copy()
            case "perception.odometry":  # later images carry the pose of this estimate
                values = floats(state.header, 10)
                flight.estimate = np.concatenate([values[:3], values[6:]])
            case "perception.map_update":  # the map contains the scan; the collision check that follows ends perception
                flight.is_mapped = True
            case "perception.collision_status" if flight.is_mapped:  # perception is ready for the next image
                flight.is_mapped = False
                self._next_image(now)
            case "planning.path" if len(state.elements) == 0:
                flight.failed_plans += 1
            case "planning.path":
                flight.failed_plans = 0

    # ---- recovery ---------------------------------------------------------------------------------------------------
    def recompute(self, action: Action, now: int) -> None:
        """Restore memory and repeat the step, or request another way-point; charges the latency again."""
        kernel: Any = self.kernels[action.kernel]
        cost_us = self.charge(action, now)

        # Requests to the setpoint generator, which answers with a way-point.
        if action.kind is Response.STOP:
            self.finish(kernel, kernel.stop(), now, cost_us)
            return
        if action.kind is Response.ABANDON:
            self.finish(kernel, kernel.abandon(now), now, cost_us)
            return

        # The step of one kernel, on its previous inputs and with its own latency.
        if action.alone:
            repeat(kernel)
            self.start(kernel, now)
            return

        # The whole stage, with the latency of the stage; in perception each kernel charges its own.
        for name in action.restores:
            self.kernels[name].rollback()
        if action.kernel in SCANNING:
            self.start(kernel, now)
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

    # ---- nodes ------------------------------------------------------------------------------------------------------
    def take_down(self, names: Collection[str]) -> None:
        """Take the kernels of a node down: their step in progress is lost, and so are recomputations."""
        flight = self.state
        flight.down.update(names)
        for name in names:
            flight.busy[name] = None
            flight.requests.pop(name, None)
        for state in list(flight.awaited):
            if STATES[state].writer in names:
                del flight.awaited[state]  # the recomputation died with the node: its next publication is checked

    def bring_back(self, kernels: Collection[Kernel]) -> None:
        """Replace the kernels of a node that was down; nothing is pending for them."""
        for kernel in kernels:
            self.kernels[kernel.name] = kernel
            self.state.down.discard(kernel.name)
            self.state.busy.pop(kernel.name, None)
        for state, readers in self.readers.items():
            self.readers[state] = [self.kernels[reader.name] for reader in readers]

    def repeat_step(self, name: str, now: int, states: list[State]) -> None:
        """Publish the results of a kernel's step that is repeated now one latency later; it is down meanwhile."""
        cost_us = self.latencies.of_kernel(name, now)
        if cost_us <= 0:
            return  # a result without latency is published as in the error-free case
        self.record.recompute_us[self.kernels[name].stage.value] += cost_us
        self.state.busy[name] = None
        self.state.down.add(name)
        self.state.schedule(now + cost_us, EventKind.REPETITION_DONE, name, states)

    def _repetition_done(self, now: int, name: str, states: list[State]) -> None:
        """Publish the results of a repeated step, and take up the kernel's pending input."""
        flight = self.state
        kernel = self.kernels[name]
        flight.down.discard(name)
        pending_input = flight.busy.pop(name)
        self.finish(kernel, states, now, self.latencies.of_kernel(name, now))
        if name in flight.busy:
            flight.busy[name] = pending_input
        elif pending_input is not None and kernel.receive(pending_input, now) and name not in PERIODIC:
            self.start(kernel, now)

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
            "publications": record.publications,
            "rejected_commands": rejected_commands,
        }
        injections = [] if injector is None else injector.finish()
        return FlightLog(np.array(record.rows), status, record.events, injections, record.alarms, meta)


HANDLERS: dict[EventKind, Callable[..., None]] = {
    EventKind.TICK: Loop.tick,
    EventKind.CAPTURE: Loop.capture,
    EventKind.SENSE: Loop.sense,
    EventKind.STEP_DONE: Loop._step_done,
    EventKind.ARRIVE: Loop._arrive,
    EventKind.RESEND: lambda loop, now, state: loop.deliver(state, now),
    EventKind.REPETITION_DONE: Loop._repetition_done,
    EventKind.RESTART: lambda loop, now, name, policy: loop.restart(now, name, policy),
    EventKind.CALL: lambda _, now, function: function(now),
}
"""What handles an event of each kind; arguments: loop, instant (us), and those that it was scheduled with."""
