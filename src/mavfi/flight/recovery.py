"""Recovery: `DetectorTap` connects a detector to a flight, and carries out what `decide.decide` selects.

Coupling `inline`: the detector is a gate.  A rejected value is withheld, the kernel's memory is restored, and its step
is repeated at once; the result is published and accepted, even if it is the same value.  With `same_twice: escalate` it
is checked again: a rule violated twice on the same inputs indicates corrupted node memory, and the node is restarted.
With `grain: message` the producer's copy is retransmitted first, which repairs a value corrupted in transit; a value
that was computed incorrectly is rejected again and then recomputed.  A message that its consumers cannot read is
retransmitted whatever the detector is, since the transport knows of it.  If a restart does not help, a degraded mode
replaces all further commands, see `degraded`.

Coupling `observer`: the detector is a subscriber, as the paper's node.  Consumers have received the value by the time
of the alarm, so the kernel is restored at its next step: at the next control period for planning and control, at the
next image for perception, at the next IMU sample for the state estimator.
"""

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from weakref import proxy

from mavfi.detectors.detector import DIFFERENT, Alarm, Detector, NotedCalls, checked_alarm, is_custom
from mavfi.errors import machine_failure
from mavfi.flight.decide import (
    INLINE,
    MAX_ALARMS,
    MAX_UNCHANGED,
    PATH,
    WAYPOINT,
    Action,
    History,
    HoldPosition,
    Origin,
    PathDeadline,
    PendingResult,
    RecoveryPolicy,
    Rejection,
    Response,
    decide,
    decide_overdue,
)
from mavfi.flight.state import EventKind
from mavfi.pipeline.kernel import Kernel, repeat
from mavfi.plugins import plugin_failure, reason
from mavfi.record import CRASHED, LIMITED, SILENCED, AlarmRecord
from mavfi.states import PPC_STAGES, STATES, Stage, State, StateSpec

if TYPE_CHECKING:
    from mavfi.flight.loop import Loop

COMMAND = "control.command"
"""State that the degraded mode replaces."""
UNREADABLE = "unreadable"
"""Source of the alarm on a message that its consumers cannot read."""


