"""Machine code of a module, plain or protected, as a function of Python."""

import ctypes
from typing import Any

from mavfi.ir.build import Source, load_code
from mavfi.ir.module import Module


class Compiled:
    """A function of one signature; call it with arguments of these types only.

    A protected one that detects a difference raises a SystemError, with arguments as far as it has changed them.

    Args:
        source: The function.
        code: Machine code of a variant of its module, see `mavfi.ir.build.translate`.
        environment: Numba's environment of the function, which the code points to.
    """

    def __init__(self, source: Source, code: bytes, environment: Any) -> None:
        self._environment = environment
        self._engine, self._function = load_code(code, source.wrapper, source.environment, environment)

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
