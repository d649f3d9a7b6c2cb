"""IR of a kernel from Numba, and machine code from IR.

Both are made in a process of their own, since LLVM aborts on a malformed module.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import llvmlite.binding as llvm

from mavfi.errors import BadInputError
from mavfi.ir.forked import run_in_child
from mavfi.ir.fresh import run_fresh
from mavfi.ir.module import BuildError, Module, NotInstrumentableError
from mavfi.numerics.jit import uncached_copy

_PATIENCE_S = 600.0
"""Time limit of a compilation."""
# First byte of an answer of the other process.
_BUILT = b"B"
"""The machine code follows."""
_NOT_INSTRUMENTABLE = b"R"
"""The text of a NotInstrumentableError follows."""
_BAD_INPUT = b"I"
"""The text of a BadInputError follows."""
_CALL = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p)
"""Type of Numba's wrapper of a function: environment or self, arguments, keywords."""
_OPTIMISATION = 3
"""Optimisation level of code generation, as Numba's."""


class Rewrite(Protocol):
    """A transformation of a module, which can be sent to another process; `key` identifies it in caches."""

    @property
    def key(self) -> bytes:
        """Bytes that identify the transformation in caches."""

    def __call__(self, module: Module) -> Module:
        """The transformed module, e.g. with protection; a BadInputError if it was made for another module."""


Rewriting = Callable[[str, tuple[Any, ...]], Rewrite | None]
"""The transformation of a kernel (module and name) for a signature; None = its code is plain."""
Make = Callable[[Any, tuple[Any, ...]], bytes]
"""Rewrites and translates a kernel for a signature; a function of a module, so that a fresh process finds it."""


@dataclass(frozen=True, slots=True)
class KernelSource:
    """A kernel compiled by Numba for one signature.

    Attributes:
        kernel: Module and name.
        text: IR of its module, after all optimisation.
        wrapper: The function that Python calls.
        environment: The global that points to Numba's environment of the kernel.
    """

    kernel: str
    text: str
    wrapper: str
    environment: str


def name_of(kernel: Any) -> str:
    """Module and name of a kernel."""
    return f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"


def check(kernel: Any) -> None:
    """Raise a NotInstrumentableError if it is not compiled, or compiled with flags that prevent exact replay."""
    flags = getattr(kernel, "targetoptions", None)
    if flags is None or not hasattr(kernel, "inspect_llvm"):
        raise NotInstrumentableError(
            getattr(kernel, "__name__", repr(kernel)), "it is not a function compiled by kernel_jit"
        )
    for flag in ("fastmath", "parallel", "forceobj"):
        if flags.get(flag):
            raise NotInstrumentableError(name_of(kernel), f"{flag}={flags[flag]!r}")


def run_in_fresh_process(kernel: Any, signature: tuple[Any, ...], make: Make) -> bytes:
    """Result of `make` for a kernel and signature (Numba types of the arguments), from a fresh process if possible.

    Raises:
        NotInstrumentableError: `make` met an unknown construct.
        BadInputError: `make` does not fit the kernel.
        BuildError: The compiler crashed.
    """
    check(kernel)
    work = partial(make_or_refuse, make)
    end = run_fresh(kernel, signature, work, _PATIENCE_S)
    if end is None:
        end = run_in_child(lambda: work(kernel, signature), _PATIENCE_S)
    if end.how != "done":
        raise BuildError(f"{name_of(kernel)}: the compiler ended with {end.detail}")
    kind = end.payload[:1]
    content = end.payload[1:]
    if kind == _NOT_INSTRUMENTABLE:
        raise NotInstrumentableError(name_of(kernel), content.decode())
    if kind == _BAD_INPUT:
        raise BadInputError(content.decode())
    return content


def make_or_refuse(make: Make, kernel: Any, signature: tuple[Any, ...]) -> bytes:
    """The part of `run_in_fresh_process` that runs in another process: the result of `make`, or why there is none."""
    try:
        return _BUILT + make(kernel, signature)
    except NotInstrumentableError as error:
        return _NOT_INSTRUMENTABLE + error.construct.encode()
    except BadInputError as error:
        return _BAD_INPUT + str(error).encode()


def source_of(kernel: Any, signature: tuple[Any, ...]) -> KernelSource:
    """Recompile a kernel in this process, since code loaded from a cache has no IR."""
    copy = uncached_copy(kernel)
    copy.compile(signature)
    names = copy.overloads[signature].fndesc
    return KernelSource(name_of(kernel), copy.inspect_llvm(signature), names.llvm_cpython_wrapper_name, names.env_name)


def environment_of(kernel: Any, signature: tuple[Any, ...]) -> Any:
    """Numba's environment of a kernel, to which its machine code points."""
    kernel.compile(signature)
    return kernel.overloads[signature].environment


def target_machine() -> Any:
    """A generic x86-64 CPU, for the same code everywhere."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_triple(llvm.get_process_triple())
    return target.create_target_machine(
        cpu="generic",
        features="",
        opt=_OPTIMISATION,
        reloc="static",
        codemodel="jitdefault",
        jit=True,
    )


def load_code(code: bytes, wrapper: str, environment_name: str, environment: Any) -> tuple[Any, Any]:
    """Load an object file into this process.

    Args:
        code: The object file.
        wrapper: The function that Python calls.
        environment_name: The global that points to Numba's environment of the kernel.
        environment: See `environment_of`; it must live as long as the code.

    Returns:
        The engine, which owns the code, and the function: called with None, a tuple of arguments, None.
    """
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), target_machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    environment_pointer = engine.get_global_value_address(environment_name)
    if environment_pointer:
        ctypes.c_void_p.from_address(environment_pointer).value = id(environment)
    return engine, _CALL(engine.get_function_address(wrapper))


def translate(text: str, prepare: Callable[[Any, Any], Any] = lambda module, machine: module) -> bytes:
    """Compile IR, after `prepare`, to an object file; malformed IR is a RuntimeError unless LLVM aborts."""
    module = llvm.parse_assembly(text)
    machine = target_machine()
    module.verify()
    return bytes(machine.emit_object(prepare(module, machine)))
