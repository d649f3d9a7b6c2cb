"""The deterministic host: one flight in one process, on integer microseconds.

Every published state passes the taps in a fixed order, injector then detector, before a consumer sees it (coupling
`inline`).  An alarm makes the host run the stage again from the memory that it had, charge the latency again, and hold
the last good value meanwhile.  A recomputation that gives the same value is accepted.
"""

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mavfi.detectors.detector import Alarm, Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault
from mavfi.faults.state import ActedOn, StateInjector
from mavfi.flight_log import COLUMNS, Event, FlightLog, Profile
from mavfi.hosts.compose import CONTROL_PERIOD_US, pipeline_config
from mavfi.mission import ARRIVAL_RADIUS, FLY_AWAY_MARGIN, MissionStatus, Scenario, time_limit
from mavfi.pipeline.kernel import Kernel
from mavfi.pipeline.ppc import PERIODIC, build_pipeline
from mavfi.platforms.compute import STAGE_KERNELS, latency, stage_latency
from mavfi.sim.environments import World, build_world
from mavfi.sim.simulator import Simulator
from mavfi.states import STATES, Stage, State, floats, new_state

_PHYSICS_US = 4_000

Observer = Callable[[State, int], None]
"""Sees every published value and the instant (microseconds); it must not change it."""


@dataclass(slots=True)
class Flight:
    """What `fly` gives back.

    Attributes:
        log: The record.
        profile: When what was published, if it was asked for.
        world: The world that was flown in.
        pipeline: The kernels as they were at the end, for pictures and inspection.
    """

    log: FlightLog
    profile: Profile | None
    world: World
    pipeline: dict[str, Kernel]


@dataclass(slots=True)
class _Redo:
    """A recomputation on its way; the value that comes out is published, whatever the detector says."""

    rejected: State
    record: dict[str, Any]


@dataclass(slots=True)
class _Publications:
    """Counts what was published, and when, if a profile is wanted."""

    wanted: bool
    count: dict[str, int] = field(default_factory=lambda: dict.fromkeys(STATES, 0))
    times: dict[str, list[int]] = field(default_factory=lambda: {name: [] for name in STATES})
    sizes: dict[str, list[int]] = field(default_factory=lambda: {name: [] for name in STATES})
    acted_on: dict[str, ActedOn] = field(default_factory=lambda: {s.name: ActedOn(s) for s in STATES.values()})

    def note(self, state: State, time_us: int) -> None:
        name = state.spec.name
        self.count[name] += 1
        if not self.wanted:
            return
        if not self.acted_on[name](state):
            return
        self.times[name].append(time_us)
        self.sizes[name].append(len(state.elements))

    def profile(self) -> Profile | None:
        if not self.wanted:
            return None
        return Profile(
            {name: np.array(times, np.int64) for name, times in self.times.items()},
            {name: np.array(sizes, np.int32) for name, sizes in self.sizes.items()},
        )


