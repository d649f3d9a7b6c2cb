"""From published bytes to deltas: the arithmetic that detectors and their training share.

A detector remembers, per watched state, the bytes that were published last; a delta is a function of those bytes, of
the new ones and of a little context (when, which regime, where the vehicle is).  Flying and training run the same
functions, so a model is always judged on the features that it was trained on.
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.numerics.bits import saturated_int16, sign_exponent_code
from mavfi.numerics.elementary import atan2, cos, sin
from mavfi.numerics.jit import kernel_jit

DELTA_OF_CODES, INTEGER, CODE_OF_DELTA, CODE_OF_ANGLE, CODE_OF_INTERVAL, CODE_OF_TRAPEZOID = range(6)
"""How a field becomes a delta; see `measure`."""

OFFSET, RULE, THRESHOLD, VELOCITY, AXIS = range(5)
"""Columns of a field table: byte offset, rule, exponent threshold of the code, for a position the byte offset of its
velocity and the axis (0, 1, 2)."""

FIRST, LAST, TRAJECTORY, DURATION = range(4)
"""Columns of a place table, one row per watched state: range of its fields in the vector [FIRST, LAST), byte offsets of
trajectory_seq and duration (-1: it is not the way-point)."""

SEEN, REGIME = range(2)
"""Columns of a memory, one row per watched state: whether it was published yet, and the largest regime that a way-point
has caused since then."""

PLAIN, SWITCH, NEW_TRAJECTORY = range(3)
REGIMES = 3
"""Regimes: no change of plan / another way-point / the first way-point of a trajectory since the last publication."""

KNOWN = 6
"""Where `Watch.vehicle` says whether the vehicle is known."""
ODOMETRY = -1
"""Kind of a recorded event that is not a watched state but the vehicle's odometry."""
_LARGEST_WRAPPED = 20.0


class Watch(NamedTuple):
    """What is watched, and what is remembered of it.

    Attributes:
        places: Place table. Shape (slots, 4), int64.
        table: Field table. Shape (n, 5), int64.
        memory: Shape (slots, 2), float64.
        last: Bytes that were published last. Shape (slots, largest size), uint8.
        vehicle: x, y, z (m), vx, vy, vz (m/s), and whether they are known. Shape (7,), float64.
    """

    places: np.ndarray
    table: np.ndarray
    memory: np.ndarray
    last: np.ndarray
    vehicle: np.ndarray


class Scratch(NamedTuple):
    """What was judged last.

    Attributes:
        content: Its bytes. Shape (largest size,), uint8.
        place: Its slot, number of bytes, and regime; and whether it was accepted, and is to be taken note of with the
            next call: one call for each publication. Shape (4,), int64.
        score: Of it. Shape (1,).
        deltas: Shape (n,), int16.
        distance: See `parts.Reading`. Shape (n,).
        unit: See `parts.Reading`. Shape (n,).
        ratios: See `parts.Verdict`. Shape (n,).
    """

    content: np.ndarray
    place: np.ndarray
    score: np.ndarray
    deltas: np.ndarray
    distance: np.ndarray
    unit: np.ndarray
    ratios: np.ndarray


SLOT, SIZE, JUDGED_REGIME, ACCEPTED = range(4)
"""Places in `Scratch.place`."""


class Events(NamedTuple):
    """A recorded flight.

    Attributes:
        slots: Watched state of each event, ODOMETRY for the vehicle. Shape (m,), int64.
        ends: Where the bytes of each event end in `content`. Shape (m,), int64.
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
def _regime(content: np.ndarray, place: np.ndarray, memory_row: np.ndarray, last: np.ndarray) -> int:
    offset = place[TRAJECTORY]
    if offset < 0:
        return int(memory_row[REGIME])
    if memory_row[SEEN] == 0.0 or integer_at(content, offset) != integer_at(last, offset):
        return NEW_TRAJECTORY
    return SWITCH


@kernel_jit
def _innovation(
    content: np.ndarray, last: np.ndarray, field: np.ndarray, duration: float, vehicle: np.ndarray
) -> float:
    """Position minus its prediction from the velocity, per axis (m).

    Args:
        content: New bytes.
        last: Bytes published last.
        field: Row of the field table.
        duration: How long the new way-point is held (s).
        vehicle: Where the motion starts if not at the last way-point, as `Watch.vehicle`; or shape (0,).
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
    """Delta of a field whose rule needs nothing but the two values."""
    offset, rule, threshold = field[OFFSET], field[RULE], field[THRESHOLD]
    if rule == INTEGER:
        return saturated_int16(integer_at(content, offset) - integer_at(last, offset))
    value, before = real_at(content, offset), real_at(last, offset)
    if rule == DELTA_OF_CODES:
        return sign_exponent_code(value, threshold) - sign_exponent_code(before, threshold)
    difference = value - before
    return sign_exponent_code(_wrapped(difference) if rule == CODE_OF_ANGLE else difference, threshold)


