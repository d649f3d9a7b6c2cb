"""Codes of one publication after the other, compiled: one function for each state that has residuals.

A function commits the publication measured last, if that was accepted, and then measures its own: each publication
costs one call.
"""

from typing import NamedTuple

import numpy as np
from numba import from_dtype
from numba.extending import overload

from mavfi.detectors import residuals
from mavfi.detectors.features import REGIMES
from mavfi.numerics.dependencies import uses
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.stored import kind_of, load
from mavfi.states import STATES

SLOT, REGIME, ACCEPTED, LEARNED = range(4)
"""Indices in `Book.place`."""
NEVER = -1
"""`LEARNED` if there is nothing to learn."""
_MOTION = 6
_STATUS, _PATH, _TRAJECTORY, _WAYPOINT, _COMMAND, _TRACKING = range(residuals.SLOTS)


class Book(NamedTuple):
    """The publication measured last, and the memory between publications.

    Attributes:
        known: The memory, see `residuals`. Shape (SIZE,).
        after: The memory if this publication is accepted. Shape (SIZE,).
        values: Latest residuals of all states. Shape (n,).
        quanta: Quantum of each; 0 = not watched. Shape (n,).
        codes: Their latest codes. Shape (n,), int16.
        spans: First and one past the last residual of each state. Shape (SLOTS, 2), int64.
        place: Slot of its state; its regime, -1 - regime if a watched number is not finite, or -1 for a regime that
            does not exist; whether it was accepted; slot of an accepted publication that a scorer has not learned yet.
            Shape (4,), int64.
    """

    known: np.ndarray
    after: np.ndarray
    values: np.ndarray
    quanta: np.ndarray
    codes: np.ndarray
    spans: np.ndarray
    place: np.ndarray


def new_book(quanta: np.ndarray, spans: np.ndarray) -> Book:
    """A book at the start of a flight; arguments as its attributes."""
    size = len(quanta)
    return Book(
        np.zeros(residuals.SIZE), np.zeros(residuals.SIZE), np.zeros(size), quanta, np.zeros(size, np.int16), spans,
        np.array([0, 0, 0, NEVER]),
    )  # fmt: skip


BOOK = new_book(np.zeros(1), np.zeros((residuals.SLOTS, 2), np.int64))
"""An example."""
KIND = kind_of(BOOK)
"""Of a stored book."""


@kernel_jit
def settle(book: Book) -> None:
    """Commit the publication measured last, if accepted."""
    if book.place[ACCEPTED] != 0:
        book.known[:] = book.after
        book.place[ACCEPTED], book.place[LEARNED] = 0, book.place[SLOT]


@kernel_jit
def _begin(slot: int, book: Book) -> np.ndarray:
    """Settle; returns the residuals of a state, to be filled in."""
    settle(book)
    book.after[:] = book.known
    return book.values[book.spans[slot, 0] : book.spans[slot, 1]]


@kernel_jit
def _finish(slot: int, regime: int, book: Book) -> None:
    first, last = book.spans[slot]
    finite = residuals.quantize(book.values[first:last], book.quanta[first:last], book.codes[first:last])
    if not 0 <= regime < REGIMES:  # corrupted: never an index
        regime = -1
    elif not finite:
        regime = -1 - regime
    book.place[SLOT], book.place[REGIME] = slot, regime


@kernel_jit
def _leading(header: np.ndarray, width: int) -> np.ndarray:
    """The leading float64 fields of a header, as the single row of a list. Shape (1, width)."""
    return header.view(np.uint8)[: 8 * width].view(np.float64)[np.newaxis, :]


@kernel_jit
def measure_status(header: np.ndarray, book: Book) -> None:
    """Codes of a collision status, see `Book`."""
    values = _begin(_STATUS, book)
    _finish(_STATUS, residuals.status(header, values[np.newaxis, :], book.after, values, True), book)


