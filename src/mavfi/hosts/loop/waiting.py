"""Deadline of the path that answers a collision alarm.

The wait begins with an alarm, and ends with a path that carries the alarm's sequence number or a later one.  If
every scan re-evaluates the trajectory, an accepted status that withdraws the alarm ends the wait as well: the
trajectory is free, and the planner need not answer.  A lost flag is no withdrawal: the times and distances of such a
status still tell of a collision.  Neither is the status of a vehicle without a trajectory, which the check cannot
judge: there the planner is needed.
"""

from dataclasses import dataclass

from mavfi.config import AutopilotConfig
from mavfi.kernels.recovery.response import BEGIN, END, NOT_WAITING, OVERDUE, POSTPONE
from mavfi.numerics.jit import entry
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.pipeline.memory import Memory
from mavfi.states import State

NO_INDEX = -1
COLLISION, PATH, WAYPOINT = "perception.collision_status", "planning.path", "planning.waypoint"


def repeats(autopilot: AutopilotConfig) -> bool:
    """Whether every scan re-evaluates the trajectory, so that an alarm can be withdrawn."""
    return autopilot.alarm == "repeated" or autopilot.replanning == "every_map"


@dataclass(slots=True)
class Waiting(Memory):
    """What a wait remembers.

    Attributes:
        since: Instant of the unanswered alarm (us); None = none.
        asked: Sequence number of the unanswered alarm.
        raised: Sequence number of the last alarm since.
        waypoint: The way-point in force.
    """

    since: int | None = None
    asked: int = 0
    raised: int = 0
    waypoint: State | None = None


class Answer:
    """The wait for the path that answers a collision alarm.

    Args:
        limit_s: Deadline (s).
        repeated: Whether every scan re-evaluates the trajectory (`repeats`).
        functions: Functions that it calls: compiled or instrumented.
    """

    states = frozenset((COLLISION, PATH, WAYPOINT))

    def __init__(self, limit_s: float, *, repeated: bool = False, functions: KernelFunctions = PLAIN) -> None:
        self._limit_us, self._repeated = 1e6 * limit_s, repeated
        self._judge = entry(
            functions.wait_for_path, False, False, False, 0.0, 0.0, NO_INDEX, False, NOT_WAITING, 0, self._limit_us
        )

    def overdue(self, memory: Waiting, state: State, now: int, *, away: bool = False) -> float | None:
        """Take note of an accepted publication; returns the duration of a wait beyond the deadline (s), and ends it.

        Args:
            memory: What it remembers; updated.
            state: Collision status, path or way-point.
            now: Instant of the publication (us).
            away: Whether the planner is restarting; the deadline restarts when it is back.
        """
        if state.spec.name == WAYPOINT:
            memory.waypoint = state
            return None
        header, path, waiting = state.header[0], state.spec.name == PATH, memory.since is not None
        number = int(header["future_collision_seq"])
        if path and not (waiting and number >= memory.asked):
            return None
        raised, time, distance = False, 0.0, 0.0
        if not path:
            raised = bool(header["collision"])
            time, distance = float(header["time_to_collision"]), float(header["distance_to_blocked"])
        if raised:
            memory.raised = number
        index = NO_INDEX if memory.waypoint is None else int(memory.waypoint.header["index"][0])
        same = self._repeated and not path and not raised and number == memory.raised
        since = NOT_WAITING if memory.since is None else memory.since
        becomes = self._judge(path, raised, same, time, distance, index, away, since, now, self._limit_us)
        if becomes == BEGIN:
            memory.since, memory.asked = now, number
        elif becomes in (END, OVERDUE):
            memory.since = None
        elif becomes == POSTPONE:
            memory.since = now
        return 1e-6 * (now - since) if becomes == OVERDUE and waiting else None
