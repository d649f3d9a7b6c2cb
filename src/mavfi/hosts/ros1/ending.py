"""How a node ends when its code fails: at once, so that roslaunch starts it anew and the world takes note.

rospy catches what callbacks and services raise, writes a line, and goes on with a value that is lost.
"""

import os
import sys
import traceback
from collections.abc import Callable
from typing import NoReturn, TypeVar

_Given = TypeVar("_Given")
_Answer = TypeVar("_Answer")


def die() -> NoReturn:
    """End this process, with the exception that is being handled in the log."""
    traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(1)


def fatal(callback: Callable[[_Given], _Answer]) -> Callable[[_Given], _Answer]:
    """The same callback, but an exception ends the process."""

    def guarded(given: _Given) -> _Answer:
        try:
            return callback(given)
        except Exception:  # whatever it is
            die()

    return guarded
