"""Residuals of every small state: deviation of a publication from the prediction by earlier publications.

They cover each consumed field, and for paths and trajectories the largest deviations over their elements.  They depend
on publications only, not on limits of the mission.  Clouds and map updates have none, see `acceptance`.

The function of a state computes its residuals (SI units; NaN or infinity propagates) and, with `keep`, stores the
publication as the reference for the next one; it returns the regime of the state.  Arguments: `header`, shape (1,);
`elements`, shape (n, fields), float64; `known`, memory of earlier publications, shape (SIZE,), zeros at first;
`values`, output, shape (residuals of the state,); `keep`.

The shape of statements decides the compiled instructions, in which faults are drawn: conditional expressions stay.
"""

import math

import numpy as np

from mavfi.numerics.bits import INT16_MAX
from mavfi.numerics.elementary import atan2, cos, log, sin
from mavfi.numerics.jit import kernel_jit

PLAIN, SWITCH, NEW_TRAJECTORY = range(3)
"""Regimes, as in `features`: since the last publication of the state, or with this one, no other way-point came into
force, another one, or the first one of a trajectory."""
SLOTS = 6
"""Number of states."""
_STATUS, _PATH, _TRAJECTORY, _WAYPOINT, _COMMAND, _TRACKING = range(SLOTS)

(
    _COUNTER,
    _TIME,
    _BLOCKED,
    _UNKNOWN,
    _STATUS_SEEN,
    _EPOCH,
    _HAS_END,
    _HAS_GOAL,
    _NUMBER,
    _OF_TRAJECTORY,
    _INDEX,
    _ANSWERS,
    _WAYPOINT_SEEN,
    _COMMAND_SEEN,
    _REMAINING,
    _FRESH,
    _VEHICLE_KNOWN,
) = range(17)
"""Indices of single numbers in `known`: those of the last publications, and whether there was one."""
_END = 17
_GOAL = 20
_VEHICLE = 23
_POINT = 29
_LAW = 40
_REGIME = 45
"""Start of lists in `known`: end of the path, end of the last path that has one (m), vehicle (m, m/s), way-point,
command, and by state the largest regime since its last publication."""
SIZE = _REGIME + SLOTS
_YAW = 3
_VELOCITY = 4
_ACCELERATION = 7
_DURATION = 10
"""First columns of a point of a trajectory: after x y z."""
_LARGEST_WRAPPED = 20.0
"""Largest angle that is wrapped (rad): a larger one is corrupted, and must stay visible."""
_NEAREST = 0.25
_FARTHEST = 64.0
"""Bounds of `octaves` (m, or s): changes beyond them mean nothing."""
_NEGATIVE = 20.0
"""Octaves by which negative values are set apart."""
_LOG_2 = 0.6931471805599453


@kernel_jit
def octaves(value: float) -> float:
    """Base-2 logarithm of a time (s) or distance (m) clamped to 1/4 to 64; negatives map far below; NaN propagates."""
    if math.isnan(value):
        return value
    size = log(min(max(abs(value), _NEAREST), _FARTHEST)) / _LOG_2
    return -_NEGATIVE - size if value < 0.0 else size


@kernel_jit
def wrapped(angle: float) -> float:
    """An angle wrapped to ±pi (rad); large ones unchanged."""
    return atan2(sin(angle), cos(angle)) if abs(angle) < _LARGEST_WRAPPED else angle


@kernel_jit
def larger(worst: float, value: float) -> float:
    """The larger of two numbers; NaN if either is."""
    return value if not math.isnan(worst) and not value <= worst else worst


@kernel_jit
def farthest(point: np.ndarray, other: np.ndarray) -> float:
    """Largest distance of two points along an axis (m). Shapes (3,)."""
    worst = 0.0
    for axis in range(3):
        worst = larger(worst, abs(point[axis] - other[axis]))
    return worst


@kernel_jit
def status(header: np.ndarray, elements: np.ndarray, known: np.ndarray, values: np.ndarray, keep: bool) -> int:
    """Collision status; see the module. Returns its regime."""
    new, seen = header[0], known[_STATUS_SEEN] != 0.0
    counter = float(new["future_collision_seq"])
    growth = counter - known[_COUNTER]
    # Times and distances against the last publication; the first one equals its prediction.
    time, blocked = octaves(new["time_to_collision"]), octaves(new["distance_to_blocked"])
    unknown = octaves(new["distance_to_unknown"])
    values[0] = time - (known[_TIME] if seen else time)
    values[1] = blocked - (known[_BLOCKED] if seen else blocked)
    values[2] = unknown - (known[_UNKNOWN] if seen else unknown)
    values[3] = growth
    # Number of the trajectory (-1 = none); the counter of collisions must grow when there is one.
    number = float(new["trajectory_seq"])
    values[4] = 0.0 if number == -1.0 else number - known[_NUMBER]
    values[5] = (1.0 if new["collision"] else 0.0) - (1.0 if growth > 0.0 else 0.0)
    if keep:
        known[_COUNTER], known[_TIME], known[_BLOCKED], known[_UNKNOWN] = counter, time, blocked, unknown
        known[_STATUS_SEEN] = 1.0
    return since(known, _STATUS, keep)


