"""Event loop of one flight in integer microseconds; plant, kernels and taps are injected dependencies.

The plant advances to the current instant; kernels step when their period elapses or their input arrives; results are
published through the taps after the platform's latency; the control command drives the plant; a status ends the flight.
"""

import heapq
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import proxy

import numpy as np

from mavfi.flight.compute import latency, redo_latency, stage_latency
from mavfi.flight.decide import SCANNING, Action, Awaited, Response
from mavfi.flight.host import Flight
from mavfi.flight.judge import Judge
from mavfi.flight.plant import Plant
from mavfi.flight.recording import Publications, Record
from mavfi.flight.sensing import SensorMemory, Sensors
from mavfi.flight.taps import Taps
from mavfi.mission import MissionStatus, Scenario
from mavfi.pipeline.kernel import Kernel, repeat
from mavfi.pipeline.memory import Memory
from mavfi.record import FlightLog, Injection
from mavfi.sim.environments import World
from mavfi.states import KERNELS, ODOMETRY, PERIODIC, STATES, Stage, State, floats, states_with

CONTROL_PERIOD_US = 20_000
_PHYSICS_US = 4_000
_TICK = "tick"
_REQUESTED_AT_TICKS = tuple(
    name for name, spec in KERNELS.items() if spec.stage is Stage.PLANNING and spec.trigger == "input"
)
"""Kernels whose requested recomputation starts at the next control period, not at the next input."""


