"""Contents of work arrays at earlier instants.

Kernels write their work arrays before they read them, so these are no memory.  A step with a fault may read what
earlier steps left there; it can be started from a checkpoint if that can be restored.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mavfi.errors import MavfiError
from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.kernels.perception.octomap import UpdateRule, insert_scan, undo_scan
from mavfi.pipeline.changes import common_length

Scan = tuple[np.ndarray, np.ndarray] | None
"""Points and origin of an integrated scan; None = the last scan was undone."""


class ScanArrays:
    """Work arrays of `insert_scan` for a map that is zero at first.

    Args:
        frame: Grid.
        rule: Update rule.
        max_range: Range of the sensor (m).

    Attributes:
        log_odds: The map. Shape (nx * ny * nz,), float32.
        stamp: See `insert_scan`. Same shape, int32.
        touched: See `insert_scan`. One longer, int32.
        before: See `insert_scan`. Same shape, float32.
        scans: Number of scans so far, undone ones included.
    """

    def __init__(self, frame: KeyFrame, rule: UpdateRule, max_range: float) -> None:
        self._frame, self._rule, self._range = frame, rule, max_range
        size = frame.nx * frame.ny * frame.nz
        self.log_odds = np.zeros(size, np.float32)
        self.stamp = np.zeros(size, np.int32)
        self.touched = np.zeros(size + 1, np.int32)
        self.before = np.zeros(size, np.float32)
        self.scans, self._count = 0, 0
        self._done: list[Scan] = []

    def like(self) -> "ScanArrays":
        """New arrays of a map that is zero."""
        return ScanArrays(self._frame, self._rule, self._range)

    def take(self, other: "ScanArrays") -> None:
        """Copy the contents of other arrays."""
        for name in ("log_odds", "stamp", "touched", "before"):
            getattr(self, name)[:] = getattr(other, name)
        self.scans = other.scans

    def repeat(self, scans: Sequence[Scan]) -> None:
        """Integrate scans again; what has been integrated already is not repeated."""
        if common_length(self._done, scans) < len(self._done):
            for array in (self.log_odds, self.stamp, self.touched, self.before):
                array[:] = 0
            self.scans, self._done = 0, []
        for scan in scans[len(self._done) :]:
            self._done.append(scan)
            if scan is None:
                undo_scan(self.log_odds, self.touched, self.before, self._count)
                continue
            self.scans += 1
            points, origin = scan
            self._count = insert_scan(
                points, origin, self._range, self._frame, self._rule, self.log_odds, self.stamp, self.scans,
                self.touched, self.before,
            )  # fmt: skip


class ScanScratch:
    """`Scratch` of a dense map, given its work arrays: the scans so far, which are integrated again to restore them."""

    def __init__(self, arrays: ScanArrays) -> None:
        self._arrays = arrays
        self._scans: list[Scan] = []
        self._again: ScanArrays | None = None

    def note(self, scan: Scan) -> None:
        """Append a scan that is integrated now."""
        self._scans.append(scan)

    def save(self) -> tuple[Scan, ...]:
        """See `Scratch.save`."""
        return tuple(self._scans)

    def restore(self, saved: tuple[Scan, ...]) -> None:
        """See `Scratch.restore`."""
        self._scans = list(saved)

    def fill(self) -> None:
        """See `Scratch.fill`.

        Raises:
            MavfiError: The scans do not lead to the current map.
        """
        own = self._arrays
        if self._again is None:
            self._again = own.like()
        self._again.repeat(self._scans)
        if self._again.log_odds.tobytes() != own.log_odds.tobytes():
            raise MavfiError("a map differs from its scans")
        own.take(self._again)


class SearchScratch:
    """`Scratch` of a path search: a copy of its arrays, shared by all instants between two searches.

    Args:
        arrays: The arrays.
    """

    def __init__(self, arrays: Sequence[np.ndarray]) -> None:
        self._arrays = arrays
        self._saved: tuple[np.ndarray, ...] | None = None

    def changes(self) -> None:
        """The arrays are written now."""
        self._saved = None

    def save(self) -> tuple[np.ndarray, ...]:
        """See `Scratch.save`."""
        if self._saved is None:
            self._saved = tuple(array.copy() for array in self._arrays)
        return self._saved

    def restore(self, saved: tuple[np.ndarray, ...]) -> None:
        """See `Scratch.restore`; arrays are written at once."""
        if saved is not self._saved:
            for array, content in zip(self._arrays, saved, strict=True):
                array[:] = content
        self._saved = saved

    def fill(self) -> None:
        """See `Scratch.fill`."""


def arrays_of(value: Any) -> list[np.ndarray]:  # noqa: ANN401
    """All arrays in nested tuples, in order."""
    if isinstance(value, tuple):
        return [array for part in value for array in arrays_of(part)]
    return [value] if isinstance(value, np.ndarray) else []