class DetectorTap:
    """Connects a detector to a loop as a tap, and carries out the response to its alarms.

    It is stateful only if its policy `remembers`, or limits recomputations; its state is `memory`.

    Args:
        loop: The flight.
        detector: The detector.
        policy: The recovery policy.
        restart: Restarts the node of a kernel; arguments: kernel, instant (us), down time (us).

    Attributes:
        memory: What it remembers between alarms.
        seals: Whether it needs each value before injection, as sent by the producer.
        states: Names of the states that it needs to see; None = all.
    """

    def __init__(
        self,
        loop: "Loop",
        detector: Detector,
        policy: RecoveryPolicy = INLINE,
        restart: Callable[[str, int, int], None] = lambda *_: None,
    ) -> None:
        self._loop = proxy(loop)  # the loop owns this object; no cycle, so that maps are freed at once
        self._detector = detector
        self._policy = policy
        self._restart = restart
        self._is_custom = is_custom(detector)
        # looked up at each call, since a memory fault replaces the methods of a detector in flight
        self._calls: Any = detector
        if self._is_custom:
            self._calls = NotedCalls(detector)
        self._detector_seals = detector.seals
        self.seals = self._detector_seals or policy.resends
        self._hold: HoldPosition | None = None
        if policy.degrades:
            self._hold = HoldPosition(loop.scenario.v_max)
        self._deadline: PathDeadline | None = None
        if policy.answer_s:
            self._deadline = PathDeadline(policy.answer_s, loop.scenario.autopilot)
        self.states = self._needed_states(detector.states)
        self.memory = History()
        self._sent: State | None = None

    def _needed_states(self, detector_states: Collection[str] | None) -> frozenset[str] | None:
        """States that detector and recovery need to see; None = all."""
        if detector_states is None:
            return None
        needed = {WAYPOINT, *detector_states}  # the answer to a request for another way-point
        if self._deadline is not None:
            needed |= PathDeadline.states
        if self._hold is not None:
            needed |= {COMMAND} | HoldPosition.states
        return frozenset(needed)

    def begin(self) -> None:
        """Initialize the detector at the start of a flight."""
        self._calls.start()

    def seal(self, state: State, now: int) -> None:
        """Keep a copy of a value as sent by its producer, and let the detector seal it."""
        self._sent = state
        if self._detector_seals and not self.memory.crashed:
            try:
                self._calls.seal(state, now)
            except Exception as error:  # noqa: BLE001 - of a custom detector
                self.give_up(error, now)

    # ---- publications -----------------------------------------------------------------------------------------------
    def __call__(self, state: State, now: int) -> State | None:
        """Check a value; the result of a recomputation passes without a check unless the policy escalates."""
        awaited = self._loop.state.awaited.pop(state.spec.name, None)

        # In degraded mode nothing is checked, and every command is replaced.
        if self._hold is not None:
            if state.spec.name in HoldPosition.states:
                self._hold.note(self.memory.hold, state)
            if self.memory.degraded:
                if state.spec.name == COMMAND:
                    return self._hold.command(self.memory.hold, state)
                return state

        # Ask the detector; it records at once what it accepts.
        alarm = None
        is_accepted = False
        if self._is_checked(awaited, now):
            try:
                alarm = self._calls.check(state, now)
                if alarm is None:
                    self._calls.accept(state, now)
                    is_accepted = True
            except Exception as error:  # noqa: BLE001 - of a custom detector
                self.give_up(error, now)
                alarm = None

        # Fast path: a value of a regular step without an alarm, almost always.
        if is_accepted and awaited is None:
            if self._deadline is not None:
                self._watch_deadline(state, now)
            return state
        return self._respond_or_pass(state, now, alarm, awaited, is_accepted=is_accepted)

    def _is_checked(self, awaited: PendingResult | None, now: int) -> bool:
        """Whether the detector is asked about a value."""
        if self.memory.silenced:
            return False
        if awaited is not None and not self._policy.escalates:
            return False
        return not (self._policy.limits and self.memory.has_counted(MAX_UNCHANGED, now))

    def _respond_or_pass(
        self, state: State, now: int, alarm: Alarm | None, awaited: PendingResult | None, *, is_accepted: bool
    ) -> State | None:
        """Respond to an alarm on a value, or let it pass; returns the value to publish, None = it is withheld.

        Args:
            state: The value.
            now: Instant (us).
            alarm: The alarm on it; None = none, or the detector was not asked.
            awaited: The recomputation of which it is the result; None = it is that of a regular step.
            is_accepted: Whether the detector has already recorded it.
        """
        action = None
        if alarm is not None:
            alarm = checked_alarm(self._detector, alarm)
            action = self._choose(alarm, state.spec, now, awaited)
        # A value that consumers receive in spite of an alarm, or without a check, is one that the detector records.
        if not is_accepted and (action is None or not self._policy.gates):
            self._record_published(state, now)
        if awaited is not None:
            self._note_outcome(awaited, state, action)
        # No response: the value passes.
        if alarm is None or action is None:
            if self._deadline is not None:
                self._watch_deadline(state, now)
            return state
        # A response: it may withhold the value, as the degraded mode does with the command that it begins at.
        self._respond_to(alarm, action, state.spec, state, now)
        is_replaced = action.kind is Response.HOLD and state.spec.name == COMMAND
        if action.withholds or is_replaced:
            return None
        return state

    def _record_published(self, state: State, now: int) -> None:
        """Pass a published value to the detector that it has not accepted itself."""
        if self.memory.crashed:
            return
        try:
            self._calls.accept(state, now)
        except Exception as error:  # noqa: BLE001 - of a custom detector
            self.give_up(error, now)

    def lost(self, state: State, now: int) -> bool:
        """Respond to a message that its consumers cannot read; False = there is no response.

        Args:
            state: The producer's copy.
            now: Instant (us).
        """
        spec = state.spec
        if spec.stage not in PPC_STAGES or self.memory.degraded:
            return False
        awaited = self._loop.state.awaited.pop(spec.name, None)
        alarm = Alarm(UNREADABLE, spec.stage.value, score=DIFFERENT, fields=(spec.name,), hard=True)
        action = None
        if not self.memory.silenced and (awaited is None or self._policy.escalates):
            action = self._choose(alarm, spec, now, awaited)
        if awaited is not None:
            self._note_outcome(awaited, None, action)
        if action is None:
            return False
        self._respond_to(alarm, action, spec, None, now)
        return True

    def give_up(self, error: Exception, now: int) -> None:
        """Disable a custom detector that raised an exception after the injection; raises any other exception.

        It may have assumed what no longer holds after the injection.
        """
        if not (self._is_custom and self._loop.injected) or machine_failure(error):
            raise error
        if not self.memory.silenced:
            self._silence(now, CRASHED, {"how": plugin_failure(error) or reason(error)})
        self.memory.crashed = True

    # ---- decisions --------------------------------------------------------------------------------------------------
    def _choose(self, alarm: Alarm, spec: StateSpec, now: int, awaited: PendingResult | None) -> Action | None:
        """Select the response to an alarm on a value of state `spec`; None = the value passes."""
        action = decide(Rejection(alarm, spec, self._origin(awaited), now), self.memory, self._policy)
        if alarm.hard and self._policy.degrades:
            self.memory.extend_series(now)
        return action

    def _origin(self, awaited: PendingResult | None) -> Origin:
        """What produced a value; any action other than a retransmission counts as a recomputation."""
        if awaited is None:
            return Origin.STEP
        if self._loop.record.alarms[awaited.alarm_index].action == Response.RESEND:
            return Origin.RESENT
        return Origin.RECOMPUTED

    def _watch_deadline(self, state: State, now: int) -> None:
        """Monitor the deadline of the path that answers a collision alarm; restart the planner's node on a miss."""
        deadline = self._deadline
        policy = self._policy
        assert deadline is not None  # the caller checks it
        if state.spec.name not in deadline.states:
            return
        planner_is_down = policy.degrades and STATES[PATH].writer in self._loop.state.down
        waited_s = deadline.overdue(self.memory.path_wait, state, now, planner_is_down=planner_is_down)
        if waited_s is None:
            return
        action = decide_overdue(self.memory, policy)
        if action is None:
            return
        alarm = Alarm("deadline", Stage.PLANNING, score=waited_s / policy.answer_s, hard=True)
        self._loop.record.alarms.append(record_of(alarm, action, state.spec.name, now))
        self._execute(action, state, now)

    # ---- responses --------------------------------------------------------------------------------------------------
    def _respond_to(self, alarm: Alarm, action: Action, spec: StateSpec, rejected: State | None, now: int) -> None:
        """Record and execute the response to the alarm on a value; `rejected`: the value, None = it is unreadable."""
        if self._policy.limits or (alarm.hard and self._policy.restarts):
            self._count_alarm(action, now)
        # Its outcome may become known later.
        self._loop.record.alarms.append(record_of(alarm, action, spec.name, now))
        self._execute(action, rejected, now)

    def _count_alarm(self, action: Action, now: int) -> None:
        """Count an alarm against the detector; disable one with too many of them as faulty."""
        limits = self._policy.limits
        record = self._loop.record
        self.memory.count_alarm(now, skips_waypoint=limits and action.kind is Response.ABANDON)
        if limits and self.memory.has_counted(MAX_UNCHANGED, now):
            record.note(now, LIMITED, {"alarms": MAX_UNCHANGED})
        if self.memory.has_counted(MAX_ALARMS, now):
            self._silence(now, SILENCED, {"alarms": MAX_ALARMS})

    def _silence(self, now: int, kind: str, data: dict[str, object]) -> None:
        """Ask the detector no more in this flight."""
        self.memory.silenced = True
        self._loop.record.note(now, kind, data)

    def _note_outcome(self, awaited: PendingResult, state: State | None, action: Action | None) -> None:
        """Record the outcome of a recomputation, given its result (None = an unreadable one) and the response to it."""
        alarms = self._loop.record.alarms
        if alarms[awaited.alarm_index].action not in (Response.RECOMPUTE, Response.RESEND):
            return
        if action is not None or state is None:
            outcome = "rejected"
        elif awaited.rejected is not None and state.same_bits(awaited.rejected):
            outcome = "accepted"
        else:
            outcome = "repaired"
        alarms[awaited.alarm_index] = replace(alarms[awaited.alarm_index], outcome=outcome)
        if outcome == "repaired" and self.memory.counted_us and self._policy.confirms:
            self.memory.counted_us.pop()  # a repaired value confirms the alarm

    def _execute(self, action: Action, rejected: State | None, now: int) -> None:
        """Carry out an action; its alarm is the last one in the record."""
        match action.kind:
            case Response.HOLD:
                assert self._hold is not None  # the mode is configured
                self._hold.begin(self.memory.hold)
                self.memory.degraded = True
            case Response.RESTART:
                self._restart(action.kernel, now, self.memory.down_time())
                self.memory.restarts_left -= 1
            case Response.RESEND:
                self._await_result(action, rejected)
                self._resend(action, now)
            case _:
                self._await_result(action, rejected)
                self._request(action, now)

    def _await_result(self, action: Action, rejected: State | None) -> None:
        """Recognize the next value of the awaited state as the result of an action."""
        if action.awaited:
            self._loop.state.awaited[action.awaited] = PendingResult(rejected, len(self._loop.record.alarms) - 1)

    def _resend(self, action: Action, now: int) -> None:
        """Retransmit the producer's copy of the value."""
        assert self._sent is not None  # `seal` precedes the check
        producers_copy = self._sent.copy()  # another object: a detector may remember this one
        if action.withholds:
            self._loop.deliver(producers_copy, now)
        else:
            # Consumers first receive the current value.
            self._loop.state.schedule(now, EventKind.RESEND, producers_copy)

    def _request(self, action: Action, now: int) -> None:
        """Request a recomputation, another way-point or a stop: at once, or with an observer at the next step."""
        loop = self._loop
        if not self._policy.gates:
            if action.kernel:
                loop.state.requests[action.kernel] = action
            return
        if action.kind is Response.RECOMPUTE and action.withholds and STATES[action.awaited].writer in loop.state.busy:
            return  # an alarm on another of its states has already requested this recomputation
        is_only_charged = not action.kernel or (not action.awaited and action.kernel in loop.state.busy)
        if is_only_charged:
            loop.charge(action, now)
        else:
            loop.recompute(action, now)