@dataclass(slots=True)
class LoopMemory(Memory):
    """State of a loop, excluding plant, kernels and taps; attributes as of `Loop`."""

    now: int
    order: int
    queue: list[tuple[int, int, str, tuple[Any, ...]]]
    busy: dict[str, State | None]
    awaited: dict[str, Awaited]
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
        before_tick, after_tick: Called with the instant (us) before and after each control period.
        after_step: Called with a kernel, its results, and the instant (us), before publication.
        before_end: Called when the mission has a status.
        busy: Kernels whose latency has not elapsed, each with its pending input.
        awaited: Recomputations in progress, by state.
        requests: Recomputations requested for the kernel's next step, by kernel (coupling `observer`).
        down: Kernels whose node is down.
        renew: Constructs the kernels of a dead node, given one of them (others are ignored); {} = it never returns.
        verify: Called with a kernel, the results of a step, and the instant (us); returns the results to publish and
            the additional time (us).  None = results are published unverified.
        repeating: Whether the current step repeats another one for verification.
        forked: Whether this process was forked for an injected call.
    """

    def __init__(
        self, scenario: Scenario, world: World, plant: Plant, make_kernels: Callable[[], dict[str, Kernel]], *,
        want_profile: bool = False, marks: bool = False,
    ) -> None:  # fmt: skip
        self.scenario, self.world, self.plant = scenario, world, plant
        self.marks = marks
        self.renew: Callable[[str], Mapping[str, Kernel]] = lambda kernel: make_kernels()
        self.kernels = make_kernels()
        self.latency = {name: latency(scenario.platform, name) for name in self.kernels}
        self.readers: dict[str, list[Kernel]] = {
            name: [kernel for kernel in self.kernels.values() if name in kernel.reads] for name in STATES
        }
        self.sensors = Sensors(plant, scenario.localization)
        self.judge = Judge(scenario, world)
        self.record = Record(self.kernels, Publications(want_profile, states_with(scenario.localization.kind).values()))
        self.taps = Taps()
        self.actions: dict[str, Callable[..., None]] = {}
        self.before_tick: list[Callable[[int], None]] = []
        self.after_tick: list[Callable[[int], None]] = []
        self.after_step: list[Callable[[Kernel, list[State], int], None]] = []
        self.before_end: list[Callable[[], None]] = []
        self.queue: list[tuple[int, int, str, tuple[Any, ...]]] = []
        self.order, self.now = 0, 0
        self.busy: dict[str, State | None] = {}
        self.awaited: dict[str, Awaited] = {}
        self.requests: dict[str, Action] = {}
        self.down: set[str] = set()
        self.verify: Callable[[Kernel, list[State], int], tuple[list[State], int]] | None = None
        self.repeating = self.forked = False
        self.mapped, self.captured_us, self.failed_plans = False, 0, 0
        self.command = np.zeros(4)
        self.reference = plant.odometry[:3].copy()
        self.status: MissionStatus | None = None

    @property
    def injected(self) -> bool:
        """Whether a fault has been injected."""
        injections: Sequence[Injection] = getattr(self.taps.injector, "injections", ())
        return self.forked or any(one.activated for one in injections)

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
        for action in (_TICK, "capture") if self.sensors.estimating else ("capture", _TICK):
            self.at(0, action)

    def run(self, until: int = sys.maxsize) -> None:
        """Run until the mission has a status, or until `until` control periods have elapsed and the next is due."""
        while self.status is None:
            if self.queue[0][2] == _TICK and len(self.record.rows) >= until:
                return
            self.now, _, action, arguments = heapq.heappop(self.queue)
            # the plant stops at the first physics step at or after this instant
            self.plant.advance(-(-self.now // _PHYSICS_US) * _PHYSICS_US)
            (self.actions.get(action) or getattr(self, action))(self.now, *arguments)

    def flight(self) -> Flight:
        """The flight; requires that the mission has a status."""
        assert self.status is not None  # precondition
        for listener in self.before_end:
            listener()
        for text in self.plant.warnings():
            self.record.note(self.now, "warning", {"text": text})
        log = self.log(self.status, self.plant.rejected_commands)
        return Flight(log, self.record.publications.profile(), self.world, self.kernels)

    # ---- sensors and the control period -----------------------------------------------------------------------------
    def capture(self, now: int) -> None:
        """Take a depth image, or reuse the last one if a recomputation of perception is requested."""
        self.captured_us, self.mapped = now, False
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
        for listener in self.before_tick:
            listener(now)
        self.status = self.status or self.judge.status(self.plant, self.failed_plans, now)
        self.record.write_row(now, self.plant.odometry, self.command, self.reference)
        if self.status is None:
            self._control_period(now)
        for listener in self.after_tick:
            listener(now)

    def _control_period(self, now: int) -> None:
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
        request = None if kernel.name in SCANNING else self.requests.pop(kernel.name, None)  # perception: `capture`
        if request is not None:
            if request.kind is not Response.RECOMPUTE:
                kernel.mark()  # the request replaces the step of this period
            self.recompute(request, now)
            return
        if self.marks and kernel.name not in SCANNING:
            kernel.mark()
        states, cost = kernel.step(now), self.latency[kernel.name] if latency_us is None else latency_us
        if self.verify is not None:
            states, more = self.verify(kernel, states, now)
            cost += more
        self.finish(kernel, states, now, cost)

    def finish(self, kernel: Kernel, states: list[State], now: int, latency_us: int) -> None:
        """Publish a kernel's results after a latency; results of a dead node are lost."""
        for listener in self.after_step:
            listener(kernel, states, now)
        if kernel.name in self.down:
            return
        self.record.compute_us[kernel.name] += self.latency[kernel.name]
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
        own = proxy(self)  # no cycle, so that maps are freed at once
        self.taps.lost = lambda state, now: own.lost(state, now)

    def lost(self, state: State, now: int) -> None:
        """A message is lost in transit: without this scan, perception is ready for the next image."""
        if state.spec.name == "sensor.depth" or state.spec.writer in SCANNING:
            self._next_image(now)

    def _next_image(self, now: int) -> None:
        self.at(max(now, self.captured_us + self.scenario.camera.period_us), "capture")

    def resend(self, now: int, state: State) -> None:
        """Retransmit the producer's copy of a value."""
        self.deliver(state, now)

    def publish(self, state: State, now: int) -> None:
        """Hand a value to its consumers, and start the steps that it makes due."""
        name = state.spec.name
        self.record.published(state, now)
        if name == "planning.path":
            self.failed_plans = 0 if len(state.elements) else self.failed_plans + 1
        for kernel in self.readers[name]:
            if kernel.receive(state, now) and kernel.name not in PERIODIC:
                if kernel.name in self.busy:
                    self.busy[kernel.name] = state
                else:
                    self.start(kernel, now)
        if name == "control.command":
            values = floats(state.header, 5)
            self.command = values[:4].copy()
            self.plant.command(self.command, float(values[4]))
        elif name == ODOMETRY["estimator"]:
            self.sensors.see(state)
        elif name == "planning.waypoint":
            self.reference = floats(state.header, 3).copy()
        elif name == "perception.map_update":
            self.mapped = True
        elif name == "perception.collision_status" and self.mapped:
            self.mapped = False
            self._next_image(now)

    # ---- recovery ---------------------------------------------------------------------------------------------------
    def recompute(self, action: Action, now: int) -> None:
        """Restore memory and repeat the step, or request another way-point; charges the latency again."""
        kernel: Any = self.kernels[action.kernel]
        cost = self.charge(action)
        if action.kind is Response.STOP:
            self.finish(kernel, kernel.stop(), now, cost)
            return
        if action.kind is Response.ABANDON:
            self.finish(kernel, kernel.abandon(now), now, cost)
            return
        if action.alone:
            repeat(kernel)
            self.start(kernel, now)
            return
        for name in action.restores:
            self.kernels[name].rollback()
        self.start(kernel, now, None if action.kernel in SCANNING else cost)

    def charge(self, action: Action) -> int:
        """Charge a recomputation to its stage; returns its modelled time (us)."""
        platform = self.scenario.platform
        if action.alone:
            cost = self.latency[action.kernel]
        else:
            cost = redo_latency(platform, action.kernel, action.stage) if action.kernel else stage_latency(
                platform, action.stage
            )  # fmt: skip
        self.record.recompute_us[action.stage.value] += cost
        return cost

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
        own = memory.copy()
        for name in own.__slots__:
            setattr(self, name, getattr(own, name))

    # ---- record -----------------------------------------------------------------------------------------------------
    def log(self, status: MissionStatus, rejected_commands: int) -> FlightLog:
        """The log of a completed flight."""
        record, injector = self.record, self.taps.injector
        meta = {
            "scenario": self.scenario.to_json(), "start": self.world.start.tolist(), "goal": self.world.goal.tolist(),
            "course_m": self.world.course, "time_limit_s": 1e-6 * self.judge.limit_us, "world": self.world.digest(),
            "compute_us": record.compute_us, "recompute_us": record.recompute_us,
            "publications": record.publications.count, "rejected_commands": rejected_commands,
        }  # fmt: skip
        injections = [] if injector is None else injector.finish()
        return FlightLog(np.array(record.rows), status, record.events, injections, record.alarms, meta)
