"""Decisions of recovery, in pure Python: which response an alarm gets, and when the wait for a path is over.

`decide` is the decision table; `recovery.DetectorTap` carries its actions out.  Nothing here depends on the flight but
through the arguments: the alarm, what recovery remembers (`History`), and the mission's policy (`RecoveryPolicy`).
"""

import math
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Literal, NamedTuple

from mavfi.config import AutopilotConfig
from mavfi.detectors.detector import Alarm
from mavfi.errors import BadInputError
from mavfi.kernels.perception.collision_check import NO_COLLISION
from mavfi.mission import RECOVERY, DetectorPlace, MissionSpec
from mavfi.pipeline.memory import Memory
from mavfi.states import KERNELS, ODOMETRY, STAGE_KERNELS, STATES, Stage, State, StateSpec, floats

SCANNING = STAGE_KERNELS[Stage.PERCEPTION]
"""Kernels that are recomputed together, starting from the image."""
COLLISION = "perception.collision_status"
PATH = "planning.path"
WAYPOINT = "planning.waypoint"

RESTART_US = 20_000
"""Down time of the first node that a detector restarts (us): the process survives, its memory is initialized."""
BACK_OFF = 3
"""Factor by which the down time grows with each restart in a flight: their sum exceeds a fault of 1 s."""
MAX_RESTARTS = 5
"""Limit per flight: a faulty detector must not keep a vehicle from flying."""
PERSISTS_US = 2_000_000
"""Duration of a series of hard alarms beyond which they are persistent (us)."""
GAP_US = 500_000
"""Longest gap between two hard alarms of a series (us)."""
ALARMS_WITHIN_US = 10_000_000
"""Time within which alarms are counted against the detector (us)."""
MAX_ALARMS = 50
"""Number of hard alarms in `ALARMS_WITHIN_US` after which a detector that may restart nodes is disabled as faulty."""
MAX_UNCHANGED = 5
"""Recomputations without a change in `ALARMS_WITHIN_US`, above which `same_twice: limit` does not respond."""
SKIPPED_US = 50_000_000
"""Delay with which a skipped way-point counts as `MAX_UNCHANGED` alarms (us).

Until then there is no response either: skipping changes the route, and several times it can lead into an obstacle.
"""


# ---- the policy -----------------------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class RecoveryPolicy:
    """Recovery policy for the alarms of a detector; the attributes are keys of a mission.

    Attributes:
        coupling: Coupling of the detector, see `recovery`.
        grain: Unit of repetition: the `stage` with its latency; only the `kernel` that wrote the value; or its
            `message`, which the producer retransmits from its copy at no modelled cost, also if it cannot be read.
        same_twice: Policy for a recomputation that violates a rule again (`Alarm.hard`): `accept` it, or `escalate` to
            a restart of the node (coupling `inline` only), or `limit` the rate of recomputations that change nothing,
            so that a detector that raises alarms without end cannot delay a flight at each step.
        answer_s: Deadline for the path that answers a collision alarm (s), after which the planner's node is restarted;
            0 = none.
        degraded: Policy when a rule is still violated with no restart left, or when hard alarms persist: `none`
            continues the mission, `hold` gives it up, see `HoldPosition`.
        detector_place: Where the detector checks a value relative to a fault on the way, see `flight.taps`.

    Raises:
        BadInputError: A degraded mode with coupling `observer`, which cannot withhold commands.
    """

    coupling: Literal["inline", "observer"] = "inline"
    grain: Literal["stage", "kernel", "message"] = "stage"
    same_twice: Literal["accept", "escalate", "limit"] = "accept"
    answer_s: float = 0.0
    degraded: Literal["none", "hold"] = "none"
    detector_place: DetectorPlace = "consumer"

    def __post_init__(self) -> None:
        if self.degrades and not self.gates:
            raise BadInputError(f"degraded: {self.degraded}: withholds commands; allowed: with coupling inline")

    @staticmethod
    def of(spec: MissionSpec) -> "RecoveryPolicy":
        """The recovery policy of a mission."""
        return RecoveryPolicy(**{key: getattr(spec, key) for key in RECOVERY})

    @property
    def gates(self) -> bool:
        """Whether the detector is a gate, which can withhold a value."""
        return self.coupling == "inline"

    @property
    def escalates(self) -> bool:
        """Whether a rule violated twice restarts a node; not with an observer, as its values are consumed first."""
        return self.same_twice == "escalate" and self.gates

    @property
    def restarts(self) -> bool:
        """Whether the policy includes node restarts."""
        return self.escalates or self.answer_s > 0

    @property
    def limits(self) -> bool:
        """Whether the rate of recomputations without a change is limited."""
        return self.same_twice == "limit"

    @property
    def confirms(self) -> bool:
        """Whether another value after an alarm confirms it; an observer's next value differs in any case."""
        return not self.limits or self.gates

    @property
    def resends(self) -> bool:
        """Whether the producer's copy is retransmitted."""
        return self.grain == "message"

    @property
    def degrades(self) -> bool:
        """Whether there is a degraded mode."""
        return self.degraded != "none"

    @property
    def remembers(self) -> bool:
        """Whether it depends on more than its own earlier alarms, on which a limit depends, see `decide.History`."""
        return self.restarts or self.degrades


