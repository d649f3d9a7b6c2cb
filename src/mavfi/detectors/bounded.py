"""Calls of detectors that are not part of mavfi: one that never returns, or ends its process, must not block a flight.

Python code and system calls are stopped after `LIMIT_S`.  Compiled code cannot be stopped, nor can a process that it
crashed continue.  But a flight is a pure function of its specification: `split_again` repeats it in another child
process, where the call of the same number raises a `StuckError` at once.  Without such a parent, compiled code that
does not return ends its process after `LONGEST_S`, with the line of the detector that called it.

Such a flight depends on the wall clock, like one whose forked kernel or ROS node hangs; without the limit it would not
end.
"""

import faulthandler
import itertools
import mmap
import os
import re
import signal
import struct
import sys
import sysconfig
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mavfi.ir.forked import Ended, ForkPoint

LIMIT_S = 60.0
"""Wall time after which a call is stopped (s), as on ROS."""
LONGEST_S = 2.0 * LIMIT_S
"""That after which its process is ended, if it cannot be stopped (s)."""
_CALL = struct.Struct("qd")  # number of the call in progress (0 = none), and its start (s, monotonic)
_FRAME = re.compile(r'File "(.+)", line (\d+) in (\S+)')  # the innermost is the first
_LONGEST_STACK = 1 << 16
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")})


class StuckError(BaseException):
    """A call did not return in time, or ended its process; not an `Exception`, since the code called may handle those.

    Attributes:
        died: How it ended its process, e.g. "SIGSEGV"; "" = it did not return.
    """

    def __init__(self, died: str = "") -> None:
        super().__init__(died)
        self.died = died


class _Calls:
    """The calls of this process, counted, and known to its parent.

    Attributes:
        parent: What the parent reads; None = it does not repeat flights.
        ended: Those that ended earlier attempts, by number, see `StuckError.died`.
    """

    def __init__(self, parent: "_Parent | None", ended: dict[int, str]) -> None:
        self.parent, self.ended = parent, ended
        self._number = 0

    def begin(self) -> None:
        """Count a call; raises a `StuckError` if it ended an earlier attempt."""
        self._number += 1
        if self._number in self.ended:
            raise StuckError(self.ended[self._number])
        if self.parent is not None:
            _CALL.pack_into(self.parent.cell, 0, self._number, time.monotonic())
            faulthandler.enable(self.parent.stack, all_threads=False)

    def end(self) -> None:
        """Note that the call has ended."""
        if self.parent is not None:
            faulthandler.disable()
            _CALL.pack_into(self.parent.cell, 0, 0, 0.0)


class _Parent:
    """What a parent knows of the present call of its child.

    Attributes:
        cell: Shared memory with a `_CALL`.
        stack: File for the stack of a call that ends the process.
    """

    def __init__(self) -> None:
        self.cell, self.stack = mmap.mmap(-1, _CALL.size), os.memfd_create("stack")

    @property
    def number(self) -> int:
        """Number of the call; 0 = none."""
        number: int = _CALL.unpack_from(self.cell)[0]
        return number

    def is_overdue(self) -> bool:
        """Whether the call has taken too long."""
        number, since = _CALL.unpack_from(self.cell)
        return bool(number) and time.monotonic() - since > LONGEST_S

    def tell(self, what: str) -> None:
        """Write what became of the call to standard error, with its line if that is known."""
        stack = _FRAME.findall(os.pread(self.stack, _LONGEST_STACK, 0).decode(errors="replace"))
        frames = list(itertools.takewhile(lambda frame: frame[0] != __file__, stack))  # of the detector
        own = [frame for frame in frames if not frame[0].startswith(_LIBRARIES)]
        where = "".join(f" ({Path(file).name}:{line}, {name})" for file, line, name in (own or frames)[:1])
        sys.stderr.write(f"mavfi: a call of a detector {what}{where}; the flight is repeated without that call\n")


_calls = [_Calls(None, {})]
"""Of this process: the only element."""


def split_again(point: ForkPoint, timeout: float) -> Ended | None:
    """As `ForkPoint.split`; a child that ends in a call is repeated without that call."""
    found: dict[int, str] = {}
    while True:
        parent = _Parent()
        try:
            ended = point.split(timeout, is_overdue=parent.is_overdue)
            if ended is None:
                _calls[:] = [_Calls(parent, found)]
                return None
            number, late = parent.number, parent.is_overdue()
            if ended.how == "done" or not number or (ended.how == "hang" and not late):
                return ended
            how = ended.detail.removeprefix("ended with ").removesuffix(" without a report")
            found[number] = "" if late else how
            parent.tell(f"did not return within {LONGEST_S:g} s" if late else f"ended its process, {how}")
        finally:
            if not point.in_child:
                os.close(parent.stack)


def limited(detector: Any, method: str) -> Any:  # noqa: ANN401 - a user's own
    """A method of a detector, with the limit if it, or one of its parts, is not part of mavfi; None = it has none.

    Like a call, it takes the method that the detector has by then.
    """
    if getattr(detector, method, None) is None:
        return None

    def call(*args: Any) -> Any:  # noqa: ANN401
        return getattr(detector, method)(*args)

    return bounded(call) if is_foreign(detector) else call


def bounded(call: Callable[..., Any]) -> Callable[..., Any]:
    """A call with the limit in the main thread; other threads receive no signals."""

    def timed(*args: Any) -> Any:  # noqa: ANN401
        if threading.current_thread() is not threading.main_thread():
            return call(*args)
        _calls[0].begin()
        before = signal.signal(signal.SIGALRM, _stop)
        timer = signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
        _end_hanging()
        try:
            return call(*args)
        finally:
            _calls[0].end()
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
            signal.setitimer(signal.ITIMER_REAL, *timer)
            signal.signal(signal.SIGALRM, before or signal.SIG_DFL)

    return timed


def is_foreign(detector: Any) -> bool:  # noqa: ANN401
    """Whether there is a detector, and it, or one of its parts, is not part of mavfi."""
    own = detector is None or type(detector).__module__.startswith("mavfi.")
    return not own or any(map(is_foreign, getattr(detector, "parts", ())))


def _end_hanging() -> None:
    """Let SIGVTALRM end the process, with the line that called: no handler in Python runs during a compiled call.

    It comes from the parent, or after `LONGEST_S` of user time if that does not repeat flights.
    """
    parent = _calls[0].parent
    file = sys.__stderr__ if parent is None else parent.stack
    if signal.getsignal(signal.SIGVTALRM) is signal.SIG_DFL and file is not None:
        faulthandler.register(signal.SIGVTALRM, file, all_threads=False, chain=True)
    if parent is None:
        signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST_S)


def _stop(number: int, frame: Any) -> None:  # noqa: ANN401
    raise StuckError
