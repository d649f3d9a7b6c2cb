"""Machine code of a module, plain or protected, as a function of Python."""

import ctypes
from typing import Any

import llvmlite.binding as llvm

from mavfi.ir.build import Source, target_machine, translate
from mavfi.ir.module import Module

_CALL = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p)


class Compiled:
    """A function of one signature; call it with arguments of these types only.

    A protected one that detects a difference raises a SystemError, with arguments as far as it has changed them.

    Args:
        source: The function.
        text: IR of a variant of its module.
        environment: Numba's environment of the function, which the code points to.
    """

    def __init__(self, source: Source, text: str, environment: Any) -> None:
        self._environment = environment
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), target_machine())
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(translate(text)))
        self._engine.finalize_object()
        place = self._engine.get_global_value_address(source.environment)
        if place:
            ctypes.c_void_p.from_address(place).value = id(environment)
        self._function = _CALL(self._engine.get_function_address(source.wrapper))

    def __call__(self, *args: Any) -> Any:
        """Call it; modifies the arguments as the function does."""
        return self._function(None, args, None)

    def address(self, name: str) -> int:
        """Address of a function of the code, named as in the IR."""
        return int(self._engine.get_function_address(name[1:].strip('"')))

    def word(self, name: str) -> ctypes.c_int64:
        """A global 64-bit integer of the code."""
        return ctypes.c_int64.from_address(self._engine.get_global_value_address(name))


def text_of(module: Module) -> str:
    """IR of a module, without its metadata."""
    return "\n".join([*module.preamble, *(function.text() for function in module.functions), *module.others, ""])
