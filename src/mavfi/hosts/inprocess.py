"""The deterministic host: one flight in one process, on integer microseconds.

Every published state passes the taps in a fixed order, injector then detector, before a consumer sees it (coupling
`inline`).  An alarm makes the host run the stage again from the memory that it had, charge the latency again, and hold
the last good value meanwhile.  A recomputation that gives the same value is accepted.
"""

import heapq
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavfi.detectors.detector import Alarm, Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault
from mavfi.faults.state import Injector, StateInjector
from mavfi.flight_log import COLUMNS, Event, FlightLog, Profile
from mavfi.hosts.compose import CONTROL_PERIOD_US, pipeline_config
from mavfi.hosts.publications import Publications
from mavfi.hosts.sensing import Sensors
from mavfi.mission import ARRIVAL_RADIUS, FLY_AWAY_MARGIN, MissionStatus, Scenario, time_limit
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.pipeline.kernel import Kernel, PipelineConfig
from mavfi.pipeline.ppc import PERIODIC, build_pipeline
from mavfi.platforms.compute import STAGE_KERNELS, latency, redo_latency, stage_latency
from mavfi.sim.environments import World, build_world
from mavfi.sim.simulator import Simulator
from mavfi.states import ODOMETRY, STATES, Stage, State, floats, states_with

_PHYSICS_US = 4_000
_TICK = "tick"

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


@dataclass(frozen=True, slots=True)
class Redo:
    """A recomputation on its way; the value that comes out is published, whatever the detector says.

    Attributes:
        rejected: What the alarm was about.
        place: Of the alarm's record.
    """

    rejected: State
    place: int


