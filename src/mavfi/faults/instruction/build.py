"""Builds the instrumented variant of a kernel, in a child process since LLVM aborts on a malformed module."""

import json
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import llvmlite.binding as llvm

from mavfi.faults.instruction.accesses import Constant
from mavfi.faults.instruction.forked import run_in_child
from mavfi.faults.instruction.fresh import run_fresh
from mavfi.faults.instruction.instrument import Instrumented, instrument
from mavfi.faults.instruction.refusal import BuildError, RefusedError
from mavfi.faults.instruction.table import Table
from mavfi.faults.instruction.tally import optimised
from mavfi.numerics.jit import uncached_copy

_PATIENCE = 600.0
_OPTIMISATION = 3
"""Optimisation level of code generation, as Numba's."""


@dataclass(frozen=True, slots=True)
class Built:
    """An instrumented kernel: object files, and the other attributes as in `Instrumented`.

    Python calls the function `wrapper`; the global `environment` points to Numba's environment of the kernel.
    """

    code: bytes
    tally: bytes
    table: Table
    ir_sha256: str
    constants: tuple[Constant, ...]
    owned: bool
    wrapper: str
    environment: str

    def pack(self) -> bytes:
        """Serialize to bytes."""
        constants = [[constant.name, constant.address, constant.size] for constant in self.constants]
        facts = [self.table.to_json(), self.ir_sha256, constants, self.owned, self.wrapper, self.environment]
        head = zlib.compress(json.dumps(facts).encode(), 1)
        return b"".join(len(part).to_bytes(8, "little") + part for part in (head, self.tally, self.code))

    @staticmethod
    def unpack(data: bytes) -> "Built":
        """Inverse of `pack`."""
        parts = []
        while data:
            size = 8 + int.from_bytes(data[:8], "little")
            parts.append(data[8:size])
            data = data[size:]
        head, tally, code = parts
        rows, digest, constants, *others = json.loads(zlib.decompress(head))
        placed = tuple(Constant(*constant) for constant in constants)
        return Built(code, tally, Table.from_json(rows), digest, placed, *others)


def name_of(kernel: Any) -> str:
    """Module and name of a kernel."""
    return f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"


def check(kernel: Any) -> None:
    """Raise a RefusedError if it is not compiled, or compiled with flags that prevent exact replay."""
    flags = getattr(kernel, "targetoptions", None)
    if flags is None or not hasattr(kernel, "inspect_llvm"):
        raise RefusedError(getattr(kernel, "__name__", repr(kernel)), "it is not a function compiled by kernel_jit")
    for flag in ("fastmath", "parallel", "forceobj"):
        if flags.get(flag):
            raise RefusedError(name_of(kernel), f"{flag}={flags[flag]!r}")


def build(kernel: Any, signature: tuple[Any, ...]) -> Built:
    """Instrument a Numba dispatcher for one signature (Numba types of the arguments).

    Raises a RefusedError for an unknown construct, and a BuildError if the compiler crashes.
    """
    check(kernel)
    ended = run_fresh(kernel, signature, _PATIENCE) or run_in_child(lambda: make(kernel, signature), _PATIENCE)
    if ended.how != "done":
        raise BuildError(f"{name_of(kernel)}: the compiler ended with {ended.detail}")
    if ended.payload[:1] == b"R":
        raise RefusedError(name_of(kernel), ended.payload[1:].decode())
    return Built.unpack(ended.payload[1:])


def make(kernel: Any, signature: tuple[Any, ...]) -> bytes:
    """The part of `build` that runs in another process, since LLVM aborts on a malformed module."""
    try:
        return b"B" + assemble(*prepare(kernel, signature)).pack()
    except RefusedError as error:
        return b"R" + error.construct.encode()


def prepare(kernel: Any, signature: tuple[Any, ...]) -> tuple[Instrumented, str, str]:
    """Recompile a kernel in this process and instrument its IR; also returns the names of wrapper and environment."""
    copy = uncached_copy(kernel)
    copy.compile(signature)
    names = copy.overloads[signature].fndesc
    made = instrument(copy.inspect_llvm(signature), name_of(kernel))
    return made, names.llvm_cpython_wrapper_name, names.env_name


def assemble(made: Instrumented, wrapper: str, environment: str) -> Built:
    """Translate instrumented IR into machine code."""
    code, tally = translate(made.text), translate(made.tally, optimised)
    return Built(code, tally, made.table, made.ir_sha256, made.constants, made.owned, wrapper, environment)


def target_machine() -> Any:
    """A generic x86-64 CPU, for the same code everywhere."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_triple(llvm.get_process_triple())
    return target.create_target_machine(
        cpu="generic", features="", opt=_OPTIMISATION, reloc="static", codemodel="jitdefault", jit=True,
    )  # fmt: skip


def translate(text: str, prepare: Callable[[Any, Any], Any] = lambda module, machine: module) -> bytes:
    """Compile IR, after `prepare`, to an object file; malformed IR is a RuntimeError unless LLVM aborts."""
    module, machine = llvm.parse_assembly(text), target_machine()
    module.verify()
    return bytes(machine.emit_object(prepare(module, machine)))
