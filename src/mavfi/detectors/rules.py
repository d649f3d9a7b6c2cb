"""Rules of physics and protocol, compiled: each returns the field of a publication that violates it.

A rule returns the index of the field among the fields of the header and then of the element, or -1.  Comparisons are
written so that NaN violates them.  `limits` is the record of `MissionLimits.numbers`.
"""

import math

import numpy as np

from mavfi.detectors.gate import first_not_finite, too_fast
from mavfi.numerics.jit import kernel_jit
from mavfi.states import STATES

NO_COLLISION = 30.0
"""`time_to_collision` without a collision (s)."""
POINT_WIDTH = 11
"""Columns of a trajectory point, equal to those of a way-point."""
FINE = -1
"""No violation."""
EXACT = 1e-9
"""Rounding tolerance."""
_LARGEST_YAW = math.pi + 1e-6
"""Largest yaw of a trajectory point (rad)."""
_END = 0.5
"""Largest distance between the ends of a trajectory and its path (m)."""
_WAY_BACK = 6.0
"""Longest path back if no path to the goal is found (m)."""
_DETOUR = 8.0
_REVERSED = -0.5
"""Detour by way of one vertex (m) from which on the path must not turn back there, by cosine of the turn.

A planner that shortens its paths has no use for such a spike: in 8,162 error-free paths of both profiles (seeds 5000
to 5164, most in dense and factory) the largest detour with such a turn is 4.7 m, that with any turn 16.4 m.
"""
_LONGEST_DETOUR = 30.0
"""Longest detour by way of one vertex with any turn (m)."""
_SPLICE = 1e-3
"""Largest distance between the start of a path and the trajectory point that it continues (m)."""

_LARGEST_YAW_RATE = 1.5708
"""Largest commanded yaw rate, pi/2 rounded up (rad/s)."""
_LARGEST_HELD_YAW = 4.0
"""Largest yaw of a stationary vehicle, including its turns to look around (rad)."""
_WINDOW = 50
"""Number of leading points of a new trajectory among which an interpolated reference may start."""


def places(state: str, *fields: str) -> tuple[int, ...]:
    """Indices of fields among those of a state's header and then of its elements."""
    spec = STATES[state]
    names = [field.name for field in (*spec.header, *spec.elements)]
    return tuple(map(names.index, fields))


_TIME, _BLOCKED, _UNKNOWN, _COUNTER, _CHECKED, _FLAG = places(
    "perception.collision_status",
    "time_to_collision",
    "distance_to_blocked",
    "distance_to_unknown",
    "future_collision_seq",
    "trajectory_seq",
    "collision",
)
_ENTRY, _PATH_EPOCH, _JUNCTION, _VERTEX = places(
    "planning.path", "entry_speed", "future_collision_seq", "junction", "x"
)
_NUMBER, _EPOCH, _POINT = places("planning.trajectory", "trajectory_seq", "future_collision_seq", "x")
YAW, VELOCITY, ACCELERATION, DURATION = places("planning.waypoint", "yaw", "vx", "ax", "duration")
_FOLLOWED, _FOLLOWED_EPOCH, _INDEX = places("planning.waypoint", "trajectory_seq", "future_collision_seq", "index")
_YAW_RATE, _COMMAND_DURATION = places("control.command", "yaw_rate", "duration")
(_REMAINING,) = places("control.tracking", "remaining")


@kernel_jit
def status(header: np.ndarray, before: np.ndarray, trajectory: np.ndarray, limits: np.ndarray) -> int:
    """Collision status: the counter grows by 0 or 1, and the flag says whether it has grown.

    Repeated alarms carry the flag and the counter of the first, which exceeds the counter of the last trajectory (-).
    Time to collision (s) is that of no collision, or lies within the camera range.

    Args:
        header: Header of the status. Shape (1,).
        before: Header of the last published status. Shape (1,).
        trajectory: Header of the last published trajectory. Shape (1,).
        limits: See the module.
    """
    new = header[0]
    limit = limits[0]
    counter = int(new["future_collision_seq"])
    time = new["time_to_collision"]
    flag = bool(new["collision"])
    if not (0.0 <= time <= limit["longest_time"]):
        return _TIME
    growth = counter - int(before[0]["future_collision_seq"])
    if not 0 <= growth <= 1:
        return _COUNTER
    if flag != (growth == 1):
        again = limit["repeated"] and flag and counter > int(trajectory[0]["future_collision_seq"])
        if not again:
            return _FLAG
    if not flag and time != NO_COLLISION:
        return _TIME
    return known_space(header, int(trajectory[0]["trajectory_seq"])) if limit["every_map"] else FINE