def record_of(alarm: Alarm, action: Action, state: str, time_us: int) -> AlarmRecord:
    """The record of an alarm, before its outcome is known."""
    if action.kind is Response.RESTART:
        outcome = "restarted"
    elif action.awaited:
        outcome = "replaced"
    else:
        outcome = "accepted"
    return AlarmRecord(
        time_s=1e-6 * time_us,
        source=alarm.source,
        state=state,
        stage=alarm.stage,
        score=alarm.score,
        fields=tuple(alarm.fields),
        action=action.kind.value,
        outcome=outcome,
    )


# ---- duplicated execution of steps ----------------------------------------------------------------------------------
# Compares two executions of a kernel's step, and decides by a third.  All start from the same memory and inputs, see
# `pipeline.kernel.repeat`.  Each costs the kernel's latency; the results are published after the last one.  Only
# published values are compared; memory is that of the last execution.
SOURCE = "duplicate"
"""Source of the alarm on two executions that differ."""
_SCORE = 2.0
"""Score of that alarm: above the threshold 1, without a finer meaning."""


class Duplicates:
    """Duplicates the steps of selected kernels of a loop.

    Args:
        loop: The flight.
        kernels: Names of the kernels.
    """

    def __init__(self, loop: "Loop", kernels: Collection[str]) -> None:
        self._loop = proxy(loop)  # the loop owns this object
        self._kernels = frozenset(kernels)

    def __call__(self, kernel: Kernel, first: list[State], now: int) -> tuple[list[State], int]:
        """Return the results to publish, given the first execution's, and the time of the further executions (us)."""
        if kernel.name not in self._kernels:
            return first, 0
        second = self._execute_again(kernel, now)
        extra_runs = 1
        published = second
        different_state = _first_difference(first, second)
        if different_state is not None:
            # A third execution decides: the other one that equals it was correct.
            published = self._execute_again(kernel, now)
            extra_runs = 2
            self._record_alarm(kernel, different_state, _outcome(first, second, published), now)
        cost_us = extra_runs * self._loop.latencies.of_kernel(kernel.name, now)
        record = self._loop.record
        record.recompute_us[kernel.stage.value] += cost_us
        record.compute_us[kernel.name] += cost_us
        return published, cost_us

    def _record_alarm(self, kernel: Kernel, state: str, outcome: str, now: int) -> None:
        """Add the alarm on a state in which two executions differ to the flight's record."""
        alarm = AlarmRecord(
            time_s=1e-6 * now,
            source=SOURCE,
            state=state,
            stage=kernel.stage.value,
            score=_SCORE,
            fields=(state,),
            action=Response.RECOMPUTE.value,
            outcome=outcome,
        )
        self._loop.record.alarms.append(alarm)

    def _execute_again(self, kernel: Kernel, now: int) -> list[State]:
        """Repeat the kernel's last step; the repetition is not a call that a fault can address."""
        self._loop.repeating = True
        try:
            repeat(kernel)
            return kernel.step(now)
        finally:
            self._loop.repeating = False


def _outcome(first: list[State], second: list[State], third: list[State]) -> str:
    """Outcome of the alarm on two different executions, given the third one."""
    if _first_difference(third, second) is None:
        return "repaired"
    if _first_difference(third, first) is None:
        return "accepted"
    return "rejected"


def _first_difference(left: list[State], right: list[State]) -> str | None:
    """Name of the first state that differs, or that only one of two executions published; None = all are identical."""
    for left_state, right_state in zip(left, right, strict=False):
        if left_state.spec is not right_state.spec or not left_state.same_bits(right_state):
            return left_state.spec.name
    common = min(len(left), len(right))
    for state in (*left[common:], *right[common:]):
        return state.spec.name
    return None