@kernel_jit
def path(header: np.ndarray, elements: np.ndarray, known: np.ndarray, values: np.ndarray, keep: bool) -> int:
    """Path; see the module. Returns its regime."""
    new, count = header[0], len(elements)
    epoch, entry = float(new["future_collision_seq"]), new["entry_speed"]
    velocity = known[_VEHICLE + 3 : _VEHICLE + 6]
    speed = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    values[:] = 0.0
    # Entry speed (0 = none; NaN propagates) against that of the vehicle, and numbers against those of other states.
    values[0] = entry - speed if entry != 0.0 and known[_VEHICLE_KNOWN] != 0.0 else 0.0 * entry
    values[1] = epoch - known[_COUNTER]
    junction = float(new["junction"])
    values[2] = 0.0 if junction == -1.0 else junction - known[_INDEX]
    # Start against the vehicle, end against that of the last path.
    if count:
        if known[_VEHICLE_KNOWN] != 0.0:
            values[3] = farthest(elements[0], known[_VEHICLE : _VEHICLE + 3])
        if known[_HAS_GOAL] != 0.0:
            values[4] = farthest(elements[count - 1], known[_GOAL : _GOAL + 3])
        values[5] = detour(elements)
    if keep:
        known[_EPOCH], known[_HAS_END] = epoch, 1.0 if count else 0.0
        if count:
            known[_END : _END + 3] = elements[count - 1]
            known[_GOAL : _GOAL + 3] = elements[count - 1]
            known[_HAS_GOAL] = 1.0
    return since(known, _PATH, keep)


@kernel_jit
def detour(vertices: np.ndarray) -> float:
    """Length of a path minus the distance from its start to its end (m). Shape (n, 3)."""
    flown = 0.0
    for index in range(1, len(vertices)):
        flown += _distance(vertices[index], vertices[index - 1])
    return flown - _distance(vertices[len(vertices) - 1], vertices[0])


@kernel_jit
def _distance(point: np.ndarray, other: np.ndarray) -> float:
    return math.sqrt((point[0] - other[0]) ** 2 + (point[1] - other[1]) ** 2 + (point[2] - other[2]) ** 2)


@kernel_jit
def trajectory(header: np.ndarray, elements: np.ndarray, known: np.ndarray, values: np.ndarray, keep: bool) -> int:
    """Trajectory; see the module. Returns its regime."""
    new, count = header[0], len(elements)
    number = float(new["trajectory_seq"])
    values[:] = 0.0
    values[0] = number - known[_NUMBER] - 1.0
    values[1] = float(new["future_collision_seq"]) - known[_EPOCH]
    if count:
        _points(elements, values)
        if known[_VEHICLE_KNOWN] != 0.0:
            values[8] = farthest(elements[0, :3], known[_VEHICLE : _VEHICLE + 3])
        if known[_HAS_END] != 0.0:
            values[9] = farthest(elements[count - 1, :3], known[_END : _END + 3])
    if keep:
        known[_NUMBER] = number
    return since(known, _TRAJECTORY, keep)


@kernel_jit
def _points(points: np.ndarray, values: np.ndarray) -> None:
    """Largest deviation of a step from its velocity, change of velocity, speed, acceleration, duration, turn."""
    count = len(points)
    for index in range(count):
        point = points[index]
        for axis in range(3):
            values[4] = larger(values[4], abs(point[_VELOCITY + axis]))
            values[5] = larger(values[5], abs(point[_ACCELERATION + axis]))
        differs = point[_DURATION] - points[0, _DURATION]
        if index < count - 2:
            differs = abs(differs)  # the last two may be shorter
        values[6] = larger(larger(values[6], differs), -point[_DURATION])
        if index:
            before = points[index - 1]
            for axis in range(3):
                velocity = point[_VELOCITY + axis]
                step = point[axis] - before[axis] - velocity * point[_DURATION]
                values[2] = larger(values[2], abs(step))
                values[3] = larger(values[3], abs(velocity - before[_VELOCITY + axis]))
            values[7] = larger(values[7], abs(wrapped(point[_YAW] - before[_YAW])))


