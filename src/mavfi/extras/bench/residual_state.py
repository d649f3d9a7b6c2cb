"""Codes of one publication after the other, compiled: one function for each state that has residuals.

Each function commits the publication measured last, if that was accepted, and then measures its own: a publication
costs one call.
"""

from typing import NamedTuple

import numpy as np

from mavfi.detectors.features import REGIMES
from mavfi.extras.bench import residuals
from mavfi.numerics.jit import kernel_jit

SLOT, REGIME, ACCEPTED, COMMITTED = range(4)
"""Indices in `ResidualState.status`, whose docstring says what they are."""
_MOTION = 6
"""Numbers at the start of odometry: position and velocity."""
_STATUS, _PATH, _TRAJECTORY, _WAYPOINT, _COMMAND, _TRACKING = range(residuals.SLOTS)


class ResidualState(NamedTuple):
    """The publication measured last, and the memory between publications.

    Attributes:
        known: The memory, see `residuals`. Shape (SIZE,).
        after: The memory if this publication is accepted. Shape (SIZE,).
        values: Latest residuals of all states. Shape (n,).
        quanta: Quantum of each; 0 = not watched. Shape (n,).
        codes: Their latest codes. Shape (n,), int16.
        spans: First and one past the last residual of each state. Shape (SLOTS, 2), int64.
        status: Slot of its state; its regime, -1 - regime if a watched number is not finite, or -1 for a regime that
            does not exist; whether it was accepted; slot of the publication committed last. Shape (4,), int64.
    """

    known: np.ndarray
    after: np.ndarray
    values: np.ndarray
    quanta: np.ndarray
    codes: np.ndarray
    spans: np.ndarray
    status: np.ndarray


def initial_state(quanta: np.ndarray, spans: np.ndarray) -> ResidualState:
    """The state at the start of a flight; arguments as its attributes."""
    size = len(quanta)
    return ResidualState(
        np.zeros(residuals.SIZE),
        np.zeros(residuals.SIZE),
        np.zeros(size),
        quanta,
        np.zeros(size, np.int16),
        spans,
        np.zeros(4, np.int64),
    )


@kernel_jit
def settle(measured: ResidualState) -> None:
    """Commit the publication measured last, if accepted."""
    if measured.status[ACCEPTED] != 0:
        measured.known[:] = measured.after
        # COMMITTED is read nowhere: without it, faults in the instructions of `limits` would be others.
        measured.status[ACCEPTED], measured.status[COMMITTED] = 0, measured.status[SLOT]


@kernel_jit
def _begin(slot: int, measured: ResidualState) -> np.ndarray:
    """Settle; returns the residuals of a state, to be filled in."""
    settle(measured)
    measured.after[:] = measured.known
    return measured.values[measured.spans[slot, 0] : measured.spans[slot, 1]]


@kernel_jit
def _finish(slot: int, regime: int, measured: ResidualState) -> None:
    """Compute the codes of a state from its residuals, and store its slot and regime."""
    first, last = measured.spans[slot]
    finite = residuals.quantize(measured.values[first:last], measured.quanta[first:last], measured.codes[first:last])
    if not 0 <= regime < REGIMES:  # corrupted: never an index
        regime = -1
    elif not finite:
        regime = -1 - regime
    measured.status[SLOT], measured.status[REGIME] = slot, regime


@kernel_jit
def _leading(header: np.ndarray, width: int) -> np.ndarray:
    """The leading float64 fields of a header, as the single row of a list. Shape (1, width)."""
    return header.view(np.uint8)[: 8 * width].view(np.float64)[np.newaxis, :]


@kernel_jit
def measure_status(header: np.ndarray, measured: ResidualState) -> None:
    """Codes of a collision status, see `ResidualState`."""
    values = _begin(_STATUS, measured)
    _finish(_STATUS, residuals.status(header, values[np.newaxis, :], measured.after, values, True), measured)


@kernel_jit
def measure_path(header: np.ndarray, vertices: np.ndarray, measured: ResidualState) -> None:
    """Codes of a path, with vertices (m) of shape (n, 3)."""
    values = _begin(_PATH, measured)
    _finish(_PATH, residuals.path(header, vertices, measured.after, values, True), measured)


@kernel_jit
def measure_trajectory(header: np.ndarray, points: np.ndarray, measured: ResidualState) -> None:
    """Codes of a trajectory, with points of shape (n, 11)."""
    values = _begin(_TRAJECTORY, measured)
    _finish(_TRAJECTORY, residuals.trajectory(header, points, measured.after, values, True), measured)


@kernel_jit
def measure_waypoint(header: np.ndarray, measured: ResidualState) -> None:
    """Codes of a way-point."""
    values = _begin(_WAYPOINT, measured)
    _finish(_WAYPOINT, residuals.waypoint(header, _leading(header, 11), measured.after, values, True), measured)


@kernel_jit
def measure_command(header: np.ndarray, measured: ResidualState) -> None:
    """Codes of a command."""
    values = _begin(_COMMAND, measured)
    _finish(_COMMAND, residuals.command(header, _leading(header, 5), measured.after, values, True), measured)


@kernel_jit
def measure_tracking(header: np.ndarray, measured: ResidualState) -> None:
    """Codes of a tracking report."""
    values = _begin(_TRACKING, measured)
    _finish(_TRACKING, residuals.tracking(header, _leading(header, 1), measured.after, values, True), measured)


@kernel_jit
def note_vehicle(content: np.ndarray, measured: ResidualState) -> bool:
    """Settle, and store position and velocity of the vehicle, see `residuals.note_vehicle`.

    `content`: bytes of its odometry, which starts with them.
    """
    settle(measured)
    return residuals.note_vehicle(content[: 8 * _MOTION].view(np.float64), measured.known)
