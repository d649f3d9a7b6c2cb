"""MuJoCo's library: its step as a function callable from compiled code, without warnings and without timers."""

import ctypes
from pathlib import Path

import llvmlite.binding as llvm
import mujoco
from numba import types

GRAVITY = 9.80665
"""Standard gravity (m/s^2)."""
_CLOCK = "mavfi_constant_time"
_WARNING_HANDLER_TYPE = ctypes.CFUNCTYPE(None, ctypes.c_char_p)


@_WARNING_HANDLER_TYPE
def _say_nothing(_text: bytes) -> None:
    """Replaces MuJoCo's own handler, which writes a file."""


def _load_library() -> ctypes.CDLL:
    folder = Path(mujoco.__file__).parent
    path = next(file for file in sorted(folder.iterdir()) if file.name.startswith("libmujoco."))
    return ctypes.CDLL(str(path))


_LIBRARY = _load_library()


def keep_quiet() -> None:
    """Suppress MuJoCo's warnings on screen and disk: MjData counts them, and `Simulator.warnings` reports them."""
    ctypes.c_void_p.in_dll(_LIBRARY, "mju_user_warning").value = ctypes.cast(_say_nothing, ctypes.c_void_p).value


def _stop_timers() -> llvm.ExecutionEngine:
    """Replace the clock of MuJoCo's timers, which nobody reads, by a constant: it takes a share of every step.

    Returns:
        The owner of the new clock's code.
    """
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine()
    code = llvm.parse_assembly(f"define double @{_CLOCK}() {{ ret double 0.0 }}")
    engine = llvm.create_mcjit_compiler(code, machine)
    engine.finalize_object()
    ctypes.c_void_p.in_dll(_LIBRARY, "mjcb_time").value = engine.get_function_address(_CLOCK)
    return engine


keep_quiet()
_TIMERS = _stop_timers()
llvm.add_symbol("mj_step", ctypes.cast(_LIBRARY.mj_step, ctypes.c_void_p).value)

mj_step = types.ExternalFunction("mj_step", types.void(types.intp, types.intp))
"""MuJoCo's step for compiled code: takes the addresses of MjModel and MjData.

Resolved by symbol instead of a ctypes object, so that calling code can be cached on disk.
"""