@kernel_jit
def known_space(header: np.ndarray, newest: int) -> int:
    """Distances to blocked and to unknown space (m) along one of the two newest trajectories, or none.

    The collision flag is set if and only if space is blocked.
    """
    new = header[0]
    blocked = new["distance_to_blocked"]
    unknown = new["distance_to_unknown"]
    number = int(new["trajectory_seq"])
    if not blocked >= 0.0 or bool(new["collision"]) != (blocked < np.inf):
        return _BLOCKED
    if not unknown >= 0.0:
        return _UNKNOWN
    if number != -1 and not (1 <= number <= newest and number >= newest - 1):
        return _CHECKED
    return FINE


@kernel_jit
def far_from(point: np.ndarray, other: np.ndarray, most: float) -> int:
    """Axis along which the distance of two points exceeds `most` (m), or -1. Points have shape (3,)."""
    for axis in range(3):
        if not abs(point[axis] - other[axis]) <= most:
            return axis
    return FINE


@kernel_jit
def outside(point: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> int:
    """Axis along which a point lies outside a box (m), or -1. Shapes (3,)."""
    for axis in range(3):
        if not (lower[axis] <= point[axis] <= upper[axis]):
            return axis
    return FINE


@kernel_jit
def path(
    header: np.ndarray,
    vertices: np.ndarray,
    epochs: np.ndarray,
    vehicle: np.ndarray,
    flown: np.ndarray,
    limits: np.ndarray,
) -> int:
    """Path: it answers a counter (-) that the planner can have read, and leads from the vehicle to the goal.

    Vertices (m) lie in the flight box, without a spike; the entry speed (m/s) is 0 or close to that of the vehicle.

    Args:
        header: Header of the path. Shape (1,).
        vertices: Shape (n, 3).
        epochs: Counters that it can answer. Shape (m,).
        vehicle: Position (m) and velocity (m/s). Shape (6,).
        flown: Points of the last published trajectory that has any. Shape (k, 11).
        limits: See the module.
    """
    if not _contains(epochs, int(header[0]["future_collision_seq"])):
        return _PATH_EPOCH
    entry = header[0]["entry_speed"]
    limit = limits[0]
    speed = math.sqrt(vehicle[3] ** 2 + vehicle[4] ** 2 + vehicle[5] ** 2)
    if not (0.0 <= entry <= limit["speed"]) or (entry > 0.0 and not abs(entry - speed) <= limit["entry"]):
        return _ENTRY
    if len(vertices) == 0:
        return FINE
    for index in range(len(vertices)):
        axis = outside(vertices[index], limit["lower"], limit["upper"])
        if axis >= 0:
            return _VERTEX + axis
    field = _start(vertices[0], header, vehicle, flown, limits)
    if field < 0:
        field = _end(vertices, header, limits)
    return field if field >= 0 else spike(vertices)


@kernel_jit
def spike(vertices: np.ndarray) -> int:
    """Column of the first vertex of a path at which it makes a long detour and turns back, or -1.

    Args:
        vertices: Shape (n, 3) (m).
    """
    for index in range(1, len(vertices) - 1):
        there = back = across = product = 0.0
        for axis in range(3):
            to = vertices[index, axis] - vertices[index - 1, axis]
            onwards = vertices[index + 1, axis] - vertices[index, axis]
            there += to**2
            back += onwards**2
            across += (to + onwards) ** 2
            product += to * onwards
        reach = math.sqrt(there) * math.sqrt(back)
        detour = math.sqrt(there) + math.sqrt(back) - math.sqrt(across)
        if not (detour <= _LONGEST_DETOUR and (detour <= _DETOUR or product >= _REVERSED * reach)):
            return _VERTEX + _farthest(vertices[index - 1], vertices[index], vertices[index + 1])
    return FINE


@kernel_jit
def _farthest(before: np.ndarray, vertex: np.ndarray, after: np.ndarray) -> int:
    """Axis along which a vertex is farthest from the middle of its neighbours. Shapes (3,)."""
    farthest = 0
    largest = -1.0
    for axis in range(3):
        distance = abs(vertex[axis] - 0.5 * (before[axis] + after[axis]))
        if distance > largest:
            farthest = axis
            largest = distance
    return farthest


@kernel_jit
def _contains(epochs: np.ndarray, epoch: int) -> bool:
    for index in range(len(epochs)):
        if epochs[index] == epoch:
            return True
    return False


@kernel_jit
def _spliced(header: np.ndarray, limits: np.ndarray) -> bool:
    """Whether a path continues the trajectory in force from one of its points."""
    return bool(limits[0]["every_map"]) and int(header[0]["junction"]) != -1


@kernel_jit
def _start(first: np.ndarray, header: np.ndarray, vehicle: np.ndarray, flown: np.ndarray, limits: np.ndarray) -> int:
    """A path starts at its junction with the trajectory in force, or near the vehicle (m). `first` has shape (3,)."""
    if not _spliced(header, limits):
        axis = far_from(first, vehicle[:3], limits[0]["near"])
        return FINE if axis < 0 else _VERTEX + axis
    junction = int(header[0]["junction"])
    nearest = _junction(first, flown, junction)
    if nearest == junction:
        return FINE
    # The vertex fits another point, or there is no such point: the index is wrong.  Otherwise the vertex is.
    if nearest >= 0 or not 0 <= junction < len(flown):
        return _JUNCTION
    return _VERTEX + far_from(first, flown[junction, :3], _SPLICE)


@kernel_jit
def _end(vertices: np.ndarray, header: np.ndarray, limits: np.ndarray) -> int:
    """A path ends near the goal (m); a path back ends near its start. `vertices` have shape (n, 3)."""
    last = vertices[len(vertices) - 1]
    limit = limits[0]
    axis = far_from(last, limit["goal"], limit["near"])
    if axis >= 0 and limit["every_map"] and not _spliced(header, limits) and header[0]["entry_speed"] == 0.0:
        axis = far_from(last, vertices[0], _WAY_BACK)
    return FINE if axis < 0 else _VERTEX + axis


@kernel_jit
def _junction(start: np.ndarray, flown: np.ndarray, junction: int) -> int:
    """Index of the point of a trajectory, shape (n, 11), at which a path starts (m), `junction` if that fits; or -1."""
    if 0 <= junction < len(flown) and far_from(start, flown[junction, :3], _SPLICE) < 0:
        return junction
    for index in range(len(flown)):
        if far_from(start, flown[index, :3], _SPLICE) < 0:
            return index
    return FINE


@kernel_jit
def trajectory(
    header: np.ndarray,
    points: np.ndarray,
    before: np.ndarray,
    path_header: np.ndarray,
    end: np.ndarray,
    vehicle: np.ndarray,
    limits: np.ndarray,
) -> int:
    """Trajectory: its number is the next, its counter (-) is the path's; it leads from the vehicle to the path's end.

    Args:
        header: Header of the trajectory. Shape (1,).
        points: Shape (n, 11).
        before: Header of the last published trajectory. Shape (1,).
        path_header: Header of the last published path. Shape (1,).
        end: Last vertex of that path (m). Shape (3,), or (0,) if it has none.
        vehicle: Position (m) and velocity (m/s). Shape (6,).
        limits: See the module.
    """
    count = len(points)
    if int(header[0]["trajectory_seq"]) != int(before[0]["trajectory_seq"]) + 1:
        return _NUMBER
    if int(header[0]["future_collision_seq"]) != int(path_header[0]["future_collision_seq"]):
        return _EPOCH
    # each point for itself, and as the continuation of the one before
    for index in range(count):
        column = point(points[index], index >= count - 2, limits)
        if column < 0 and index > 0:
            column = step(points[index], points[index - 1], index == count - 1, limits)
        if column >= 0:
            return _POINT + column
    # from the vehicle to the end of the path
    if count > 0:
        axis = far_from(points[0, :3], vehicle[:3], limits[0]["near"])
        if axis < 0 and len(end) == 3:
            axis = far_from(points[count - 1, :3], end, _END)
        if axis >= 0:
            return _POINT + axis
    return FINE


@kernel_jit
def point(values: np.ndarray, last: bool, limits: np.ndarray) -> int:
    """Column of an implausible value of a point, or -1.

    It lies in the flight box (m), and its speed (m/s), yaw (rad), acceleration (m/s^2) and duration (s) are possible.

    Args:
        values: The point. Shape (11,).
        last: Whether it is one of the last two, whose duration may be shorter.
        limits: See the module.
    """
    limit = limits[0]
    column = first_not_finite(values)
    if column >= 0:
        return column
    column = outside(values[:3], limit["lower"], limit["upper"])
    if column >= 0:
        return column
    if not abs(values[YAW]) <= _LARGEST_YAW:
        return YAW
    column = too_fast(values[VELOCITY : VELOCITY + 3], limit["speed"])
    if column >= 0:
        return VELOCITY + column
    for axis in range(3):
        # held points are tracked without acceleration: any finite value is accepted
        if not (limit["held"] or abs(values[ACCELERATION + axis]) <= limit["acceleration"]):
            return ACCELERATION + axis
    duration = values[DURATION]
    period = limit["point_period"]
    is_whole = abs(duration - period) <= EXACT
    return FINE if is_whole or (last and 0.0 < duration <= period) else DURATION


@kernel_jit
def step(values: np.ndarray, before: np.ndarray, last: bool, limits: np.ndarray) -> int:
    """Column in which a point does not continue the previous one, or -1.

    The position (m) follows from velocity and duration; velocities (m/s) change within the acceleration limit.

    Args:
        values: The point. Shape (11,).
        before: The previous point. Shape (11,).
        last: Whether it is the end of the trajectory, at rest.
        limits: See the module.
    """
    limit = limits[0]
    for axis in range(3):
        moved = values[axis] - before[axis]
        speed = values[VELOCITY + axis]
        if not last and not abs(speed - before[VELOCITY + axis]) <= limit["change"]:
            return VELOCITY + axis
        if not abs(moved - speed * values[DURATION]) <= limit["step"]:
            return axis
    return FINE


@kernel_jit
def waypoint(
    values: np.ndarray,
    header: np.ndarray,
    before: np.ndarray,
    newest: np.ndarray,
    points: np.ndarray,
    vehicle: np.ndarray,
    limits: np.ndarray,
) -> int:
    """Way-point: the next point of a published trajectory, or a hold where the vehicle comes to rest (m).

    Args:
        values: Position, yaw, velocity, acceleration, duration. Shape (11,).
        header: Header of the way-point. Shape (1,).
        before: Header of the last published way-point. Shape (1,).
        newest: Header of the last published trajectory. Shape (1,).
        points: Points of the trajectory that it names. Shape (n, 11), or (0, 11) if that number is unknown.
        vehicle: Position (m) and velocity (m/s). Shape (6,).
        limits: See `rules`.
    """
    new = header[0]
    old = before[0]
    limit = limits[0]
    number = int(new["trajectory_seq"])
    index = int(new["index"])
    epoch = int(new["future_collision_seq"])
    earlier = int(old["future_collision_seq"])
    # The counter does not fall, and does not exceed that of the newest trajectory.
    if not limit["every_map"] and not (earlier <= epoch <= max(earlier, int(newest[0]["future_collision_seq"]))):
        return _FOLLOWED_EPOCH
    # No point of a trajectory: a hold, or the trajectory's number or the index is wrong.
    if index < 0 or len(points) == 0:
        if index == -1:
            return hold(values, vehicle, limits) if number == 0 else _FOLLOWED
        return _FOLLOWED if len(points) == 0 and number != 0 else _INDEX
    # The next point of the trajectory in force, or one of the first of a new trajectory.
    same = number == int(old["trajectory_seq"]) and int(old["index"]) >= 0
    least = int(old["index"]) if same else 0
    most = least + 1 if same else _WINDOW - 1
    if limit["held"]:
        least = most = least + 1 if same else 0
    if not least <= index <= min(most, len(points) - 1):
        return _INDEX
    if limit["held"]:
        return copied(values, points[index])
    return between(values, points[index], points[min(index + 1, len(points) - 1)], limits)


@kernel_jit
def hold(values: np.ndarray, vehicle: np.ndarray, limits: np.ndarray) -> int:
    """Column in which a hold is not at rest (m/s, m/s^2) at the stopping point (m), or -1. Shapes (11,), (6,)."""
    limit = limits[0]
    for axis in range(3):
        if not abs(values[axis] - vehicle[axis] - limit["lag"] * vehicle[3 + axis]) <= limit["hold"]:
            return axis
    if not abs(values[YAW]) <= _LARGEST_HELD_YAW:
        return YAW
    for column in range(VELOCITY, DURATION):
        if values[column] != 0.0:
            return column
    return FINE if values[DURATION] == limit["point_period"] else DURATION


@kernel_jit
def copied(values: np.ndarray, other: np.ndarray) -> int:
    """First column that differs, or -1. Shapes (11,)."""
    for column in range(len(other)):
        if values[column] != other[column]:
            return column
    return FINE


@kernel_jit
def between(values: np.ndarray, start: np.ndarray, end: np.ndarray, limits: np.ndarray) -> int:
    """Column in which an interpolated way-point does not lie between two points, or -1.

    The reference clock may be slowed.  Yaw and duration are those of the first point; changes of the clock rate add
    acceleration (m/s^2). Shapes (11,).
    """
    for axis in range(3):
        low = min(start[axis], end[axis])
        high = max(start[axis], end[axis])
        if not (low - EXACT <= values[axis] <= high + EXACT):
            return axis
        column = VELOCITY + axis
        low = min(start[column], end[column])
        high = max(start[column], end[column])
        if not (min(low, 0.0) - EXACT <= values[column] <= max(high, 0.0) + EXACT):
            return column
        column = ACCELERATION + axis
        if not abs(values[column]) <= abs(start[column]) + limits[0]["clock"]:
            return column
    if values[YAW] != start[YAW]:
        return YAW
    return FINE if values[DURATION] == start[DURATION] else DURATION


@kernel_jit
def command(header: np.ndarray, before: np.ndarray, switched: bool, limits: np.ndarray) -> int:
    """Command: velocity (m/s) and yaw rate (rad/s) within their limits, for one control period (s).

    While a held way-point stays in force, the velocity changes little.

    Args:
        header: Header of the command; extracting a plain vector would cost as much as the rule. Shape (1,).
        before: Header of the last published command. Shape (1,).
        switched: Whether a way-point has been published since.
        limits: See `rules`.
    """
    new = header[0]
    old = before[0]
    limit = limits[0]
    x, y, z = new["vx"], new["vy"], new["vz"]
    if not x * x + y * y + z * z <= limit["command"] ** 2:
        return _largest(x, y, z)
    if not abs(new["yaw_rate"]) <= _LARGEST_YAW_RATE:
        return _YAW_RATE
    if new["duration"] != limit["control_period"]:
        return _COMMAND_DURATION
    x, y, z = x - old["vx"], y - old["vy"], z - old["vz"]
    if limit["held"] and not switched and not max(abs(x), abs(y), abs(z)) <= limit["command_step"]:
        return _largest(x, y, z)
    return FINE


@kernel_jit
def _largest(x: float, y: float, z: float) -> int:
    """Axis of the first NaN among three numbers, else of the largest magnitude."""
    values = (x, y, z)
    largest = 0
    for axis in range(3):
        if math.isnan(values[axis]):
            return axis
        if abs(values[axis]) > abs(values[largest]):
            largest = axis
    return largest


@kernel_jit
def tracking(header: np.ndarray, before: np.ndarray, duration: float, limits: np.ndarray) -> int:
    """Remaining time of the way-point in force (s): falls by at most a period, or starts from the duration.

    Args:
        header: Header of the report. Shape (1,).
        before: Header of the last published report. Shape (1,).
        duration: Duration of a way-point published since the last report (s); 0 = none.
        limits: See `rules`.
    """
    limit = limits[0]
    remaining = header[0]["remaining"]
    most = before[0]["remaining"]
    least = most - limit["fastest"]
    if remaining == most:
        return FINE  # recomputed for the command of the same step, or no way-point yet
    if duration != 0.0:  # the overrun of the last point, at most one period, is subtracted
        most = duration
        least = most - limit["control_period"] - limit["fastest"]
    return FINE if least - EXACT <= remaining <= most - limit["slowest"] + EXACT else _REMAINING
