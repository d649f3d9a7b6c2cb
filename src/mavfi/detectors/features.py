"""From published bytes to deltas: arithmetic shared by detectors and their training.

A detector stores the bytes of the last publication of each watched state; a delta is a function of those bytes, the new
ones and some context (timing, regime, vehicle).  Flight and training call the same functions, so a model is always
evaluated on the features it was trained on.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from mavfi.numerics.bits import saturated_int16, sign_exponent_code
from mavfi.numerics.elementary import atan2, cos, sin
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.stored import kind_of

DELTA_OF_CODES, INTEGER, CODE_OF_DELTA, CODE_OF_ANGLE, CODE_OF_INTERVAL, CODE_OF_TRAPEZOID = range(6)
"""Delta rule of a field; see `measure`."""

OFFSET, RULE, THRESHOLD, VELOCITY, AXIS = range(5)
"""Columns of a field table: byte offset, rule, exponent threshold of the code; for a position also the byte offset of
its velocity and the axis (0, 1, 2)."""

FIRST, LAST, TRAJECTORY, DURATION = range(4)
"""Columns of a place table, one row per watched state: range of its fields in the vector [FIRST, LAST), byte offsets of
trajectory_seq and duration (-1: not the way-point)."""

SEEN, REGIME = range(2)
"""Columns of a memory, one row per watched state: whether it was published yet, and the largest regime caused by a
way-point since then."""

PLAIN, SWITCH, NEW_TRAJECTORY = range(3)
"""Regimes of a publication, see `REGIMES`."""
REGIMES = 3
"""Number of regimes.  Since the last publication: no new way-point / a new one / the first one of a trajectory."""

KNOWN = 6
"""Index in `WatchedFields.vehicle` of the flag for known position and velocity."""
ODOMETRY = -1
"""Kind of recorded events that carry the vehicle's odometry instead of a watched state."""
_LARGEST_WRAPPED = 20.0


class WatchedFields(NamedTuple):
    """Watched fields, and the memory between publications.

    Attributes:
        places: Place table. Shape (slots, 4), int64.
        table: Field table. Shape (n, 5), int64.
        memory: Shape (slots, 2), float64.
        last: Bytes of the last publications. Shape (slots, largest size), uint8.
        vehicle: x, y, z (m), vx, vy, vz (m/s), and whether they are known. Shape (7,), float64.
    """

    places: np.ndarray
    table: np.ndarray
    memory: np.ndarray
    last: np.ndarray
    vehicle: np.ndarray


class LastJudgement(NamedTuple):
    """The publication judged last.

    Attributes:
        content: Its bytes. Shape (largest size,), uint8.
        status: Slot, number of bytes, regime, and whether it was accepted; an accepted publication is committed by the
            next call, so that each publication costs one call. Shape (4,), int64.
        score: Its score. Shape (1,).
        deltas: Shape (n,), int16.
        distance: See `scoring.Reading`. Shape (n,).
        unit: See `scoring.Reading`. Shape (n,).
        ratios: See `scoring.Threshold`. Shape (n,).
    """

    content: np.ndarray
    status: np.ndarray
    score: np.ndarray
    deltas: np.ndarray
    distance: np.ndarray
    unit: np.ndarray
    ratios: np.ndarray


_EXAMPLES = (
    WatchedFields(
        np.zeros((1, 4), np.int64),
        np.zeros((1, 5), np.int64),
        np.zeros((1, 2)),
        np.zeros((1, 1), np.uint8),
        np.zeros(KNOWN + 1),
    ),
    LastJudgement(
        np.zeros(1, np.uint8),
        np.zeros(4, np.int64),
        np.zeros(1),
        np.zeros(1, np.int16),
        np.zeros(1),
        np.zeros(1),
        np.zeros(1),
    ),
)


def kind_with(*tables: Any) -> Any:  # noqa: ANN401 - arrays, tuples of them, numbers
    """`kind_of` a watch, a scratch, the limits of a threshold, and examples of further tables."""
    return kind_of(*_EXAMPLES, np.zeros((1, 1)), *tables)