INLINE = RecoveryPolicy()
"""A gate that repeats the stage and accepts the result, even if it is the same value."""


# ---- an alarm, its response, and what recovery remembers ------------------------------------------------------------
class Origin(IntEnum):
    """What produced a value."""

    STEP = 0  # the regular step of its kernel
    RESENT = 1  # a retransmission: the alarm on it means that it was computed incorrectly
    RECOMPUTED = 2  # a repeated step: the alarm on it means that the memory of its node is corrupted


class Response(StrEnum):
    """What is done about an alarm; the values are those of stored alarms."""

    RESEND = "resend"  # retransmit the value from its producer's copy
    RECOMPUTE = "recompute"  # repeat the step, or only charge the latency of a stage
    ABANDON = "abandon"  # request the way-point after the one in force
    STOP = "stop"  # request a stop, and another plan
    RESTART = "restart"  # restart the node of the kernel
    HOLD = "hold"  # degraded mode from now on: the mission is given up


@dataclass(frozen=True, slots=True)
class Action:
    """Response to an alarm.

    Attributes:
        kind: The response.
        stage: The stage whose latency is charged.
        kernel: The kernel whose step is repeated, or whose node is restarted; "" = none, only the latency is charged.
        restores: Kernels whose memory is restored first, in this order.
        awaited: The state whose next value is the result of the recomputation; "" = none.
        withholds: Whether the value that raised the alarm is withheld.
        alone: Whether only `kernel` is repeated, on its previous inputs and with its own latency.
    """

    kind: Response
    stage: Stage
    kernel: str = ""
    restores: tuple[str, ...] = ()
    awaited: str = ""
    withholds: bool = False
    alone: bool = False


class PendingResult(NamedTuple):
    """The result of a recomputation in progress.

    Attributes:
        rejected: The value that it replaces; None = unreadable.
        alarm_index: Index of the alarm on that value in the flight's record.
    """

    rejected: State | None
    alarm_index: int


@dataclass(frozen=True, slots=True)
class Rejection:
    """A value that raised an alarm.

    Attributes:
        alarm: The alarm, checked by `detector.checked_alarm`.
        spec: Specification of the value's state.
        origin: What produced the value.
        time_us: Instant of the alarm (us).
    """

    alarm: Alarm
    spec: StateSpec
    origin: Origin
    time_us: int


@dataclass(slots=True)
class HoldMemory(Memory):
    """Where the vehicle is, and where it shall stay.

    Attributes:
        position: The latest position (m); empty before the first.
        target: The position at which the mode began (m); empty before.
    """

    position: list[float] = field(default_factory=list)
    target: list[float] = field(default_factory=list)


@dataclass(slots=True)
class PathWait(Memory):
    """The wait for the path that answers a collision alarm.

    Attributes:
        since_us: Instant of the unanswered alarm (us); None = none.
        alarm_number: Sequence number of the unanswered alarm.
        last_number: Sequence number of the last alarm since.
        waypoint: The way-point in force.
    """

    since_us: int | None = None
    alarm_number: int = 0
    last_number: int = 0
    waypoint: State | None = None


@dataclass(slots=True)
class History(Memory):
    """What recovery remembers between alarms.

    Attributes:
        restarts_left: Remaining number of node restarts.
        degraded: Whether it is in degraded mode: it replaces every command and checks nothing.
        silenced: Whether the detector is disabled as faulty: it is asked no more.
        crashed: Whether it is not even told what is published.
        first_us: First instant of the latest contiguous series of hard alarms (us).
        last_us: Its last instant (us).
        counted_us: Instants of the latest alarms that count against the detector (us): with `limit` all, else the hard
            ones.
        path_wait: The wait for a path.
        hold: Positions for the degraded mode.
    """

    restarts_left: int = MAX_RESTARTS
    degraded: bool = False
    silenced: bool = False
    crashed: bool = False
    first_us: int = 0
    last_us: int = -GAP_US
    counted_us: list[int] = field(default_factory=list)
    path_wait: PathWait = field(default_factory=PathWait)
    hold: HoldMemory = field(default_factory=HoldMemory)

    def series_start(self, now: int) -> int:
        """First instant of the contiguous series of hard alarms that one at this instant continues, or begins (us)."""
        if now - self.last_us > GAP_US:
            return now
        return self.first_us

    def extend_series(self, now: int) -> None:
        """Add a hard alarm to the series."""
        self.first_us = self.series_start(now)
        self.last_us = now

    def has_counted(self, number: int, now: int) -> bool:
        """Whether so many alarms counted against the detector within `ALARMS_WITHIN_US`."""
        latest = self.counted_us[-number:]
        return len(latest) == number and now - latest[0] < ALARMS_WITHIN_US

    def count_alarm(self, now: int, *, skips_waypoint: bool) -> None:
        """Count an alarm against the detector."""
        if skips_waypoint:
            self.counted_us += [now + SKIPPED_US] * MAX_UNCHANGED
        else:
            self.counted_us.append(now)
        del self.counted_us[:-MAX_ALARMS]

    def down_time(self) -> int:
        """Down time of the next node that is restarted (us)."""
        factor: int = BACK_OFF ** (MAX_RESTARTS - self.restarts_left)
        return RESTART_US * factor


