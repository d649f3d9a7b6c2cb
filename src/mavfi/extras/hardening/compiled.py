"""Machine code of a module, plain or protected, as a function of Python."""

import ctypes
from collections.abc import Collection
from functools import partial
from typing import Any

import llvmlite.binding as llvm

from mavfi.extras.hardening.candidates import callees
from mavfi.ir.build import Rewrite, Source, environment_of, load_code, translate
from mavfi.ir.module import Function, Module
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source

_LIBRARY = "_ZN5numba"
"""Start of the names of Numba's own functions; not inlined, since most compose messages of exceptions, and take long to
translate."""


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


def code_of(module: Module, text: str) -> bytes:
    """Machine code of a module; in protected code, functions that others call are inlined.

    Calls with many arguments take time, which pays for a part of the shadows.  After inlining, results of calls are put
    into registers and loops are tested at their end.  Other passes are not run: they might take a shadow for its
    original where both have been compared, or compute both by one instruction.  None is run on plain code.

    Args:
        module: The module.
        text: Its IR, see `text_of`, with additions.
    """
    if not any(one.role for function in module.functions for block in function.blocks for one in block.body):
        return translate(text)
    own = {name for function in module.functions if not (name := _plain(function.name)).startswith(_LIBRARY)}
    called = set().union(*map(callees, module.functions))
    return translate(text, partial(inlined, names=own & set(map(_plain, called))))


def _plain(name: str) -> str:
    """Name of a function as LLVM has it, without the sigil and quotation marks of the IR."""
    return name[1:].strip('"')


def inlined(module: Any, machine: Any, names: Collection[str]) -> Any:
    """A module of LLVM in which the named functions are inlined."""
    for function in module.functions:
        if function.name in names:
            function.add_function_attribute("alwaysinline")
    passes = llvm.create_new_module_pass_manager()
    passes.add_always_inliner_pass()
    passes.add_sroa_pass()
    passes.add_loop_rotate_pass()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    return module


def compiled(function: Any, signature: tuple[Any, ...], rewrite: Rewrite | None = None) -> tuple[Compiled, int]:
    """Machine code of a function for any x86-64 processor, and the address at which it starts.

    Args:
        function: Compiled by `kernel_jit`.
        signature: Numba types of its arguments.
        rewrite: Its protection; None = plain code.

    Raises:
        BadInputError: The protection was made for other code.
    """
    source = cached_source(function, signature)
    module = parse_module(source.text, source.kernel)
    if rewrite is not None:
        module = rewrite(module)
    code = Compiled(source, code_of(module, text_of(module)), environment_of(function, signature))
    return code, code.address(main_function(module, source.wrapper).name)


def main_function(module: Module, wrapper: str) -> Function:
    """The function that a wrapper calls.

    Raises:
        ValueError: It calls none of the module's functions.
    """
    for text in module.others:
        if wrapper in text.split("\n", 1)[0]:
            for function in module.functions:
                if f"{function.name} (" in text or f"{function.name}(" in text:
                    return function
    raise ValueError(f"{wrapper}: calls no function of its module")
