"""The five rules of docs/concepts/engineers.md in plain Python, for the consumers of any stack; mavfi is not needed.

A rule returns what is wrong with a message, or "".  Comparisons are written so that NaN is wrong.  Limits are those of
your vehicle and your planner: take them from error-free flights, with a margin.
"""

import math
import struct
from collections.abc import Sequence

Point = tuple[float, float, float]


def wrong_alarm(counter: int, flag: bool, last_counter: int, answered: int) -> str:
    """Rule 1, in each consumer of the collision check: a counter grows by one or stays, and a flag agrees with it.

    Args:
        counter: Number of obstacles reported so far (-).
        flag: Whether there is an obstacle ahead.
        last_counter: The counter of the last accepted message (-).
        answered: The counter that the newest trajectory answers (-).
    """
    growth = counter - last_counter
    if growth not in (0, 1):
        return "counter"
    repeated = flag and counter > answered
    return "" if flag == (growth == 1) or repeated else "flag"


class Numbering:
    """Rule 2, in each consumer of answers (paths, trajectories): an answer names its question.

    Attributes:
        last: Number of the last accepted answer (-).
        patience_s: Time of rejections after which a new numbering is accepted: the own `last` may be corrupted (s).
    """

    def __init__(self, last: int = 0, patience_s: float = 1.0) -> None:
        self.last = last
        self.patience_s = patience_s
        self._rejected_since: float | None = None

    def wrong_answer(self, number: int, newest: int, now_s: float) -> str:
        """Check a number: from the last one accepted to the newest question (-)."""
        if self.last <= number <= newest:
            self.last, self._rejected_since = number, None
            return ""
        if self._rejected_since is None:
            self._rejected_since = now_s
        if number <= newest and now_s - self._rejected_since >= self.patience_s:
            self.last, self._rejected_since = number, None
            return ""
        return "number"


def wrong_path(  # noqa: PLR0913 - each limit has its own name
    path: Sequence[Point], lower: Point, upper: Point, vehicle: Point, goal: Point, near: float, detour: float
) -> str:
    """Rule 3, in the consumer of a path: it lies in the flight volume, leads from vehicle to goal, and has no spike.

    Args:
        path: Vertices (m); () = the planner has found none, which violates nothing.
        lower: Corner of the flight volume (m).
        upper: Opposite corner (m).
        vehicle: Position of the vehicle (m).
        goal: Position of the goal (m).
        near: Largest distance from the vehicle to the first vertex, and from the last one to the goal (m).
        detour: Longest detour by way of one vertex at which the path turns back (m).
    """
    for point in path:
        if not all(low <= value <= high for low, value, high in zip(lower, point, upper, strict=True)):
            return "outside the flight volume"
    if path and not math.dist(path[0], vehicle) <= near:
        return "does not begin at the vehicle"
    if path and not math.dist(path[-1], goal) <= near:
        return "does not end at the goal"
    for before, point, after in zip(path, path[1:], path[2:], strict=False):
        there, back = math.dist(before, point), math.dist(point, after)
        turn = sum((b - a) * (c - b) for a, b, c in zip(before, point, after, strict=True))
        if there + back - math.dist(before, after) > detour and turn < -0.5 * there * back:
            return "spike"
    return ""


def wrong_step(  # noqa: PLR0913 - each limit has its own name
    point: Point,
    velocity: Point,
    before: Point,
    velocity_before: Point,
    duration: float,
    speed: float,
    change: float,
    slip: float,
) -> str:
    """Rule 3, in the consumer of a trajectory: each point follows from the one before it.

    Args:
        point: Position (m).
        velocity: Velocity on the way to it (m/s).
        before: Position of the point before (m).
        velocity_before: Its velocity (m/s).
        duration: Time between them (s).
        speed: Largest speed along an axis (m/s).
        change: Largest change of a velocity component between two points, acceleration x duration (m/s).
        slip: Largest distance along an axis between the position and where the velocity leads (m).
    """
    for axis in range(3):
        if not abs(velocity[axis]) <= speed:
            return "too fast"
        if not abs(velocity[axis] - velocity_before[axis]) <= change:
            return "velocity changes too fast"
        if not abs(point[axis] - before[axis] - velocity[axis] * duration) <= slip:
            return "not where its velocity leads"
    return ""


def wrong_copy(values: Sequence[float], source: Sequence[float]) -> str:
    """Rule 4, in the consumer of a set-point: it is, bit for bit, the point of its trajectory.

    If the sender interpolates between points, `source` is the same interpolation, computed again by the consumer.
    """
    form = f"<{len(source)}d"
    return "" if len(values) == len(source) and struct.pack(form, *values) == struct.pack(form, *source) else "copy"


class RepeatedAlarm:
    """Rule 5, first half, in the collision check: an alarm is sent until it is answered."""

    def __init__(self) -> None:
        self.counter = 0

    def message(self, obstacle: bool, answered: int) -> tuple[int, bool]:
        """Counter and flag to send (-).

        Args:
            obstacle: Whether the newest scan shows an obstacle on the trajectory.
            answered: The counter that the newest trajectory answers (-).
        """
        if obstacle and self.counter <= answered:
            self.counter += 1
            return self.counter, True
        return self.counter, self.counter > answered


def numbering_of_a_restarted_node(last_output: int | None) -> Numbering:
    """Rule 5, second half, in a node that starts: continue the numbers of its last output, which its consumers keep.

    Args:
        last_output: Number of the last message received from this node, as its consumers say (-); None = there is none.
    """
    return Numbering(0 if last_output is None else last_output)


def response(violations: int) -> str:
    """Response to successive violations by messages of one sender: withhold the message, and let this happen.

    Args:
        violations: Number of its messages in a row that violate a rule, at least 1.
    """
    return "send it again" if violations == 1 else "compute it again" if violations == 2 else "restart the node"


if __name__ == "__main__":
    path = [(0.0, 0.0, 2.0), (1e150, 0.0, 2.0)]
    print("a flag that was lost:", wrong_alarm(counter=3, flag=False, last_counter=2, answered=2))
    print(
        "a flipped exponent:", wrong_path(path, (-5, -5, 0), (50, 50, 9), (0, 0, 2), (40, 40, 2), near=2.0, detour=8.0)
    )
