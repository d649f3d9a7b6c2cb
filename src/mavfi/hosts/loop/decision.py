"""Selection of the response to an alarm, by a compiled function."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from mavfi.detectors.detector import Alarm
from mavfi.flight_log import AlarmRecord
from mavfi.hosts.loop.policy import Recovery
from mavfi.hosts.loop.waiting import WAYPOINT
from mavfi.kernels.recovery import response as responses
from mavfi.states import KERNELS, STAGE_KERNELS, Stage, State, StateSpec

SCANNING = STAGE_KERNELS[Stage.PERCEPTION]
"""Kernels that are recomputed together, starting from the image."""


@dataclass(frozen=True, slots=True)
class Action:
    """Response to an alarm.

    Attributes:
        kind: "recompute"; a request to the setpoint generator: "abandon" the way-point in force, or "stop"; "restart"
            the node of `kernel`; "resend" the value from its producer's copy; or a degraded mode from now on.
        stage: The stage whose latency is charged.
        kernel: The kernel whose step is repeated; "" = none, only the latency is charged.
        restores: Kernels whose memory is restored first, in this order.
        awaited: The state whose next value is the result of the recomputation; "" = none.
        withholds: Whether the value that raised the alarm is withheld.
        alone: Whether only `kernel` is repeated, on its previous inputs and with its own latency.
    """

    kind: Literal["recompute", "abandon", "stop", "restart", "resend", "hover", "hold", "back"]
    stage: Stage
    kernel: str = ""
    restores: tuple[str, ...] = ()
    awaited: str = ""
    withholds: bool = False
    alone: bool = False


class Awaited(NamedTuple):
    """A recomputation in progress: the rejected value (None = unreadable), and the index of its alarm in the record."""

    rejected: State | None
    place: int


def decide(
    alarm: Alarm, spec: StateSpec, recovery: Recovery, *, after: int = responses.FIRST, uncured: bool = False,
    respond: Callable[..., int] = responses.respond,
) -> Action | None:  # fmt: skip
    """Select the response to an alarm on a value of state `spec`.

    Only a gate (coupling `inline`) withholds values.  None = no response, after a fault in `respond`.

    Args:
        alarm: The alarm, checked by `detector.checked_alarm`.
        spec: The state's specification.
        recovery: The recovery policy.
        after: What produced the value: a code of `kernels.recovery.response`.
        uncured: Whether the degraded mode applies: no restart is left or hard alarms persist, and a mode is configured.
        respond: `kernels.recovery.response.respond`, compiled or instrumented.
    """
    stage, gated, own = Stage(alarm.stage), recovery.coupling == "inline", Stage(alarm.stage) is spec.stage
    stop, abandon, resends = bool(alarm.stop), bool(alarm.abandon_waypoint), recovery.resends
    action: Action | None = None
    match respond(after, uncured, stop, abandon, own, resends):
        case responses.DEGRADE if recovery.degraded != "none":
            action = Action(recovery.degraded, Stage.CONTROL)
        case responses.RESTART if recovery.restarts and spec.writer in KERNELS:
            action = Action("restart", spec.stage, spec.writer, withholds=gated)
        case responses.STOP:
            action = Action("stop", Stage.CONTROL, "waypoint", (), WAYPOINT, gated and spec.name == WAYPOINT)
        case responses.ABANDON:
            action = Action("abandon", Stage.CONTROL, "waypoint", (), WAYPOINT, gated and spec.name == WAYPOINT)
        case responses.RESEND if resends:
            action = Action("resend", stage, "", (), spec.name, gated)
        case responses.RECOMPUTE if own:
            alone = recovery.grain != "stage"
            restores = SCANNING if spec.writer in SCANNING and not alone else (spec.writer,)
            action = Action("recompute", stage, restores[0], restores, spec.name, gated, alone)
        case responses.CHARGE:
            kernel = "pid" if stage is Stage.CONTROL else ""
            action = Action("recompute", stage, kernel, (kernel,) if kernel else ())
    return action


def record_of(alarm: Alarm, action: Action, state: str, time_us: int) -> AlarmRecord:
    """The record of an alarm, before its outcome is known."""
    outcome = "restarted" if action.kind == "restart" else "replaced" if action.awaited else "accepted"
    return AlarmRecord(
        1e-6 * time_us, alarm.source, state, alarm.stage, alarm.score, tuple(alarm.fields), action.kind, outcome
    )
