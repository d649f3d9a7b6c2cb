"""What an alarm leads to: `decide`, pure and the only place where that is decided; `Watch` applies it to a detector.

Coupling `inline`: the detector is a gate.  The value is held back, the kernel goes back to the memory that it had, and
is stepped again at once; the result is published, and accepted even if it is the same value.

Coupling `observer`: the detector is a subscriber, as the paper's node.  Consumers have seen the value when the alarm
comes, so the kernel goes back at its next step: at the next control period for planning and control, at the next image
for perception, at the next IMU sample for the state estimator.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple
from weakref import proxy

from mavfi.detectors.detector import Alarm, Detector
from mavfi.errors import BadInputError
from mavfi.flight_log import AlarmRecord
from mavfi.states import STAGE_KERNELS, Stage, State, StateSpec

if TYPE_CHECKING:
    from mavfi.hosts.loop.scheduler import Loop

Coupling = Literal["inline", "observer"]
SCANNING = STAGE_KERNELS[Stage.PERCEPTION]
"""Kernels that compute again together, from the image on."""
WAYPOINT = "planning.waypoint"


@dataclass(frozen=True, slots=True)
class Action:
    """Response to an alarm.

    Attributes:
        kind: "recompute", or a request to the setpoint generator: "abandon" the way-point in force, or "stop".
        stage: Whose latency is charged.
        kernel: The kernel that is stepped again; "" = none, the latency alone is charged.
        restores: Kernels whose memory is put back before, in this order.
        awaited: The state whose next value comes from the recomputation, and passes; "" = none.
        withholds: Whether the value that raised the alarm is held back.
    """

    kind: Literal["recompute", "abandon", "stop"]
    stage: Stage
    kernel: str = ""
    restores: tuple[str, ...] = ()
    awaited: str = ""
    withholds: bool = False


class Awaited(NamedTuple):
    """A recomputation under way: the rejected value, and the place of its alarm in the record."""

    rejected: State
    place: int


def decide(alarm: Alarm, spec: StateSpec, coupling: Coupling) -> Action:
    """The response to an alarm about a value of state `spec`; only a gate (`coupling`) holds values back.

    Raises:
        BadInputError: The alarm names a stage that cannot be run again.
    """
    if alarm.stage not in STAGE_KERNELS:
        text = f"stage {alarm.stage!r}: cannot be run again; allowed: {', '.join(STAGE_KERNELS)}"
        raise BadInputError(f"detector {alarm.source!r}: {text}")
    stage, gated = Stage(alarm.stage), coupling == "inline"
    if alarm.stop or alarm.abandon_waypoint:
        kind: Literal["abandon", "stop"] = "stop" if alarm.stop else "abandon"
        return Action(kind, Stage.CONTROL, "waypoint", (), WAYPOINT, gated and spec.name == WAYPOINT)
    if stage is spec.stage:
        if spec.writer in SCANNING:
            return Action("recompute", stage, SCANNING[0], SCANNING, spec.name, gated)
        return Action("recompute", stage, spec.writer, (spec.writer,), spec.name, gated)
    # another stage than the writer's is to run again: this value passes
    return Action("recompute", stage, "pid", ("pid",)) if stage is Stage.CONTROL else Action("recompute", stage)


def record_of(alarm: Alarm, action: Action, state: str, time_us: int) -> AlarmRecord:
    """The record of an alarm, before its outcome is known."""
    outcome = "replaced" if action.awaited else "accepted"
    return AlarmRecord(
        1e-6 * time_us, alarm.source, state, alarm.stage, alarm.score, tuple(alarm.fields), action.kind, outcome
    )


class Watch:
    """A detector as a tap of a loop, which answers its alarms; it has no memory of its own."""

    def __init__(self, loop: "Loop", detector: Detector, coupling: Coupling) -> None:
        self._loop = proxy(loop)  # which owns this: maps of a flight that is over are freed at once
        self._detector, self._coupling = detector, coupling

    def __call__(self, state: State, now: int) -> State | None:
        """Show a value to the detector; the result of a recomputation passes."""
        loop, detector = self._loop, self._detector
        awaited = loop.awaited.pop(state.spec.name, None)
        alarm = detector.check(state, now) if awaited is None else None
        if alarm is None or self._coupling == "observer":
            detector.accept(state, now)
        if awaited is not None:
            self._settle(awaited, state)
        if alarm is None:
            return state
        action = decide(alarm, state.spec, self._coupling)
        loop.record.alarms.append(record_of(alarm, action, state.spec.name, now))
        self._answer(action, state, now)
        return None if action.withholds else state

    def _settle(self, awaited: Awaited, state: State) -> None:
        """Note the outcome of a recomputation."""
        alarms = self._loop.record.alarms
        if alarms[awaited.place].action == "recompute":
            outcome = "accepted" if state.same_bits(awaited.rejected) else "repaired"
            alarms[awaited.place] = replace(alarms[awaited.place], outcome=outcome)

    def _answer(self, action: Action, state: State, now: int) -> None:
        loop = self._loop
        if action.awaited:
            loop.awaited[action.awaited] = Awaited(state, len(loop.record.alarms) - 1)
        if self._coupling == "observer":
            if action.kernel:
                loop.requests[action.kernel] = action
        elif action.kind == "recompute" and (action.withholds and state.spec.writer in loop.busy):
            return  # an alarm at another of its states has made it run again
        elif not action.kernel or (not action.awaited and action.kernel in loop.busy):
            loop.charge(action)
        else:
            loop.recompute(action, now)