# ---- the decision table ---------------------------------------------------------------------------------------------
def decide(rejection: Rejection, history: History, policy: RecoveryPolicy) -> Action | None:
    """The response to an alarm; None = the value passes.

    The first row that applies counts; "hard" is an alarm on a violated rule, whereas a statistical score may be high
    twice on a correct value.

    | alarm | value came from | response |
    |---|---|---|
    | hard and without cure, a degraded mode is configured | anything | degraded mode |
    | not hard | retransmission, recomputation | none |
    | hard | recomputation | restart of its node, while a restart is left |
    | requests a stop | step, retransmission | stop |
    | requests the next way-point | step, retransmission | next way-point |
    | concerns another stage than the value's | step, retransmission | that stage's latency is charged |
    | any other | step, with grain `message` | retransmission |
    | any other | step, retransmission | recomputation |
    """
    alarm = rejection.alarm
    spec = rejection.spec
    origin = rejection.origin
    if alarm.hard and policy.degrades and _is_without_cure(rejection, history, policy):
        return Action(Response.HOLD, Stage.CONTROL)
    if origin is not Origin.STEP and not alarm.hard:
        return None
    if origin is Origin.RECOMPUTED:
        return _restart_of(spec, history, policy)
    if alarm.stop:
        return _request(Response.STOP, rejection, policy)
    if alarm.abandon_waypoint:
        return _request(Response.ABANDON, rejection, policy)
    if Stage(alarm.stage) is not spec.stage:
        return _charge_of(Stage(alarm.stage))
    if policy.resends and origin is Origin.STEP:
        return Action(Response.RESEND, spec.stage, awaited=spec.name, withholds=policy.gates)
    return _recomputation_of(spec, policy)


def decide_overdue(history: History, policy: RecoveryPolicy) -> Action | None:
    """The response to a path that does not answer a collision alarm in time: its planner's node is restarted."""
    if history.restarts_left <= 0 and policy.degrades:
        return Action(Response.HOLD, Stage.CONTROL)
    return _restart_of(STATES[PATH], history, policy)


def _is_without_cure(rejection: Rejection, history: History, policy: RecoveryPolicy) -> bool:
    """Whether neither restarts nor recomputations have helped."""
    restarts_used_up = policy.restarts and rejection.origin is Origin.RECOMPUTED and history.restarts_left <= 0
    persists = rejection.time_us - history.series_start(rejection.time_us) > PERSISTS_US
    return restarts_used_up or persists


def _restart_of(spec: StateSpec, history: History, policy: RecoveryPolicy) -> Action | None:
    """Restart of the node that wrote a state; None = sensors have none, or no restart is left."""
    if spec.writer not in KERNELS or history.restarts_left <= 0:
        return None
    return Action(Response.RESTART, spec.stage, spec.writer, withholds=policy.gates)


def _request(response: Response, rejection: Rejection, policy: RecoveryPolicy) -> Action:
    """A request to the setpoint generator; a way-point is withheld, other values only if the alarm asks for it."""
    awaited = WAYPOINT
    if rejection.alarm.withhold:
        awaited = rejection.spec.name
    is_withheld = rejection.alarm.withhold or rejection.spec.name == WAYPOINT
    return Action(response, Stage.CONTROL, "waypoint", awaited=awaited, withholds=policy.gates and is_withheld)


def _charge_of(stage: Stage) -> Action:
    """Recomputation of another stage than that of the value, which passes."""
    if stage is Stage.CONTROL:
        return Action(Response.RECOMPUTE, stage, "pid", restores=("pid",))
    return Action(Response.RECOMPUTE, stage)


def _recomputation_of(spec: StateSpec, policy: RecoveryPolicy) -> Action:
    """Recomputation of the stage of a state, or only of the kernel that wrote it."""
    alone = policy.grain != "stage"
    restores: tuple[str, ...] = (spec.writer,)
    if spec.writer in SCANNING and not alone:
        restores = SCANNING
    return Action(Response.RECOMPUTE, spec.stage, restores[0], restores, spec.name, policy.gates, alone)


