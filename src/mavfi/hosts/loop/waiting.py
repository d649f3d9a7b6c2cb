"""Deadline of the path that answers a collision alarm.

The wait begins with an alarm, and ends with a path that carries the alarm's sequence number or a later one.  If
every scan re-evaluates the trajectory, an accepted status that withdraws the alarm ends the wait as well: the
trajectory is free, and the planner need not answer.  A lost flag is no withdrawal: the times and distances of such a
status still tell of a collision.  Neither is the status of a vehicle without a trajectory, which the check cannot
judge: there the planner is needed.
"""

import math
from dataclasses import dataclass

from mavfi.config import AutopilotConfig
from mavfi.detectors.rules import NO_COLLISION
from mavfi.pipeline.memory import Memory
from mavfi.states import State

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
    """

    states = frozenset((COLLISION, PATH, WAYPOINT))

    def __init__(self, limit_s: float, *, repeated: bool = False) -> None:
        self._limit_us, self._repeated = 1e6 * limit_s, repeated

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
        number = int(state.header["future_collision_seq"][0])
        if state.spec.name == PATH:
            if memory.since is not None and number >= memory.asked:
                memory.since = None
            return None
        raised = bool(state.header["collision"][0])
        if raised:
            memory.raised = number
        if memory.since is None:
            if raised:
                memory.since, memory.asked = now, number
        elif self._withdrawn(memory, state, number):
            memory.since = None
        elif away:
            memory.since = now
        elif now - memory.since > self._limit_us:
            waited, memory.since = now - memory.since, None
            return 1e-6 * waited
        return None

    def _withdrawn(self, memory: Waiting, status: State, number: int) -> bool:
        """Whether a status says that the trajectory in force is free, under the number of the last alarm."""
        header, waypoint = status.header[0], memory.waypoint
        return (
            self._repeated
            and not header["collision"]
            and number == memory.raised
            and header["time_to_collision"] == NO_COLLISION
            and header["distance_to_blocked"] == math.inf
            and waypoint is not None
            and int(waypoint.header["index"][0]) >= 0
        )