@kernel_jit
def measure_path(header: np.ndarray, vertices: np.ndarray, book: Book) -> None:
    """Codes of a path, with vertices (m) of shape (n, 3)."""
    values = _begin(_PATH, book)
    _finish(_PATH, residuals.path(header, vertices, book.after, values, True), book)


@kernel_jit
def measure_trajectory(header: np.ndarray, points: np.ndarray, book: Book) -> None:
    """Codes of a trajectory, with points of shape (n, 11)."""
    values = _begin(_TRAJECTORY, book)
    _finish(_TRAJECTORY, residuals.trajectory(header, points, book.after, values, True), book)


@kernel_jit
def measure_waypoint(header: np.ndarray, book: Book) -> None:
    """Codes of a way-point."""
    values = _begin(_WAYPOINT, book)
    _finish(_WAYPOINT, residuals.waypoint(header, _leading(header, 11), book.after, values, True), book)


@kernel_jit
def measure_command(header: np.ndarray, book: Book) -> None:
    """Codes of a command."""
    values = _begin(_COMMAND, book)
    _finish(_COMMAND, residuals.command(header, _leading(header, 5), book.after, values, True), book)


@kernel_jit
def measure_tracking(header: np.ndarray, book: Book) -> None:
    """Codes of a tracking report."""
    values = _begin(_TRACKING, book)
    _finish(_TRACKING, residuals.tracking(header, _leading(header, 1), book.after, values, True), book)


@kernel_jit
def note_vehicle(content: np.ndarray, book: Book) -> bool:
    """Settle, and store position and velocity of the vehicle, see `residuals.note_vehicle`.

    `content`: bytes of its odometry, which starts with them.
    """
    settle(book)
    return residuals.note_vehicle(content[: 8 * _MOTION].view(np.float64), book.known)


@kernel_jit
def _status_at(header: np.ndarray, address: int) -> None:
    (book,) = load(address, KIND)
    measure_status(header, book)


@kernel_jit
def _waypoint_at(header: np.ndarray, address: int) -> None:
    (book,) = load(address, KIND)
    measure_waypoint(header, book)


@kernel_jit
def _command_at(header: np.ndarray, address: int) -> None:
    (book,) = load(address, KIND)
    measure_command(header, book)


@kernel_jit
def _tracking_at(header: np.ndarray, address: int) -> None:
    (book,) = load(address, KIND)
    measure_tracking(header, book)


@kernel_jit
def _vehicle_at(content: np.ndarray, address: int) -> bool:
    (book,) = load(address, KIND)
    return note_vehicle(content, book)


def measure(header: np.ndarray, book: Book) -> None:
    """Codes of a publication without a list, by the type of its header; for compiled code, see `_measure`."""
    _BY_TYPE[header.dtype](header, book)


_BY_TYPE = {
    STATES["perception.collision_status"].header_dtype: measure_status,
    STATES["planning.waypoint"].header_dtype: measure_waypoint,
    STATES["control.command"].header_dtype: measure_command,
    STATES["control.tracking"].header_dtype: measure_tracking,
}


@overload(measure)
def _measure(header, book):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202 - Numba compares the signatures
    own = next(own for dtype, own in _BY_TYPE.items() if from_dtype(dtype) == header.dtype)
    return lambda header, book: own(header, book)


uses(measure, _BY_TYPE)  # for the key of compiled code that calls `measure`


@kernel_jit
def accept_unless_alarm(score: float, book: Book) -> bool:
    """Accept the publication measured last unless its score is an alarm; returns whether it is one."""
    alarm = not score <= 1.0
    if not alarm:
        book.place[ACCEPTED] = 1
    return alarm


AT = {
    "measure_status": _status_at, "measure_waypoint": _waypoint_at, "measure_command": _command_at,
    "measure_tracking": _tracking_at, "note_vehicle": _vehicle_at,
}  # fmt: skip
"""The functions without a list, of a header, or bytes, and the address of a stored book."""