@kernel_jit
def measure(content: np.ndarray, slot: int, watch: Watch, deltas: np.ndarray) -> int:
    """Deltas of a publication; changes nothing but `deltas`.

    The rules: DELTA_OF_CODES, the paper's: code first, then difference.  INTEGER: difference, saturated to 16 bits.
    CODE_OF_DELTA: difference in float64 first, then its code.  CODE_OF_ANGLE: the same of an angle, wrapped to ±pi.
    CODE_OF_INTERVAL: code of a position minus where the last way-point gets with this one's velocity in this one's
    duration.  CODE_OF_TRAPEZOID: the same with the mean of both way-points' velocities.  The first way-point of a
    trajectory is predicted from the vehicle instead of the last way-point.  A first publication has no delta: 0.

    Args:
        content: Bytes of the published header. Shape (size,), uint8.
        slot: Which watched state.
        watch: What is remembered.
        deltas: Filled in from places[slot, FIRST] to places[slot, LAST]. Shape (n,), int16.

    Returns:
        The regime, or -1 - regime if a watched float64 is not finite.
    """
    place, own, before, vehicle = watch.places[slot], watch.memory[slot], watch.last[slot], watch.vehicle
    regime = _regime(content, place, own, before)
    fresh = regime == NEW_TRAJECTORY
    finite = True
    for index in range(place[FIRST], place[LAST]):
        field = watch.table[index]
        rule = field[RULE]
        if rule != INTEGER and not math.isfinite(real_at(content, field[OFFSET])):
            finite = False
        delta = 0
        if rule >= CODE_OF_INTERVAL:
            if not fresh or vehicle[KNOWN] != 0.0:
                duration = real_at(content, place[DURATION])
                error = _innovation(content, before, field, duration, vehicle if fresh else vehicle[:0])
                delta = sign_exponent_code(error, field[THRESHOLD])
        elif own[SEEN] != 0.0:
            delta = _difference(content, before, field)
        deltas[index] = delta
    return regime if finite else -1 - regime


def not_finite(content: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Which fields of a publication are not finite; arguments as of `measure`. Shape (n,), bool."""
    return np.array([row[RULE] != INTEGER and not math.isfinite(real_at(content, row[OFFSET])) for row in table])


@kernel_jit
def commit(content: np.ndarray, slot: int, watch: Watch) -> None:
    """Remember a publication; arguments as of `measure`."""
    own = watch.memory[slot]
    if watch.places[slot, TRAJECTORY] >= 0:
        regime = _regime(content, watch.places[slot], own, watch.last[slot])
        for other in range(len(watch.memory)):
            watch.memory[other, REGIME] = max(watch.memory[other, REGIME], float(regime))
    own[SEEN], own[REGIME] = 1.0, float(PLAIN)
    watch.last[slot, : len(content)] = content


@kernel_jit
def propose(content: np.ndarray, slot: int, scratch: Scratch) -> None:
    """Keep a publication of a state (`slot`) that is judged; see `Scratch`."""
    scratch.content[: len(content)] = content
    scratch.place[SLOT], scratch.place[SIZE] = slot, len(content)


@kernel_jit
def settle(scratch: Scratch, watch: Watch) -> None:
    """What was judged last is what was published last of its state."""
    commit(scratch.content[: scratch.place[SIZE]], scratch.place[SLOT], watch)
    scratch.place[ACCEPTED] = 0


@kernel_jit
def note_vehicle(content: np.ndarray, vehicle: np.ndarray) -> bool:
    """Remember where the vehicle is, and say whether; odometry that is not finite is not taken.

    Args:
        content: Bytes of its odometry, led by x, y, z, vx, vy, vz.
        vehicle: Filled in, see `Watch`.
    """
    for index in range(KNOWN):
        if not math.isfinite(real_at(content, 8 * index)):
            return False
    for index in range(KNOWN):
        vehicle[index] = real_at(content, 8 * index)
    vehicle[KNOWN] = 1.0
    return True


@kernel_jit
def replay(events: Events, watch: Watch, vectors: np.ndarray, regimes: np.ndarray) -> None:
    """The vectors that a detector sees in a recorded flight.

    Args:
        events: The flight.
        watch: As at the start of a flight.
        vectors: Filled in: at each event the last delta of every field. Shape (m, n), int16.
        regimes: Filled in: what `measure` returns at each event. Shape (m,), int64.
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
