"""What an alarm leads to: `decide`, pure and the only place where that is decided; `Watch` applies it to a detector.

Coupling `inline`: the detector is a gate.  The value is held back, the kernel goes back to the memory that it had, and
is stepped again at once; the result is published, and accepted even if it is the same value.  With `same_twice:
escalate` it is judged again: a rule that is broken twice by the same inputs speaks of the node's memory, and the node
is restarted.  With `grain: message` the producer's copy comes first: a value that was changed on its way is right then,
one that was computed wrongly is not, and is computed again.  Where a restart does not help, `degraded: hover` withholds
all further commands: the flight controller hovers when the last one has expired.

Coupling `observer`: the detector is a subscriber, as the paper's node.  Consumers have seen the value when the alarm
comes, so the kernel goes back at its next step: at the next control period for planning and control, at the next image
for perception, at the next IMU sample for the state estimator.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple
from weakref import proxy

from mavfi.detectors.detector import Alarm, Detector
from mavfi.errors import BadInputError
from mavfi.flight_log import AlarmRecord
from mavfi.mission import RECOVERY, MissionSpec
from mavfi.states import STAGE_KERNELS, STATES, Stage, State, StateSpec

if TYPE_CHECKING:
    from mavfi.hosts.loop.scheduler import Loop

Coupling = Literal["inline", "observer"]
Grain = Literal["stage", "kernel", "message"]
SameTwice = Literal["accept", "escalate"]
Degraded = Literal["none", "hover"]
COLLISION, PATH, COMMAND = "perception.collision_status", "planning.path", "control.command"
RESTART_US, BACK_OFF = 20_000, 3
"""Time that a node restarted by a detector is away (us): its process stays, its memory is initialized; and its
growth with each restart of a flight: together they outlast a fault of 1 s."""
MOST_RESTARTS = 5
"""In one flight: detectors can be wrong themselves, and must not keep a vehicle from flying."""
PERSISTS_US, GAP_US = 2_000_000, 500_000
"""Hard alarms persist if they come for so long, with gaps of at most so long (us)."""
MOST_ALARMS, ALARMS_WITHIN_US = 50, 10_000_000
"""Hard alarms within a time (us) after which a detector that may restart nodes is not asked any more: it is wrong."""
SCANNING = STAGE_KERNELS[Stage.PERCEPTION]
"""Kernels that compute again together, from the image on."""
WAYPOINT = "planning.waypoint"


@dataclass(frozen=True, slots=True)
class Recovery:
    """How the alarms of a detector are answered; keys of a mission.

    Attributes:
        coupling: Of the detector.
        grain: What is repeated: the `stage` with its latency, only the `kernel` that wrote the value, or its `message`:
            the producer sends the copy that it has kept again, at no modelled cost.
        same_twice: What becomes of a recomputation that breaks a rule again (`Alarm.hard`): `accept`, or `escalate` to
            a restart of the node.
        answer_s: A collision alarm that no path answers for so long (s) restarts the planner's node; 0 = never.
        degraded: What becomes of the flight when no restart is left and a rule is still broken, or when hard alarms
            persist: `none`, it goes on; `hover`, commands are withheld from then on.

    Raises:
        BadInputError: An observer is to withhold commands.
    """

    coupling: Coupling = "inline"
    grain: Grain = "stage"
    same_twice: SameTwice = "accept"
    answer_s: float = 0.0
    degraded: Degraded = "none"

    def __post_init__(self) -> None:
        if self.degraded != "none" and self.coupling != "inline":
            raise BadInputError(f"degraded: {self.degraded}: withholds commands; allowed: with coupling inline")

    @staticmethod
    def of(spec: MissionSpec) -> "Recovery":
        """As a mission wants it."""
        return Recovery(*(getattr(spec, key) for key in RECOVERY))

    @property
    def restarts(self) -> bool:
        """Whether nodes may be restarted."""
        return self.same_twice == "escalate" or self.answer_s > 0

    @property
    def remembers(self) -> bool:
        """Whether what an alarm leads to depends on earlier ones: a checkpoint knows nothing of these."""
        return self.restarts or self.degraded != "none"


INLINE = Recovery()
"""A gate; the stage runs again, and the same value twice is accepted."""


@dataclass(frozen=True, slots=True)
class Action:
    """Response to an alarm.

    Attributes:
        kind: "recompute", a request to the setpoint generator: "abandon" the way-point in force, or "stop"; "restart"
            of the node of `kernel`; "resend" of the value by its producer; or "hover" from now on.
        stage: Whose latency is charged.
        kernel: The kernel that is stepped again; "" = none, the latency alone is charged.
        restores: Kernels whose memory is put back before, in this order.
        awaited: The state whose next value comes from the recomputation, and passes; "" = none.
        withholds: Whether the value that raised the alarm is held back.
        alone: Whether only `kernel` is stepped again, on the inputs that it had, with its own latency.
    """

    kind: Literal["recompute", "abandon", "stop", "restart", "resend", "hover"]
    stage: Stage
    kernel: str = ""
    restores: tuple[str, ...] = ()
    awaited: str = ""
    withholds: bool = False
    alone: bool = False


class Awaited(NamedTuple):
    """A recomputation under way: the rejected value, and the place of its alarm in the record."""

    rejected: State
    place: int


def decide(
    alarm: Alarm, spec: StateSpec, recovery: Recovery, *, after: Literal["", "resend", "recompute"] = "",
    uncured: bool = False,
) -> Action:  # fmt: skip
    """The response to an alarm about a value of state `spec`.

    Only a gate (coupling `inline`) holds values back.

    Args:
        alarm: The alarm.
        spec: Of the state.
        recovery: How alarms are answered.
        after: What the value is the result of: a message that is wrong twice was computed wrongly, a recomputation
            that is wrong twice speaks of the memory of its node.
        uncured: No restart is left, or hard alarms persist, and the recovery has a degraded mode.

    Raises:
        BadInputError: The alarm names a stage that cannot be run again.
    """
    if alarm.stage not in STAGE_KERNELS:
        text = f"stage {alarm.stage!r}: cannot be run again; allowed: {', '.join(STAGE_KERNELS)}"
        raise BadInputError(f"detector {alarm.source!r}: {text}")
    stage, gated = Stage(alarm.stage), recovery.coupling == "inline"
    if after == "recompute" or uncured:
        restart = Action("restart", spec.stage, spec.writer, withholds=gated)
        return Action("hover", Stage.CONTROL) if uncured else restart
    if alarm.stop or alarm.abandon_waypoint:
        kind: Literal["abandon", "stop"] = "stop" if alarm.stop else "abandon"
        return Action(kind, Stage.CONTROL, "waypoint", (), WAYPOINT, gated and spec.name == WAYPOINT)
    if stage is spec.stage:
        if recovery.grain == "message" and not after:
            return Action("resend", stage, "", (), spec.name, gated)
        alone = recovery.grain != "stage"
        restores = SCANNING if spec.writer in SCANNING and not alone else (spec.writer,)
        return Action("recompute", stage, restores[0], restores, spec.name, gated, alone)
    # another stage than the writer's is to run again: this value passes
    return Action("recompute", stage, "pid", ("pid",)) if stage is Stage.CONTROL else Action("recompute", stage)


def record_of(alarm: Alarm, action: Action, state: str, time_us: int) -> AlarmRecord:
    """The record of an alarm, before its outcome is known."""
    outcome = "restarted" if action.kind == "restart" else "replaced" if action.awaited else "accepted"
    return AlarmRecord(
        1e-6 * time_us, alarm.source, state, alarm.stage, alarm.score, tuple(alarm.fields), action.kind, outcome
    )


def _never(kernel: str, now: int, after_us: int) -> None:
    del kernel, now, after_us
    raise AssertionError("no node is restarted under this policy")


class Watch:
    """A detector as a tap of a loop, which answers its alarms.

    It has memory only if its recovery `remembers`; such flights are not fast-forwarded.

    Args:
        loop: The flight.
        detector: What watches it.
        recovery: How its alarms are answered.
        restart: Restarts the node of a kernel: kernel, instant (us), time until it is back (us).

    Attributes:
        restarts_left: How many nodes it may still restart.
        alarm: What the detector said of the last value, None = nothing.
        action: The answer to it.
        degraded: Whether it withholds every command, and judges nothing.
        seals: Whether it must be given each value as its producer hands it over.
        states: Names of the states that it must be shown; None = all.
    """

    def __init__(
        self, loop: "Loop", detector: Detector, recovery: Recovery = INLINE,
        restart: Callable[[str, int, int], None] = _never,
    ) -> None:  # fmt: skip
        self._loop = proxy(loop)  # which owns this: maps of a flight that is over are freed at once
        self._detector, self._recovery, self._restart = detector, recovery, restart
        self.restarts_left = MOST_RESTARTS
        self.alarm: Alarm | None = None
        self.action: Action | None = None
        self.degraded = False
        self._hard_us = (0, -GAP_US)  # the first and the last of a row of hard alarms
        states = getattr(detector, "states", None)
        always = {WAYPOINT} | ({COLLISION, PATH} if recovery.answer_s else set())  # with or without an alarm at them
        always |= set() if recovery.degraded == "none" else {COMMAND}
        self.states = None if states is None else always.union(states)
        self._sent: State | None = None
        self._seal = getattr(detector, "seal", None)
        self.seals = self._seal is not None or recovery.grain == "message"
        self._hard: deque[int] = deque(maxlen=MOST_ALARMS)  # instants (us) of the last hard alarms
        self._silenced = False
        self._asked: tuple[int, int] | None = None  # instant (us) and number of a collision alarm without an answer

    def seal(self, state: State, now: int) -> None:
        """Keep a value as its producer hands it over; a detector may seal it."""
        self._sent = state
        if self._seal is not None:
            self._seal(state, now)

    def __call__(self, state: State, now: int) -> State | None:
        """Show a value to the detector; the result of a recomputation passes, unless it is judged again."""
        loop, detector, recovery = self._loop, self._detector, self._recovery
        awaited = loop.awaited.pop(state.spec.name, None)
        self.alarm = self.action = None
        if self.degraded:
            return None if state.spec.name == COMMAND else state
        asks = not self._silenced and (awaited is None or recovery.same_twice == "escalate")
        alarm = detector.check(state, now) if asks else None
        after = self._after(awaited)
        uncured = alarm is not None and self._is_uncured(alarm, now, again=after == "recompute")
        given_up = after == "recompute" and self.restarts_left == 0
        if awaited is not None and (alarm is None or not alarm.hard or given_up) and not uncured:
            alarm = None  # a statistic may be right twice, a rule cannot
        if alarm is None or recovery.coupling == "observer":
            detector.accept(state, now)
        if awaited is not None:
            self._settle(awaited, state, alarm)
        self.alarm = alarm
        if alarm is None:
            self._keep_waiting(state, now)
            return state
        if alarm.hard and recovery.restarts:
            self._count(now)
        action = decide(alarm, state.spec, recovery, after=after, uncured=uncured)
        self.action = action
        loop.record.alarms.append(record_of(alarm, action, state.spec.name, now))
        self._answer(action, state, now)
        withheld = action.withholds or (action.kind == "hover" and state.spec.name == COMMAND)
        return None if withheld else state

    def _after(self, awaited: Awaited | None) -> Literal["", "resend", "recompute"]:
        """What a value is the result of; what other actions led to counts as recomputed."""
        if awaited is None:
            return ""
        return "resend" if self._loop.record.alarms[awaited.place].action == "resend" else "recompute"

    def _is_uncured(self, alarm: Alarm, now: int, *, again: bool) -> bool:
        """Whether a degraded mode is wanted, and begins with this alarm."""
        if not alarm.hard or self._recovery.degraded == "none":
            return False
        first, last = self._hard_us
        self._hard_us = first, last = (now if now - last > GAP_US else first), now
        used_up = again and self._recovery.restarts and self.restarts_left == 0
        return used_up or last - first > PERSISTS_US

    def _count(self, now: int) -> None:
        """Count a hard alarm; too many of them say that the detector is wrong."""
        self._hard.append(now)
        if len(self._hard) == MOST_ALARMS and now - self._hard[0] < ALARMS_WITHIN_US:
            self._silenced = True
            self._loop.record.note(now, "detector_silenced", {"alarms": MOST_ALARMS})

    def _settle(self, awaited: Awaited, state: State, alarm: Alarm | None) -> None:
        """Note the outcome of a recomputation, which may have raised an alarm again."""
        alarms = self._loop.record.alarms
        if alarms[awaited.place].action in ("recompute", "resend"):
            passed = "accepted" if state.same_bits(awaited.rejected) else "repaired"
            outcome = passed if alarm is None else "rejected"
            alarms[awaited.place] = replace(alarms[awaited.place], outcome=outcome)
            if outcome == "repaired" and self._hard:
                self._hard.pop()  # the detector was right

    def _answer(self, action: Action, state: State, now: int) -> None:
        loop = self._loop
        if action.kind == "hover":
            self.degraded = True
            return
        if action.kind == "restart":
            away_us = RESTART_US * BACK_OFF ** (MOST_RESTARTS - self.restarts_left)
            self.restarts_left -= 1
            self._restart(action.kernel, now, away_us)
            return
        if action.awaited:
            loop.awaited[action.awaited] = Awaited(state, len(loop.record.alarms) - 1)
        if action.kind == "resend":
            assert self._sent is not None  # it was handed over before it was judged
            if action.withholds:
                loop.deliver(self._sent, now)
            else:
                loop.at(now, "resend", self._sent)  # consumers see the value at hand first
            return
        if self._recovery.coupling == "observer":
            if action.kernel:
                loop.requests[action.kernel] = action
        elif action.kind == "recompute" and (action.withholds and state.spec.writer in loop.busy):
            return  # an alarm at another of its states has made it run again
        elif not action.kernel or (not action.awaited and action.kernel in loop.busy):
            loop.charge(action)
        else:
            loop.recompute(action, now)

    def _keep_waiting(self, state: State, now: int) -> None:
        """Wait for the path that answers a collision alarm; if it is too late, restart the planner's node."""
        recovery, limit = self._recovery, self._recovery.answer_s
        if not limit or state.spec.name not in (COLLISION, PATH):
            return
        number = int(state.header["future_collision_seq"][0])
        if self._asked is None:
            if state.spec.name == COLLISION and state.header["collision"][0]:
                self._asked = now, number
            return
        since, asked = self._asked
        if state.spec.name == PATH:
            if number >= asked:
                self._asked = None
        elif recovery.degraded != "none" and STATES[PATH].writer in self._loop.down:
            self._asked = now, asked  # a restarted planner is given its time before nothing else is left
        elif now - since > 1e6 * limit:
            self._asked = None
            if self.restarts_left or self._recovery.degraded != "none":
                alarm = Alarm("deadline", Stage.PLANNING, score=1e-6 * (now - since) / limit, hard=True)
                uncured = self.restarts_left == 0
                action = decide(alarm, STATES[PATH], self._recovery, after="recompute", uncured=uncured)
                self._loop.record.alarms.append(record_of(alarm, action, state.spec.name, now))
                self._answer(action, state, now)