@kernel_jit
def waypoint(header: np.ndarray, elements: np.ndarray, known: np.ndarray, values: np.ndarray, keep: bool) -> int:
    """Way-point, whose single element repeats the leading header fields; see the module. Returns its regime."""
    new, point, last = header[0], elements[0], known[_POINT : _POINT + 11]
    number, index = float(new["trajectory_seq"]), float(new["index"])
    epoch = float(new["future_collision_seq"])
    same = known[_WAYPOINT_SEEN] != 0.0 and number == known[_OF_TRAJECTORY]
    # Position and velocity against the last way-point, or against the vehicle at the start of a trajectory.
    from_vehicle = not same and known[_VEHICLE_KNOWN] != 0.0
    for axis in range(3):
        start, before = last[axis], last[_VELOCITY + axis]
        if from_vehicle:
            start, before = known[_VEHICLE + axis], known[_VEHICLE + 3 + axis]
        velocity = point[_VELOCITY + axis]
        values[axis] = point[axis] - start - velocity * point[_DURATION]
        values[4 + axis] = velocity - before
        values[7 + axis] = point[_ACCELERATION + axis] - last[_ACCELERATION + axis]
    values[3] = wrapped(point[_YAW] - last[_YAW])
    values[10] = point[_DURATION] - last[_DURATION]
    # Numbers of its trajectory (0 = none), of the collision that this answers, and in the trajectory (-1 = none).
    values[11] = 0.0 if number == 0.0 or known[_OF_TRAJECTORY] == 0.0 else number - known[_OF_TRAJECTORY]
    values[12] = epoch - known[_ANSWERS]
    values[13] = 0.0
    if index != -1.0:
        values[13] = index - known[_INDEX] - 1.0 if same else index
    if known[_WAYPOINT_SEEN] == 0.0:
        values[:] = 0.0 * values  # nothing is predicted for the first one except finite numbers
    regime = SWITCH if same else NEW_TRAJECTORY
    if keep:
        known[_POINT : _POINT + 11] = point
        known[_OF_TRAJECTORY], known[_INDEX], known[_ANSWERS] = number, index, epoch
        known[_WAYPOINT_SEEN], known[_FRESH] = 1.0, 1.0
        for slot in range(SLOTS):
            known[_REGIME + slot] = max(known[_REGIME + slot], float(regime))
    return regime


@kernel_jit
def command(header: np.ndarray, elements: np.ndarray, known: np.ndarray, values: np.ndarray, keep: bool) -> int:
    """Command, whose single element repeats the header; see the module. Returns its regime."""
    for index in range(5):
        value = elements[0, index]
        values[index] = value - (known[_LAW + index] if known[_COMMAND_SEEN] != 0.0 else value)
    if keep:
        known[_LAW : _LAW + 5] = elements[0]
        known[_COMMAND_SEEN] = 1.0
    return since(known, _COMMAND, keep)


@kernel_jit
def tracking(header: np.ndarray, elements: np.ndarray, known: np.ndarray, values: np.ndarray, keep: bool) -> int:
    """Remaining time of the way-point in force, the single element; see the module. Returns its regime."""
    remaining = elements[0, 0]
    # A way-point that has just come into force has all of its duration left.
    expected = known[_POINT + _DURATION] if known[_FRESH] != 0.0 else known[_REMAINING]
    values[0] = remaining - expected
    if keep:
        known[_REMAINING], known[_FRESH] = remaining, 0.0
    return since(known, _TRACKING, keep)


@kernel_jit
def since(known: np.ndarray, slot: int, keep: bool) -> int:
    """Largest regime caused by a way-point since the last publication of a state; reset with `keep`."""
    largest = known[_REGIME + slot]
    if keep:
        known[_REGIME + slot] = float(PLAIN)
    # compared, not converted: a corrupted number must not become an index
    return NEW_TRAJECTORY if largest == NEW_TRAJECTORY else SWITCH if largest == SWITCH else PLAIN


@kernel_jit
def note_vehicle(motion: np.ndarray, known: np.ndarray) -> bool:
    """Store position and velocity of the vehicle (m, m/s), shape (6,), if all are finite; returns whether they are."""
    for value in motion:
        if not math.isfinite(value):
            return False
    known[_VEHICLE : _VEHICLE + 6] = motion
    known[_VEHICLE_KNOWN] = 1.0
    return True


@kernel_jit
def quantize(values: np.ndarray, quanta: np.ndarray, codes: np.ndarray) -> bool:
    """Residuals as multiples of a quantum, saturated to 16 bits; returns whether all are finite.

    Args:
        values: Residuals. Shape (n,).
        quanta: Quantum of each; 0 = not watched, code 0. Shape (n,).
        codes: Output. Shape (n,), int16.
    """
    finite = True
    for index in range(len(values)):
        code = 0.0
        if quanta[index] > 0.0:
            code = values[index] / quanta[index]
            if not math.isfinite(code):
                finite, code = False, 0.0
        codes[index] = int(round(min(max(code, -float(INT16_MAX)), float(INT16_MAX))))
    return finite