# ---- the path that answers a collision alarm ------------------------------------------------------------------------
class PathDeadline:
    """Deadline of the path that answers a collision alarm.

    The wait begins with an alarm, and ends with a path that carries the alarm's sequence number or a later one.  If
    every scan re-evaluates the trajectory, an accepted status that withdraws the alarm ends the wait as well: the
    trajectory is free, and the planner need not answer.  A lost flag is no withdrawal: the times and distances of such
    a status still tell of a collision.  Neither is the status of a vehicle without a trajectory, which the check cannot
    judge: there the planner is needed.

    Args:
        limit_s: Deadline (s).
        autopilot: Profile of the mission's autopilot.
    """

    states = frozenset((COLLISION, PATH, WAYPOINT))

    def __init__(self, limit_s: float, autopilot: AutopilotConfig) -> None:
        self._limit_us = 1e6 * limit_s
        self._can_withdraw = autopilot.alarm == "repeated" or autopilot.replanning == "every_map"

    def overdue(self, wait: PathWait, state: State, now: int, *, planner_is_down: bool = False) -> float | None:
        """Take note of an accepted publication; returns the duration of a wait beyond the deadline (s), and ends it.

        Args:
            wait: What is remembered; updated.
            state: Collision status, path or way-point.
            now: Instant of the publication (us).
            planner_is_down: Whether the planner is restarting; the deadline restarts when it is back.
        """
        if state.spec.name == WAYPOINT:
            wait.waypoint = state
            return None
        number = int(state.header["future_collision_seq"][0])
        # A path that answers the alarm, or a later one, ends the wait.
        if state.spec.name == PATH:
            if number >= wait.alarm_number:
                wait.since_us = None
            return None
        # A collision status: an alarm begins the wait, and one that is withdrawn ends it.
        is_alarm = bool(state.header["collision"][0])
        if is_alarm:
            wait.last_number = number
        if wait.since_us is None:
            if is_alarm:
                wait.since_us = now
                wait.alarm_number = number
            return None
        if self._can_withdraw and not is_alarm and number == wait.last_number and _is_free(state, wait.waypoint):
            wait.since_us = None
            return None
        # Otherwise the time counts, but not while the planner is down.
        if planner_is_down:
            wait.since_us = now
            return None
        waited_us = now - wait.since_us
        if waited_us <= self._limit_us:
            return None
        wait.since_us = None
        return 1e-6 * waited_us


def _is_free(status: State, waypoint: State | None) -> bool:
    """Whether a collision status without a flag says that the trajectory in force is free."""
    has_trajectory = waypoint is not None and int(waypoint.header["index"][0]) >= 0
    time_to_collision = float(status.header["time_to_collision"][0])
    distance_to_blocked = float(status.header["distance_to_blocked"][0])
    return has_trajectory and time_to_collision == NO_COLLISION and distance_to_blocked == math.inf


# ---- the degraded mode `hold` ---------------------------------------------------------------------------------------
# Where recovery cannot correct a fault, the mission is given up, and the vehicle holds position.  The commands replace
# those of the tracker, whose inputs and memory are no longer trusted; they depend on odometry alone.
GAIN = 1.0
"""Commanded speed / distance to the position (1/s)."""
SHARE = 0.5
"""Largest commanded speed / v_max."""
VALID_S = 0.1
"""Validity of a command (s): five control periods."""


class HoldPosition:
    """Commands that return the vehicle to the position at which the mode began.

    Args:
        v_max: Speed limit of the mission (m/s).

    Attributes:
        states: Names of the states that it reads.
    """

    states = frozenset(ODOMETRY.values())

    def __init__(self, v_max: float) -> None:
        self._max_speed = SHARE * v_max

    def note(self, memory: HoldMemory, odometry: State) -> None:
        """Store the vehicle's position if it is finite."""
        position = floats(odometry.header, 3).tolist()
        if all(map(math.isfinite, position)):
            memory.position = position

    def begin(self, memory: HoldMemory) -> None:
        """Begin the mode at the latest position."""
        memory.target = memory.position

    def command(self, memory: HoldMemory, published: State) -> State | None:
        """The command in place of a published one; None = none: the flight controller hovers."""
        if not memory.target or not memory.position:
            return None
        dx, dy, dz = (target - current for target, current in zip(memory.target, memory.position, strict=True))
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        rate = 0.0  # commanded speed / distance (1/s)
        if distance > 0.0:
            rate = min(GAIN * distance, self._max_speed) / distance
        command = published.copy()
        command.header[0] = (rate * dx, rate * dy, rate * dz, 0.0, VALID_S)
        return command