class _Host:
    """One flight."""

    def __init__(
        self, scenario: Scenario, fault: Fault | None, detector: Detector | None, want_profile: bool,
        observer: Observer | None,
    ) -> None:  # fmt: skip
        self.scenario = scenario
        self.world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
        self.sim = Simulator(self.world, scenario)
        self.config = pipeline_config(scenario, self.world, self.sim.ray_directions)
        self.kernels = build_pipeline(self.config)
        self.latency = {name: latency(scenario.platform, name) for name in self.kernels}
        self.injector = None if fault is None else StateInjector(fault)
        self.detector = detector
        if detector is not None:
            detector.start()
        self.readers: dict[str, list[Kernel]] = {
            name: [kernel for kernel in self.kernels.values() if name in kernel.reads] for name in STATES
        }
        self.publications = _Publications(want_profile)
        self.observer = observer
        self.queue: list[tuple[int, int, Callable[[int], None]]] = []
        self.order = 0
        self.now = 0
        self.busy: dict[str, State | None] = {}
        self.redo: dict[str, _Redo] = {}
        self.mapped = False
        self.captured_us = 0
        self.failed_plans = 0
        self.rows: list[np.ndarray] = []
        self.events: list[Event] = []
        self.alarms: list[dict[str, Any]] = []
        self.compute_us = dict.fromkeys(self.kernels, 0)
        self.recompute_us = {stage.value: 0 for stage in STAGE_KERNELS}
        self.command = np.zeros(4)
        self.reference = self.sim.odometry[:3].copy()
        self.status: MissionStatus | None = None
        course = float(np.linalg.norm(self.world.goal - self.world.start))
        self.course = course
        self.limit_us = int(1e6 * time_limit(course, scenario.v_max, scenario.platform))

    # ---- time -------------------------------------------------------------------------------------------------------
    def at(self, time_us: int, action: Callable[[int], None]) -> None:
        """Do something later; what was asked for first is done first."""
        self.order += 1
        heapq.heappush(self.queue, (time_us, self.order, action))

    def fly(self) -> Flight:
        """Run until the mission has a status."""
        self.at(0, self.capture)
        self.at(0, self.tick)
        while self.status is None:
            self.now, _, action = heapq.heappop(self.queue)
            # the vehicle is where the first physics step at or after this instant leaves it
            self.sim.advance(-(-self.now // _PHYSICS_US) * _PHYSICS_US)
            action(self.now)
        self.queue.clear()  # what was still to come refers back to this host: a cycle would keep its maps in memory
        return Flight(self._log(self.status), self.publications.profile(), self.world, self.kernels)

    # ---- sensors and the control period -----------------------------------------------------------------------------
    def capture(self, now: int) -> None:
        """Take a depth image; perception goes on from there."""
        self.captured_us, self.mapped = now, False
        if self.detector is not None:
            for name in STAGE_KERNELS[Stage.PERCEPTION]:
                self.kernels[name].mark()
        ranges, pose = self.sim.depth()
        state = new_state("sensor.depth", len(ranges))
        floats(state.header, 7)[:] = pose
        state.elements["range"] = ranges
        self.deliver(state, now)

    def tick(self, now: int) -> None:
        """One control period: judge, publish odometry, hand over, track."""
        self.status = self._judge(now)
        self._write_row(now)
        if self.status is not None:
            return
        odometry = new_state("sensor.odometry")
        floats(odometry.header, 13)[:] = self.sim.odometry
        self.deliver(odometry, now)
        for name in PERIODIC:
            if name not in self.busy:
                self.start(self.kernels[name], now)
        self.at(now + CONTROL_PERIOD_US, self.tick)

    def _judge(self, now: int) -> MissionStatus | None:
        state, world = self.sim.odometry, self.world
        position = state[:3]
        if not np.isfinite(state).all():
            return MissionStatus.INVALID_STATE
        if self.sim.collided:
            return MissionStatus.COLLISION
        if math.dist(position, world.goal) < ARRIVAL_RADIUS:
            return MissionStatus.SUCCESS
        outside = np.maximum(world.arena_lower - position, position - world.arena_upper).max()
        if outside > FLY_AWAY_MARGIN:
            return MissionStatus.FLY_AWAY
        if self.failed_plans > self.scenario.stack.max_failed_plans:
            return MissionStatus.NO_PATH
        return MissionStatus.TIMEOUT if now >= self.limit_us else None

    # ---- kernels and publications -----------------------------------------------------------------------------------
    def start(self, kernel: Kernel, now: int, extra_us: int | None = None) -> None:
        """Run a kernel; what it gives is published when its latency (or `extra_us`) has passed."""
        if self.detector is not None and kernel.stage is not Stage.PERCEPTION:
            kernel.mark()
        self.finish(kernel, kernel.step(now), now, self.latency[kernel.name] if extra_us is None else extra_us)

    def finish(self, kernel: Kernel, states: list[State], now: int, latency_us: int) -> None:
        """Publish a kernel's results when its latency has passed."""
        self.compute_us[kernel.name] += self.latency[kernel.name]
        if latency_us == 0:
            for state in states:
                self.deliver(state, now)
            return
        self.busy[kernel.name] = None

        def done(then: int) -> None:
            waiting = self.busy.pop(kernel.name, None)
            for state in states:
                self.deliver(state, then)
            if waiting is None:
                return
            if kernel.name in self.busy:  # it is run again: what waits goes on waiting
                self.busy[kernel.name] = self.busy[kernel.name] or waiting
            elif kernel.receive(waiting, then):
                self.start(kernel, then)

        self.at(now + latency_us, done)

    def deliver(self, state: State, now: int) -> None:
        """A value on its way to its consumers: injector, detector, then they see it."""
        if self.injector is not None:
            state = self.injector(state, now)
        if self.detector is not None and not self._let_pass(state, now, self.detector):
            return
        self.publish(state, now)

    def publish(self, state: State, now: int) -> None:
        """Consumers see a value; steps that it makes due begin."""
        name = state.spec.name
        self.publications.note(state, now)
        if self.observer is not None:
            self.observer(state, now)
        self._note_event(state, now)
        for kernel in self.readers[name]:
            if kernel.receive(state, now) and kernel.name not in PERIODIC:
                if kernel.name in self.busy:
                    self.busy[kernel.name] = state
                else:
                    self.start(kernel, now)
        if name == "control.command":
            values = floats(state.header, 5)
            self.command = values[:4].copy()
            self.sim.command(self.command, float(values[4]))
        elif name == "planning.waypoint":
            self.reference = floats(state.header, 3).copy()
        elif name == "perception.map_update":
            self.mapped = True
        elif name == "perception.collision_status" and self.mapped:
            self.mapped = False
            self.at(max(now, self.captured_us + self.scenario.camera.period_us), self.capture)

    # ---- detection and recovery -------------------------------------------------------------------------------------
    def _let_pass(self, state: State, now: int, detector: Detector) -> bool:
        """Whether a value may be published; if not, its recomputation has begun."""
        redo = self.redo.pop(state.spec.name, None)
        if redo is not None:
            if redo.record["action"] == "recompute":
                redo.record["outcome"] = "accepted" if state.same_bits(redo.rejected) else "repaired"
            detector.accept(state, now)
            return True
        alarm = detector.check(state, now)
        if alarm is None:
            detector.accept(state, now)
            return True
        return not self._recover(alarm, state, now)

    def _recover(self, alarm: Alarm, state: State, now: int) -> bool:
        """Answer an alarm; False where nothing can be run again (the value passes)."""
        platform = self.scenario.platform
        stage = _stage_of(alarm)
        name = state.spec.name
        waypoint: Any = self.kernels["waypoint"]
        record = {"time_s": 1e-6 * now, **alarm.to_json(), "state": name, "action": "recompute", "outcome": "replaced"}
        self.alarms.append(record)
        if alarm.stop or alarm.abandon_waypoint:
            record["action"] = "stop" if alarm.stop else "abandon"
            states = waypoint.stop() if alarm.stop else waypoint.abandon(now)
            self.recompute_us[Stage.CONTROL.value] += stage_latency(platform, Stage.CONTROL)
            self.redo["planning.waypoint"] = _Redo(state, record)
            self.finish(waypoint, states, now, stage_latency(platform, Stage.CONTROL))
            return name == "planning.waypoint"
        kernel = self.kernels.get(state.spec.writer)
        if kernel is None or stage is not kernel.stage:
            return self._recompute_elsewhere(record, stage, now)
        self.redo[name] = _Redo(state, record)
        if kernel.name in self.busy:
            return True  # an alarm at another of its states has made it run again
        self.recompute_us[stage.value] += stage_latency(platform, stage)
        if stage is Stage.PERCEPTION:
            for member in STAGE_KERNELS[stage]:
                self.kernels[member].rollback()
            self.start(self.kernels["point_cloud"], now)
            return True
        kernel.rollback()
        self.start(kernel, now, stage_latency(platform, stage))
        return True

    def _recompute_elsewhere(self, record: dict[str, Any], stage: Stage, now: int) -> bool:
        """The detector wants another stage than the writer's: that one runs again, this value passes."""
        self.recompute_us[stage.value] += stage_latency(self.scenario.platform, stage)
        record["outcome"] = "accepted"
        if stage is Stage.CONTROL and "pid" not in self.busy:
            self.kernels["pid"].rollback()
            self.start(self.kernels["pid"], now)
        return False

    # ---- record -----------------------------------------------------------------------------------------------------
    def _note_event(self, state: State, now: int) -> None:
        name = state.spec.name
        if name == "planning.path":
            found = len(state.elements) > 0
            self.failed_plans = 0 if found else self.failed_plans + 1
            self.events.append(Event(now, "plan" if found else "plan_failed", {"vertices": len(state.elements)}))
        elif name == "planning.trajectory":
            seq = int(state.header["trajectory_seq"][0])
            self.events.append(Event(now, "trajectory", {"seq": seq, "points": len(state.elements)}))
        elif name == "perception.collision_status" and bool(state.header["collision"][0]):
            time = float(state.header["time_to_collision"][0])
            self.events.append(Event(now, "collision_predicted", {"time_to_collision": time}))

    def _write_row(self, now: int) -> None:
        row = np.empty(len(COLUMNS))
        row[0] = 1e-6 * now
        row[1:14] = self.sim.odometry
        row[14:18] = self.command
        row[18:21] = self.reference
        self.rows.append(row)

    def _log(self, status: MissionStatus) -> FlightLog:
        for text in self.sim.warnings():
            self.events.append(Event(self.now, "warning", {"text": text}))
        injections = [] if self.injector is None else [hit.to_json() for hit in self.injector.finish()]
        meta = {
            "scenario": self.scenario.to_json(), "start": self.world.start.tolist(), "goal": self.world.goal.tolist(),
            "course_m": self.course, "time_limit_s": 1e-6 * self.limit_us, "world": self.world.digest(),
            "compute_us": self.compute_us, "recompute_us": self.recompute_us, "publications": self.publications.count,
            "rejected_commands": self.sim.rejected_commands,
        }  # fmt: skip
        return FlightLog(np.array(self.rows), status, self.events, injections, self.alarms, meta)


def _stage_of(alarm: Alarm) -> Stage:
    """The stage that an alarm names.

    Raises:
        BadInputError: It names none that can be run again.
    """
    for stage in STAGE_KERNELS:
        if stage.value == alarm.stage:
            return stage
    allowed = ", ".join(STAGE_KERNELS)
    raise BadInputError(f"detector {alarm.source!r}: stage {alarm.stage!r}: cannot be run again; allowed: {allowed}")


def fly(
    scenario: Scenario, fault: Fault | None = None, detector: Detector | None = None, *, want_profile: bool = False,
    observer: Observer | None = None,
) -> Flight:  # fmt: skip
    """Fly one mission.

    Args:
        scenario: The mission.
        fault: What to inject; None = golden flight.
        detector: What watches; None = nothing.
        want_profile: Whether to record when which state was published.
        observer: Sees what is published.

    Returns:
        The flight; the same arguments give the same bytes.

    Raises:
        BadInputError: The scenario cannot be flown, e.g. the start lies in an obstacle.
    """
    with np.errstate(all="ignore"):  # corrupted values may overflow; that is data, not an error
        return _Host(scenario, fault, detector, want_profile, observer).fly()
