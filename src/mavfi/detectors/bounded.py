"""A time limit on calls of detectors that are not part of mavfi: one that never returns must not block a flight.

Such a flight depends on the wall clock, like one whose forked kernel or ROS node hangs; without the limit it would not
end.  Compiled code cannot be stopped: it ends the process, after twice that time, with the line of the detector that
called it.  A campaign continues without the worker.
"""

import faulthandler
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any

LIMIT_S = 60.0
"""Wall time of a call (s), as on ROS."""


class StuckError(BaseException):
    """A call did not return in time; not an `Exception`, since the code called may handle those."""


def limited(detector: Any, method: str) -> Any:  # noqa: ANN401 - a user's own
    """A method of a detector, with the limit if it, or one of its parts, is not part of mavfi; None = it has none.

    Like a call, it takes the method that the detector has by then.
    """
    if getattr(detector, method, None) is None:
        return None

    def call(*args: Any) -> Any:  # noqa: ANN401
        return getattr(detector, method)(*args)

    return bounded(call) if _is_foreign(detector) else call


def bounded(call: Callable[..., Any]) -> Callable[..., Any]:
    """A call with the limit in the main thread; other threads receive no signals.

    The limit stops Python code and system calls; in compiled code SIGVTALRM ends the process after twice the limit.
    """

    def timed(*args: Any) -> Any:  # noqa: ANN401
        if threading.current_thread() is not threading.main_thread():
            return call(*args)
        before = signal.signal(signal.SIGALRM, _stop)
        timer = signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
        _end_hanging()
        try:
            return call(*args)
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
            signal.setitimer(signal.ITIMER_REAL, *timer)
            signal.signal(signal.SIGALRM, before or signal.SIG_DFL)

    return timed


def _end_hanging() -> None:
    """Let the process end after twice the limit in user time: no handler in Python runs during a compiled call."""
    if signal.getsignal(signal.SIGVTALRM) is signal.SIG_DFL and sys.__stderr__ is not None:
        faulthandler.register(signal.SIGVTALRM, sys.__stderr__, all_threads=False, chain=True)
    signal.setitimer(signal.ITIMER_VIRTUAL, 2.0 * LIMIT_S)


def _is_foreign(detector: Any) -> bool:  # noqa: ANN401
    own = type(detector).__module__.startswith("mavfi.")
    return not own or any(map(_is_foreign, getattr(detector, "parts", ())))


def _stop(number: int, frame: Any) -> None:  # noqa: ANN401
    raise StuckError