SLOT, SIZE, JUDGED_REGIME, ACCEPTED = range(4)
"""Indices in `LastJudgement.status`."""


class Events(NamedTuple):
    """A recorded flight.

    Attributes:
        slots: Watched state of each event, ODOMETRY for the vehicle. Shape (m,), int64.
        ends: End of each event's bytes in `content`. Shape (m,), int64.
        content: Bytes of all events. Shape (total,), uint8.
    """

    slots: np.ndarray
    ends: np.ndarray
    content: np.ndarray


@kernel_jit
def real_at(content: np.ndarray, offset: int) -> float:
    """The float64 at a byte offset."""
    return float(content[offset : offset + 8].view(np.float64)[0])


@kernel_jit
def integer_at(content: np.ndarray, offset: int) -> int:
    """The int32 at a byte offset."""
    return int(content[offset : offset + 4].view(np.int32)[0])


@kernel_jit
def _regime(content: np.ndarray, table_row: np.ndarray, memory_row: np.ndarray, last: np.ndarray) -> int:
    offset, largest = table_row[TRAJECTORY], memory_row[REGIME]
    if offset < 0:  # compared, not converted: a corrupted number must not become an index
        return NEW_TRAJECTORY if largest == NEW_TRAJECTORY else SWITCH if largest == SWITCH else PLAIN
    if memory_row[SEEN] == 0.0 or integer_at(content, offset) != integer_at(last, offset):
        return NEW_TRAJECTORY
    return SWITCH


@kernel_jit
def _innovation(
    content: np.ndarray, last: np.ndarray, field: np.ndarray, duration: float, vehicle: np.ndarray
) -> float:
    """Position minus its prediction from the velocity, on one axis (m).

    Args:
        content: New bytes.
        last: Bytes of the last publication.
        field: Row of the field table.
        duration: How long the new way-point is held (s).
        vehicle: Start of the motion, as `WatchedFields.vehicle`; shape (0,) = the last way-point.
    """
    velocity = real_at(content, field[VELOCITY])
    if len(vehicle) > 0:
        start, before = vehicle[field[AXIS]], vehicle[3 + field[AXIS]]
    else:
        start, before = real_at(last, field[OFFSET]), real_at(last, field[VELOCITY])
    mean = velocity if field[RULE] == CODE_OF_INTERVAL else 0.5 * (velocity + before)
    return float(real_at(content, field[OFFSET]) - start - mean * duration)


@kernel_jit
def _wrapped(angle: float) -> float:
    if abs(angle) < _LARGEST_WRAPPED:
        return atan2(sin(angle), cos(angle))
    return angle


@kernel_jit
def _difference(content: np.ndarray, last: np.ndarray, field: np.ndarray) -> int:
    """Delta of a field whose rule needs only the two values."""
    offset, rule, threshold = field[OFFSET], field[RULE], field[THRESHOLD]
    if rule == INTEGER:
        return saturated_int16(integer_at(content, offset) - integer_at(last, offset))
    value, before = real_at(content, offset), real_at(last, offset)
    if rule == DELTA_OF_CODES:
        return sign_exponent_code(value, threshold) - sign_exponent_code(before, threshold)
    difference = value - before
    return sign_exponent_code(_wrapped(difference) if rule == CODE_OF_ANGLE else difference, threshold)


