"""Custom detectors: those that are not part of mavfi, whose code may raise, never return, or end the process.

A call in progress is noted in memory that a forked process shares with its parent, so that the parent of one that ended
in a call, or did not return from it, can name it.
"""

import mmap
from typing import Any

from mavfi.detectors.detector import class_of
from mavfi.errors import MavfiError
from mavfi.ir.forked import WALL_CLOCK, Ended, ForkPoint

_SIZE = 256  # of a noted call (bytes); longer names are cut off
_IDLE = bytes(_SIZE)


def is_custom(detector: Any) -> bool:  # noqa: ANN401 - a user's own
    """Whether there is a detector, and it, or one of its parts, is not part of mavfi."""
    if detector is None:
        return False
    if not type(detector).__module__.startswith("mavfi."):
        return True
    return any(is_custom(part) for part in getattr(detector, "parts", ()))


class CustomCallError(MavfiError):
    """A call of a custom detector did not return, or ended its process."""


class _CurrentCall:
    """The call of a custom detector that is in progress in this process.

    `note` is None unless this process was forked by `split_noting_calls`: nobody would read it.
    """

    note: mmap.mmap | None = None


class NotedCalls:
    """A custom detector of which each call is noted while it is in progress.

    Args:
        detector: The detector.
    """

    def __init__(self, detector: Any) -> None:  # noqa: ANN401 - a user's own
        self._detector, self._class = detector, class_of(detector)

    def start(self) -> None:
        """See `Detector`."""
        self._call("start")

    def check(self, state: Any, time_us: int) -> Any:  # noqa: ANN401 - a user may return anything
        """See `Detector`."""
        return self._call("check", state, time_us)

    def accept(self, state: Any, time_us: int) -> None:  # noqa: ANN401
        """See `Detector`."""
        self._call("accept", state, time_us)

    def seal(self, state: Any, time_us: int) -> None:  # noqa: ANN401
        """See `Detector`."""
        self._call("seal", state, time_us)

    def _call(self, method: str, *arguments: Any) -> Any:  # noqa: ANN401
        call, note = getattr(self._detector, method), _CurrentCall.note
        if note is None:
            return call(*arguments)
        note[:] = f"{self._class}: {method}".encode()[:_SIZE].ljust(_SIZE, b"\0")
        try:
            return call(*arguments)
        finally:
            note[:] = _IDLE


def split_noting_calls(point: ForkPoint, timeout: float) -> Ended | None:
    """As `ForkPoint.split`.

    Raises:
        CustomCallError: The child ended in a call of a custom detector, or did not return from it in time.
    """
    outer = _CurrentCall.note
    note = _CurrentCall.note = mmap.mmap(-1, _SIZE)
    try:
        ended = point.split(timeout)
    finally:
        if not point.in_child:
            _CurrentCall.note = outer
    if ended is None:
        return None
    call = bytes(note).rstrip(b"\0").decode(errors="replace")
    note.close()
    if ended.how == "done" or not call:
        return ended
    if ended.detail == WALL_CLOCK:
        raise CustomCallError(f"detector {call} did not return within {timeout:g} s")
    raise CustomCallError(f"detector {call} ended its process ({ended.detail})")