class Host:
    """One flight.

    Args:
        scenario, fault, detector, want_profile, observer, functions: See `fly`.
        rewindable: Whether the flight can be put back to earlier instants and gone on with under another detector
            (see `hosts.checkpoints`): maps keep their changes, and kernels are marked even if nothing can alarm yet.
        kernels: Makes the kernels, which may be proxies of kernels elsewhere; None = all of them, here.
    """

    # configuration; what is judged, counted or recorded; and the taps, which a checkpoint holds beside the memory
    not_memory = (
        "scenario", "world", "sim", "config", "latency", "readers", "observer", "course", "limit_us", "marks",
        "status", "publications", "rows", "events", "alarms", "compute_us", "recompute_us", "injector", "detector",
        "goal", "arena", "sensors",
    )  # fmt: skip

    def __init__(
        self, scenario: Scenario, fault: Fault | None = None, detector: Detector | None = None,
        want_profile: bool = False, observer: Observer | None = None, rewindable: bool = False,
        functions: KernelFunctions = PLAIN, kernels: Callable[[PipelineConfig], dict[str, Kernel]] | None = None,
    ) -> None:  # fmt: skip
        self.scenario = scenario
        self.world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
        self.sim = Simulator(self.world, scenario)
        self.config = pipeline_config(scenario, self.world, self.sim.ray_directions, rewindable, functions)
        self.kernels = (kernels or build_pipeline)(self.config)
        self.latency = {name: latency(scenario.platform, name) for name in self.kernels}
        self.injector: Injector | None = None if fault is None else StateInjector(fault)
        self.detector = detector
        self.marks = rewindable or detector is not None
        if detector is not None:
            detector.start()
        self.readers: dict[str, list[Kernel]] = {
            name: [kernel for kernel in self.kernels.values() if name in kernel.reads] for name in STATES
        }
        self.sensors = Sensors(self.sim, scenario.localization)
        self.publications = Publications(want_profile, states_with(scenario.localization.kind))
        self.observer = observer
        self.queue: list[tuple[int, int, str, tuple[Any, ...]]] = []
        self.order, self.now = 0, 0
        self.busy: dict[str, State | None] = {}
        self.redo: dict[str, Redo] = {}
        self.mapped, self.captured_us, self.failed_plans = False, 0, 0
        self.rows: list[np.ndarray] = []
        self.events: list[Event] = []
        self.alarms: list[dict[str, Any]] = []
        self.compute_us = dict.fromkeys(self.kernels, 0)
        self.recompute_us = {stage.value: 0 for stage in STAGE_KERNELS}
        self.command = np.zeros(4)
        self.reference = self.sim.odometry[:3].copy()
        self.status: MissionStatus | None = None
        self.course = self.world.course
        self.goal: list[float] = self.world.goal.tolist()
        self.arena: tuple[list[float], list[float]] = self.world.arena_lower.tolist(), self.world.arena_upper.tolist()
        self.limit_us = int(1e6 * time_limit(self.course, scenario.v_max, scenario.platform))

    # ---- time -------------------------------------------------------------------------------------------------------
    def at(self, time_us: int, action: str, *arguments: Any) -> None:  # noqa: ANN401 (as the action wants)
        """Do something later: call the method of that name; what was asked for first is done first."""
        self.order += 1
        heapq.heappush(self.queue, (time_us, self.order, action, arguments))

    def fly(self) -> Flight:
        """Run until the mission has a status."""
        self.begin()
        self.run()
        return self.flight()

    def begin(self) -> None:
        """Put into the queue what a flight begins with; with an estimator, images need its first estimate."""
        for action in (_TICK, "capture") if self.sensors.estimating else ("capture", _TICK):
            self.at(0, action)

    def run(self, until: int = sys.maxsize) -> None:
        """Go on until the mission has a status, or a control tick is next and so many have been."""
        while self.status is None:
            if self.queue[0][2] == _TICK and len(self.rows) >= until:
                return
            self.now, _, action, arguments = heapq.heappop(self.queue)
            # the vehicle is where the first physics step at or after this instant leaves it
            self.sim.advance(-(-self.now // _PHYSICS_US) * _PHYSICS_US)
            getattr(self, action)(self.now, *arguments)

    def flight(self) -> Flight:
        """What became of it, once the mission has a status."""
        assert self.status is not None  # `run` has come to the end
        for text in self.sim.warnings():
            self.events.append(Event(self.now, "warning", {"text": text}))
        log = self.log(self.status, self.sim.rejected_commands)
        return Flight(log, self.publications.profile(), self.world, self.kernels)

    # ---- sensors and the control period -----------------------------------------------------------------------------
    def capture(self, now: int) -> None:
        """Take a depth image; perception goes on from there."""
        self.captured_us, self.mapped = now, False
        if self.marks:
            for name in STAGE_KERNELS[Stage.PERCEPTION]:
                self.kernels[name].mark()
        self.deliver(self.sensors.depth(), now)

    def tick(self, now: int) -> None:
        """One control period: judge, measure where the vehicle is, hand over, track."""
        self.status = self._judge(now)
        self._write_row(now)
        if self.status is not None:
            return
        self.sense(now)
        for later in self.sensors.samples_between(now, now + CONTROL_PERIOD_US):
            self.at(later, "sense")
        for name in PERIODIC:
            if name not in self.busy:
                self.start(self.kernels[name], now)
        self.at(now + CONTROL_PERIOD_US, _TICK)

    def sense(self, now: int) -> None:
        """Publish what says where the vehicle is."""
        for state in self.sensors.motion(now):
            self.deliver(state, now)

    def _judge(self, now: int) -> MissionStatus | None:
        state = self.sim.odometry.tolist()  # NumPy would take longer to start than to run, fifty times a second
        if not all(map(math.isfinite, state)):
            return MissionStatus.INVALID_STATE
        if self.sim.collided:
            return MissionStatus.COLLISION
        if math.dist(state[:3], self.goal) < ARRIVAL_RADIUS:
            return MissionStatus.SUCCESS
        lower, upper = self.arena
        if any(
            max(low - value, value - high) > FLY_AWAY_MARGIN
            for low, value, high in zip(lower, state[:3], upper, strict=True)
        ):
            return MissionStatus.FLY_AWAY
        if self.failed_plans > self.scenario.stack.max_failed_plans:
            return MissionStatus.NO_PATH
        return MissionStatus.TIMEOUT if now >= self.limit_us else None

    # ---- kernels and publications -----------------------------------------------------------------------------------
    def start(self, kernel: Kernel, now: int, extra_us: int | None = None) -> None:
        """Run a kernel; what it gives is published when its latency (or `extra_us`) has passed."""
        if self.marks and kernel.name not in STAGE_KERNELS[Stage.PERCEPTION]:
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
        self.at(now + latency_us, "done", kernel.name, states)

    def done(self, now: int, name: str, states: list[State]) -> None:
        """The latency of a kernel has passed."""
        waiting = self.busy.pop(name, None)
        for state in states:
            self.deliver(state, now)
        if waiting is None:
            return
        kernel = self.kernels[name]
        if name in self.busy:  # it is run again: what waits goes on waiting
            self.busy[name] = self.busy[name] or waiting
        elif kernel.receive(waiting, now):
            self.start(kernel, now)

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
        elif name == ODOMETRY["estimator"]:
            self.sensors.see(state)
        elif name == "planning.waypoint":
            self.reference = floats(state.header, 3).copy()
        elif name == "perception.map_update":
            self.mapped = True
        elif name == "perception.collision_status" and self.mapped:
            self.mapped = False
            self.at(max(now, self.captured_us + self.scenario.camera.period_us), "capture")

    # ---- detection and recovery -------------------------------------------------------------------------------------
    def _let_pass(self, state: State, now: int, detector: Detector) -> bool:
        """Whether a value may be published; if not, its recomputation has begun."""
        redo = self.redo.pop(state.spec.name, None)
        if redo is not None:
            record = self.alarms[redo.place]
            if record["action"] == "recompute":
                outcome = "accepted" if state.same_bits(redo.rejected) else "repaired"
                self.alarms[redo.place] = {**record, "outcome": outcome}  # a checkpoint may hold the record as it was
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
        stage = stage_of(alarm)
        name = state.spec.name
        waypoint: Any = self.kernels["waypoint"]
        record = {"time_s": 1e-6 * now, **alarm.to_json(), "state": name, "action": "recompute", "outcome": "replaced"}
        self.alarms.append(record)
        if alarm.stop or alarm.abandon_waypoint:
            record["action"] = "stop" if alarm.stop else "abandon"
            states = waypoint.stop() if alarm.stop else waypoint.abandon(now)
            self.recompute_us[Stage.CONTROL.value] += stage_latency(platform, Stage.CONTROL)
            self.redo["planning.waypoint"] = Redo(state, len(self.alarms) - 1)
            self.finish(waypoint, states, now, stage_latency(platform, Stage.CONTROL))
            return name == "planning.waypoint"
        kernel = self.kernels.get(state.spec.writer)
        if kernel is None or stage is not kernel.stage:
            return self._recompute_elsewhere(record, stage, now)
        self.redo[name] = Redo(state, len(self.alarms) - 1)
        if kernel.name in self.busy:
            return True  # an alarm at another of its states has made it run again
        cost = redo_latency(platform, kernel.name, stage)
        self.recompute_us[stage.value] += cost
        if kernel.name in STAGE_KERNELS[Stage.PERCEPTION]:
            for member in STAGE_KERNELS[stage]:
                self.kernels[member].rollback()
            self.start(self.kernels["point_cloud"], now)
            return True
        kernel.rollback()
        self.start(kernel, now, cost)
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

    def log(self, status: MissionStatus, rejected_commands: int) -> FlightLog:
        """The record of a flight that is over."""
        injections = [] if self.injector is None else [hit.to_json() for hit in self.injector.finish()]
        meta = {
            "scenario": self.scenario.to_json(), "start": self.world.start.tolist(), "goal": self.world.goal.tolist(),
            "course_m": self.course, "time_limit_s": 1e-6 * self.limit_us, "world": self.world.digest(),
            "compute_us": self.compute_us, "recompute_us": self.recompute_us, "publications": self.publications.count,
            "rejected_commands": rejected_commands,
        }  # fmt: skip
        return FlightLog(np.array(self.rows), status, self.events, injections, self.alarms, meta)


def stage_of(alarm: Alarm) -> Stage:
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
    observer: Observer | None = None, functions: KernelFunctions = PLAIN,
) -> Flight:  # fmt: skip
    """Fly one mission.

    Args:
        scenario: The mission.
        fault: What to inject; None = golden flight.
        detector: What watches; None = nothing.
        want_profile: Whether to record when which state was published.
        observer: Sees what is published.
        functions: What the kernels call: the compiled functions, or twins of some of them.

    Returns:
        The flight; the same arguments give the same bytes.

    Raises:
        BadInputError: The scenario cannot be flown, e.g. the start lies in an obstacle.
    """
    with np.errstate(all="ignore"):  # corrupted values may overflow; that is data, not an error
        return Host(scenario, fault, detector, want_profile, observer, functions=functions).fly()