@kernel_jit
def measure(content: np.ndarray, slot: int, watch: WatchedFields, deltas: np.ndarray) -> int:
    """Deltas of a publication; changes nothing but `deltas`.

    Rules: DELTA_OF_CODES, the paper's: difference of the two codes.  INTEGER: difference, saturated to 16 bits.
    CODE_OF_DELTA: code of the float64 difference.  CODE_OF_ANGLE: code of the difference, wrapped to ±pi.
    CODE_OF_INTERVAL: code of a position's deviation from the last way-point advanced at the new way-point's velocity
    over its duration.  CODE_OF_TRAPEZOID: as before, at the mean velocity of both way-points.  The first way-point of a
    trajectory is predicted from the vehicle instead of the last way-point.  A first publication has delta 0.

    Args:
        content: Bytes of the published header. Shape (size,), uint8.
        slot: Index of the watched state.
        watch: Tables and memory.
        deltas: Output, from places[slot, FIRST] to places[slot, LAST]. Shape (n,), int16.

    Returns:
        The regime, or -1 - regime if a watched float64 is not finite.
    """
    table_row, memory_row, before, vehicle = watch.places[slot], watch.memory[slot], watch.last[slot], watch.vehicle
    regime = _regime(content, table_row, memory_row, before)
    fresh = regime == NEW_TRAJECTORY
    finite = True
    for index in range(table_row[FIRST], table_row[LAST]):
        field = watch.table[index]
        rule = field[RULE]
        if rule != INTEGER and not math.isfinite(real_at(content, field[OFFSET])):
            finite = False
        delta = 0
        if rule >= CODE_OF_INTERVAL:
            if not fresh or vehicle[KNOWN] != 0.0:
                duration = real_at(content, table_row[DURATION])
                error = _innovation(content, before, field, duration, vehicle if fresh else vehicle[:0])
                delta = sign_exponent_code(error, field[THRESHOLD])
        elif memory_row[SEEN] != 0.0:
            delta = _difference(content, before, field)
        deltas[index] = delta
    return regime if finite else -1 - regime


def not_finite(content: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Whether each field of a publication is infinite or NaN; arguments as for `measure`. Shape (n,), bool."""
    return np.array([row[RULE] != INTEGER and not math.isfinite(real_at(content, row[OFFSET])) for row in table])


@kernel_jit
def commit(content: np.ndarray, slot: int, watch: WatchedFields) -> None:
    """Store a publication as the last one of its state; arguments as for `measure`."""
    memory_row = watch.memory[slot]
    if watch.places[slot, TRAJECTORY] >= 0:
        regime = _regime(content, watch.places[slot], memory_row, watch.last[slot])
        for other in range(len(watch.memory)):
            watch.memory[other, REGIME] = max(watch.memory[other, REGIME], float(regime))
    memory_row[SEEN], memory_row[REGIME] = 1.0, float(PLAIN)
    watch.last[slot, : len(content)] = content


@kernel_jit
def propose(content: np.ndarray, slot: int, scratch: LastJudgement) -> None:
    """Store a publication that is being judged, and its `slot`; see `LastJudgement`."""
    scratch.content[: len(content)] = content
    scratch.status[SLOT], scratch.status[SIZE] = slot, len(content)


@kernel_jit
def settle(scratch: LastJudgement, watch: WatchedFields) -> None:
    """Commit the publication judged last as the last one of its state."""
    commit(scratch.content[: scratch.status[SIZE]], scratch.status[SLOT], watch)
    scratch.status[ACCEPTED] = 0


@kernel_jit
def note_vehicle(content: np.ndarray, vehicle: np.ndarray) -> bool:
    """Store position and velocity of the vehicle if they are finite; returns whether they are.

    Args:
        content: Bytes of its odometry, starting with x, y, z, vx, vy, vz.
        vehicle: Output, see `WatchedFields`.
    """
    for index in range(KNOWN):
        if not math.isfinite(real_at(content, 8 * index)):
            return False
    for index in range(KNOWN):
        vehicle[index] = real_at(content, 8 * index)
    vehicle[KNOWN] = 1.0
    return True


@kernel_jit
def replay(events: Events, watch: WatchedFields, vectors: np.ndarray, regimes: np.ndarray) -> None:
    """Vectors of deltas that a detector sees in a recorded flight.

    Args:
        events: The flight.
        watch: In the state at the start of a flight.
        vectors: Output: latest delta of every field at each event. Shape (m, n), int16.
        regimes: Output: return value of `measure` at each event. Shape (m,), int64.
    """
    held = np.zeros(len(watch.table), np.int16)
    start = 0
    for event in range(len(events.slots)):
        slot, end = events.slots[event], events.ends[event]
        piece = events.content[start:end]
        start = end
        if slot == ODOMETRY:
            note_vehicle(piece, watch.vehicle)
        else:
            regimes[event] = measure(piece, slot, watch, held)
            commit(piece, slot, watch)
        vectors[event] = held
