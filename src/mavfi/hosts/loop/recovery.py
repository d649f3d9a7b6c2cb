"""Recovery: `Watch` connects a detector to a flight, and executes the response that `decision.decide` selects.

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

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING
from weakref import proxy

from mavfi.detectors.bounded import LIMIT_S, StuckError, is_foreign, limited
from mavfi.detectors.detector import Alarm, Detector, checked_alarm
from mavfi.detectors.sealed import DIFFERENT
from mavfi.errors import machine_failure
from mavfi.flight_record import CRASHED, LIMITED, SILENCED, STUCK
from mavfi.hosts.loop.decision import Action, Awaited, decide, record_of
from mavfi.hosts.loop.degraded import MODES, Setpoints, Trail
from mavfi.hosts.loop.policy import INLINE, Recovery
from mavfi.hosts.loop.waiting import PATH, WAYPOINT, Answer, Waiting, repeats
from mavfi.kernels.recovery.limits import CURABLE, FEW, GAP_US, MANY, MOST_RESTARTS, REFUSED, UNCURED
from mavfi.kernels.recovery.response import FIRST, RECOMPUTED, RESENT
from mavfi.numerics.jit import entry
from mavfi.pipeline.memory import Memory
from mavfi.plugins import plugin_failure, reason
from mavfi.states import PPC_STAGES, STATES, Stage, State, StateSpec

if TYPE_CHECKING:
    from mavfi.hosts.loop.scheduler import Loop

COMMAND = "control.command"
UNREADABLE = "unreadable"
"""Source of the alarm on a message that its consumers cannot read."""
MOST_ALARMS = 50
"""Number of hard alarms in `ALARMS_WITHIN_US` after which a detector that may restart nodes is disabled as faulty."""
MOST_UNCHANGED = 5
"""Number of recomputations without a change, within the same time, above which `same_twice: limit` does not respond."""
SKIPPED_US = 50_000_000
"""A way-point that is skipped counts as so many, this much later (us), and until then there is no response either: it
changes the route, and several can lead into an obstacle."""


@dataclass(slots=True)
class Remembered(Memory):
    """What recovery remembers between alarms.

    Attributes:
        restarts_left: Remaining number of node restarts.
        degraded: Whether it is in degraded mode: it replaces every command and checks nothing.
        silenced: Whether the detector is disabled as faulty or stuck.
        first_us: First instant of a contiguous series of hard alarms (us).
        last_us: Its last instant (us).
        hard: Instants of the latest alarms that count against the detector (us): with `limit` all, else the hard ones.
        waiting: The wait for a path.
        trail: Positions for the degraded mode.
    """

    restarts_left: int = MOST_RESTARTS
    degraded: bool = False
    silenced: bool = False
    first_us: int = 0
    last_us: int = -GAP_US
    hard: list[int] = field(default_factory=list)
    waiting: Waiting = field(default_factory=Waiting)
    trail: Trail = field(default_factory=Trail)


def _ignore(state: State, now: int) -> None:
    """Instead of `accept`."""


class Watch:
    """Connects a detector to a loop as a tap, and executes the response to its alarms.

    It is stateful only if its recovery `remembers`, or limits recomputations; its state is `memory`.

    Args:
        loop: The flight.
        detector: The detector.
        recovery: The recovery policy.
        restart: Restarts the node of a kernel; arguments: kernel, instant (us), down time (us).

    Attributes:
        memory: What it remembers between alarms.
        alarm: The alarm on the last value, None = none.
        action: The response to it.
        seals: Whether it needs each value before injection, as sent by the producer.
        states: Names of the states that it needs to see; None = all.
    """

    keepers = ()

    def __init__(
        self, loop: "Loop", detector: Detector, recovery: Recovery = INLINE,
        restart: Callable[[str, int, int], None] = lambda *_: None,
    ) -> None:  # fmt: skip
        self._loop = proxy(loop)  # the loop owns this object; no cycle, so that maps are freed at once
        self._detector, self._recovery, self._restart = detector, recovery, restart
        self._check = limited(detector, "check")
        self._start = limited(detector, "start")
        self._accept, self._seal = limited(detector, "accept"), limited(detector, "seal") if detector.seals else None
        self._is_foreign = is_foreign(detector)
        self._functions = loop.functions
        self._respond = entry(loop.functions.respond, FIRST, *[False] * 5)
        self.forget()
        states = detector.states
        always = {WAYPOINT}.union(Answer.states if recovery.answer_s else ())  # required even without a model
        self._setpoints = None
        if recovery.degraded != "none":
            self._setpoints = Setpoints(recovery.degraded, loop.scenario.v_max, loop.functions)
            always |= {COMMAND} | self._setpoints.states
        self.states = None if states is None else always.union(states)
        self.seals = self._seal is not None or recovery.resends
        self._answer = None
        if recovery.answer_s:
            repeated = repeats(loop.scenario.autopilot)
            self._answer = Answer(recovery.answer_s, repeated=repeated, functions=loop.functions)

    def forget(self) -> None:
        """Reset what it remembers, as at the start of a flight."""
        self.memory = Remembered()
        self.alarm: Alarm | None = None
        self.action: Action | None = None
        self._sent: State | None = None

    def begin(self) -> None:
        """Initialize the detector at the start of a flight."""
        try:
            self._start()
        except StuckError as error:
            self.give_up(error, 0)

    @property
    def gave_up(self) -> bool:
        """Whether the detector is called no more."""
        return self._accept is _ignore

    def seal(self, state: State, now: int) -> None:
        """Keep a copy of a value as sent by its producer, and let the detector seal it."""
        self._sent = state
        if self._seal is not None:
            try:
                self._seal(state, now)
            except (StuckError, Exception) as error:
                self.give_up(error, now)

    def __call__(self, state: State, now: int) -> State | None:
        """Check a value; the result of a recomputation passes without a check unless the policy escalates."""
        memory = self.memory
        awaited = self._loop.awaited.pop(state.spec.name, None)
        self.alarm = self.action = None
        if self._setpoints is not None and state.spec.name in self._setpoints.states:
            self._setpoints.note(memory.trail, state, flown=not memory.degraded)
        if self._setpoints is not None and memory.degraded:
            return self._setpoints.command(memory.trail, state) if state.spec.name == COMMAND else state
        asks = self._asks(awaited) and not self._is_limited(now)
        alarm = None
        try:
            if asks:
                alarm = self._check(state, now)
                if alarm is None:
                    self._accept(state, now)
        except (StuckError, Exception) as error:
            asks = False
            self.give_up(error, now)
        admitted = asks and alarm is None
        if admitted and awaited is None:  # almost always
            self._keep_waiting(state, now)
            return state
        action = self._choose(alarm, state.spec, now, awaited)
        if not admitted and (action is None or self._recovery.coupling == "observer"):
            self._note(state, now)
        if awaited is not None:
            self._settle(awaited, state)
        if action is None:
            self._keep_waiting(state, now)
            return state
        self._respond_to(state.spec, state, now)
        withheld = action.withholds or (action.kind in MODES and state.spec.name == COMMAND)
        return None if withheld else state

    def _note(self, state: State, now: int) -> None:
        """Pass a published value to the detector that it has not admitted itself."""
        try:
            self._accept(state, now)
        except (StuckError, Exception) as error:
            self.give_up(error, now)

    def give_up(self, error: BaseException, now: int) -> None:
        """Disable a detector of which a call failed; raises an exception that is no consequence of the fault.

        A detector that is not part of mavfi may have assumed what no longer holds after the injection.
        """
        if isinstance(error, StuckError):
            how = error.died
        elif self._is_foreign and self._loop.injected and not machine_failure(error):
            how = plugin_failure(error) or reason(error)
        else:
            raise error
        if not self.memory.silenced:
            self._silence(now, *((CRASHED, {"how": how}) if how else (STUCK, {"seconds": LIMIT_S})))
        self._accept, self._seal = _ignore, None

    def lost(self, state: State, now: int) -> bool:
        """Respond to a message that its consumers cannot read; False = there is no response.

        Args:
            state: The producer's copy.
            now: Instant (us).
        """
        spec = state.spec
        if spec.stage not in PPC_STAGES or self.memory.degraded:
            return False
        awaited = self._loop.awaited.pop(spec.name, None)
        self.alarm = self.action = None
        hard = Alarm(UNREADABLE, spec.stage.value, score=DIFFERENT, fields=(spec.name,), hard=True)
        action = self._choose(hard if self._asks(awaited) else None, spec, now, awaited)
        if awaited is not None:
            self._settle(awaited, None)
        if action is not None:
            self._respond_to(spec, None, now)
        return action is not None

    def _asks(self, awaited: Awaited | None) -> bool:
        return not self.memory.silenced and (awaited is None or self._recovery.escalates)

    def _is_limited(self, now: int) -> bool:
        """Whether the limit of recomputations without a change is reached, or the node died that counts them."""
        return self._recovery.limits and self._frequency(MOST_UNCHANGED, now) != FEW

    def _frequency(self, most: int, now: int) -> int:
        latest = self.memory.hard[-most:]
        return self._functions.frequency(latest[0], now) if len(latest) == most else FEW

    def _choose(self, alarm: Alarm | None, spec: StateSpec, now: int, awaited: Awaited | None) -> Action | None:
        """Select the response to an alarm on a value of state `spec`; it is also in `action`, with its `alarm`."""
        after, uncured = self._after(awaited), False
        if alarm is not None:
            self.alarm = alarm  # even if it is refused: the process that decides on it may be another
            found = self._escalate(checked_alarm(self._detector, alarm), now, after)
            alarm, uncured = None if found == REFUSED else alarm, found == UNCURED
        action = None if alarm is None else self._select(alarm, spec, after, uncured=uncured)
        self.alarm, self.action = None if action is None else alarm, action
        return action

    def _respond_to(self, spec: StateSpec, rejected: State | None, now: int) -> None:
        """Record and execute the response to the alarm on a value; `rejected`: the value, None = it is unreadable."""
        assert self.alarm is not None and self.action is not None  # precondition
        if self._recovery.limits or (self.alarm.hard and self._recovery.restarts):
            skips = self._recovery.limits and self.action.kind == "abandon"
            self._count(now, *((MOST_UNCHANGED, SKIPPED_US) if skips else (1, 0)))
        self._loop.record.alarms.append(record_of(self.alarm, self.action, spec.name, now))
        self._execute(self.action, rejected, now)

    def _select(self, alarm: Alarm, spec: StateSpec, after: int, *, uncured: bool) -> Action | None:
        """The response to an alarm on a value; None = a faulty one that the policy does not contain."""
        action = decide(alarm, spec, self._recovery, after=after, uncured=uncured, respond=self._respond)
        may_restart = self.memory.restarts_left > 0 and self._recovery.escalates
        return None if action is not None and action.kind == "restart" and not may_restart else action

    def _after(self, awaited: Awaited | None) -> int:
        """What produced a value, as a code; any action other than a retransmission counts as a recomputation."""
        if awaited is None:
            return FIRST
        resent = self._loop.record.alarms[awaited.place].action == "resend"
        return RESENT if resent else RECOMPUTED

    def _escalate(self, alarm: Alarm, now: int, after: int) -> int:
        """Whether an alarm gets a response, as a code; it is part of the series of hard alarms."""
        memory, recovery, hard = self.memory, self._recovery, bool(alarm.hard)
        degrades = recovery.degraded != "none"
        if after == FIRST and not degrades:
            return CURABLE
        left, series = memory.restarts_left, (memory.first_us, memory.last_us, now)
        found: int = self._functions.escalate(after, hard, degrades, recovery.restarts, left, *series)
        if hard and degrades:  # after the decision: a start from a node that has died is no evidence
            memory.first_us, memory.last_us = self._functions.series_start(*series), now
        return found

    def _count(self, now: int, times: int, later: int) -> None:
        """Count an alarm against the detector; disable one with too many of them as faulty."""
        hard = self.memory.hard
        hard += [now + later] * times
        del hard[:-MOST_ALARMS]
        if self._recovery.limits and self._frequency(MOST_UNCHANGED, now) == MANY:
            self._loop.record.note(now, LIMITED, {"alarms": MOST_UNCHANGED})
        if self._frequency(MOST_ALARMS, now) == MANY:
            self._silence(now, SILENCED, {"alarms": MOST_ALARMS})

    def _silence(self, now: int, kind: str, data: dict[str, object]) -> None:
        """Ask the detector no more in this flight."""
        self.memory.silenced = True
        self._loop.record.note(now, kind, data)

    def _settle(self, awaited: Awaited, state: State | None) -> None:
        """Record the outcome of a recomputation, given the response to its result (None = an unreadable one)."""
        alarms = self._loop.record.alarms
        if alarms[awaited.place].action in ("recompute", "resend"):
            same = state is not None and awaited.rejected is not None and state.same_bits(awaited.rejected)
            passed = "accepted" if same else "repaired"
            outcome = passed if self.action is None and state is not None else "rejected"
            alarms[awaited.place] = replace(alarms[awaited.place], outcome=outcome)
            if outcome == "repaired" and self.memory.hard and self._recovery.confirms:
                self.memory.hard.pop()  # a repaired value confirms the alarm

    def _execute(self, action: Action, rejected: State | None, now: int) -> None:
        loop = self._loop
        if action.kind in MODES:
            assert self._setpoints is not None  # a mode is configured
            self._setpoints.begin(self.memory.trail)
            self.memory.degraded = True
            return
        if action.kind == "restart":
            left = self.memory.restarts_left
            self._restart(action.kernel, now, max(self._functions.down_time(left), 0))  # negative after a fault in it
            self.memory.restarts_left = self._functions.left_after(left)
            return
        if action.awaited:
            loop.awaited[action.awaited] = Awaited(rejected, len(loop.record.alarms) - 1)
        if action.kind == "resend":
            assert self._sent is not None  # `seal` precedes the check
            again = self._sent.copy()  # another object: a detector may know this one
            if action.withholds:
                loop.deliver(again, now)
            else:
                loop.at(now, "resend", again)  # consumers first receive the current value
            return
        if self._recovery.coupling == "observer":
            if action.kernel:
                loop.requests[action.kernel] = action
        elif action.kind == "recompute" and (action.withholds and STATES[action.awaited].writer in loop.busy):
            return  # an alarm on another of its states has already requested this recomputation
        elif not action.kernel or (not action.awaited and action.kernel in loop.busy):
            loop.charge(action)
        else:
            loop.recompute(action, now)

    def _keep_waiting(self, state: State, now: int) -> None:
        """Monitor the deadline of the path that answers a collision alarm; restart the planner's node on a miss."""
        recovery, answer = self._recovery, self._answer
        if answer is None or state.spec.name not in answer.states:
            return
        away = recovery.degraded != "none" and STATES[PATH].writer in self._loop.down
        waited = answer.overdue(self.memory.waiting, state, now, away=away)
        if waited is None:
            return
        policy = recovery.degraded != "none", recovery.restarts
        found = self._functions.escalate(RECOMPUTED, True, *policy, self.memory.restarts_left, now, now, now)
        if found == REFUSED:
            return
        alarm = Alarm("deadline", Stage.PLANNING, score=waited / recovery.answer_s, hard=True)
        uncured = found == UNCURED
        action = decide(alarm, STATES[PATH], recovery, after=RECOMPUTED, uncured=uncured, respond=self._respond)
        if action is not None and action.kind in ("restart", *MODES):  # else a faulty one: it is about a value
            self._loop.record.alarms.append(record_of(alarm, action, state.spec.name, now))
            self._execute(action, state, now)
