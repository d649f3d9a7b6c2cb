"""MuJoCo's library: its step as a function that compiled code can call, and its warnings kept off the screen."""

import ctypes
from pathlib import Path

import llvmlite.binding
import mujoco
from numba import types

GRAVITY = 9.80665
"""Standard gravity (m/s^2)."""
_WARNING_HANDLER_TYPE = ctypes.CFUNCTYPE(None, ctypes.c_char_p)


@_WARNING_HANDLER_TYPE
def _say_nothing(_text: bytes) -> None:
    """Instead of MuJoCo's own handler, which writes a file."""


def _load_library() -> ctypes.CDLL:
    folder = Path(mujoco.__file__).parent
    path = next(file for file in sorted(folder.iterdir()) if file.name.startswith("libmujoco."))
    return ctypes.CDLL(str(path))


_LIBRARY = _load_library()


def keep_quiet() -> None:
    """Take MuJoCo's warnings off screen and disk: it counts them in MjData, which `Simulator.warnings` reports."""
    ctypes.c_void_p.in_dll(_LIBRARY, "mju_user_warning").value = ctypes.cast(_say_nothing, ctypes.c_void_p).value


keep_quiet()
llvmlite.binding.add_symbol("mj_step", ctypes.cast(_LIBRARY.mj_step, ctypes.c_void_p).value)

mj_step = types.ExternalFunction("mj_step", types.void(types.intp, types.intp))
"""MuJoCo's step for compiled code: takes the addresses of MjModel and MjData.

Found by symbol and not through a ctypes object, so that code which calls it can be cached on disk.
"""
