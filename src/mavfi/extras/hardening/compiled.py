"""Machine code of a module, plain or protected, and its time.

Instructions are a poor guide to time: latency-bound code has free slots for shadows, throughput-bound code has none.
Variants are timed by the processor's time stamp counter within the machine code, in turn, and compared within rounds,
so that a slow phase of the machine affects all of them.  It does not affect them alike: another program on the
same core takes the free slots that shadows need
(`time_to_collision` in full takes x1.25 alone, up to x1.37 on a shared core), so the fastest rounds count.
"""

import ctypes
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np

from mavfi.extras.hardening.duplicate import callees
from mavfi.ir.build import KernelSource, load_code, translate
from mavfi.ir.module import Module

_NUMBA_PREFIX = "_ZN5numba"
"""Start of the names of Numba's own functions; not inlined, since most compose messages of exceptions, and take long to
translate."""


def text_of(module: Module) -> str:
    """IR of a module, without its metadata."""
    return "\n".join([*module.preamble, *(function.text() for function in module.functions), *module.others, ""])


def code_of(module: Module) -> bytes:
    """Machine code of a module; in protected code, functions that others call are inlined.

    Calls with many arguments take time, which pays for a part of the shadows.  After inlining, results of calls are put
    into registers and loops are tested at their end.  Other passes are not run: they might take a shadow for its
    original where both have been compared, or compute both by one instruction.  None is run on plain code.
    """
    text = text_of(module)
    blocks = (block for function in module.functions for block in function.blocks)
    if not any(instruction.role for block in blocks for instruction in block.body):
        return translate(text)
    defined = {_llvm_name(function.name) for function in module.functions}
    called = {_llvm_name(name) for function in module.functions for name in callees(function)}
    inlinable = {name for name in defined & called if not name.startswith(_NUMBA_PREFIX)}
    return translate(text, partial(inlined, names=inlinable))


def _llvm_name(name: str) -> str:
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


# ---- arguments ------------------------------------------------------------------------------------------------------


def copied(value: Any) -> Any:  # noqa: ANN401 - numbers, arrays and tuples of these
    """A deep copy; arrays keep strides, access and common memory, since Numba compiles by these."""
    return _copy(value, {})


def _copy(value: Any, memories: dict[int, tuple[int, np.ndarray]]) -> Any:
    """A deep copy; `memories` has the lowest address and the copy of each array that owns memory, by its id."""
    if isinstance(value, tuple):
        parts = [_copy(part, memories) for part in value]
        if hasattr(value, "_fields"):
            return type(value)(*parts)
        return tuple(parts)
    if not isinstance(value, np.ndarray) or value.dtype.hasobject:
        return value
    # Views of one array stay views of one copy.
    root = value
    while isinstance(root.base, np.ndarray):
        root = root.base
    if id(root) not in memories:
        memories[id(root)] = _memory(root)
    start, memory = memories[id(root)]
    moved: np.ndarray = np.ndarray(value.shape, value.dtype, memory.data, value.ctypes.data - start, value.strides)
    moved.flags.writeable = value.flags.writeable
    return moved


def _memory(root: np.ndarray) -> tuple[int, np.ndarray]:
    """Lowest address of an array, and a copy of its memory."""
    if not root.size:
        return root.ctypes.data, np.empty(1, np.uint8)
    low, high = np.lib.array_utils.byte_bounds(root)
    memory = np.empty(high - low, np.uint8)
    ctypes.memmove(memory.ctypes.data, low, high - low)
    return low, memory


# ---- time -----------------------------------------------------------------------------------------------------------

_REPETITIONS = "mavfi_repetitions"
_TICKS = "mavfi_ticks"
_MIN_LOOP_TICKS = 60_000
"""Ticks of a measured loop (about 20 us), far more than those of reading the counter."""
_MAX_REPETITIONS = 200
_SHORT_CALL = 3_000_000
"""Ticks of a call (about 1 ms) that fills the caches in a small part of its time."""
_WARM_UP_CALLS = 2
"""Calls before that of a short one that is timed: after one, `plan_rrt_connect` takes x1.22, not x1.18 (Intel)."""
_MIN_ROUNDS = 9
_QUIET_SHARE = 0.25
_MIN_QUIET = 3
"""Share of a call's rounds that count, the fastest ones, and their smallest number."""


class Timing(NamedTuple):
    """Time of variants of a function over recorded calls.

    Attributes:
        ratios: Time of each variant / time of plain code, over all recorded calls: mean of the ratios of calls, each a
            median over its fastest rounds, weighted by the time of plain code.
        ticks: Ticks of the time stamp counter per plain call: mean over the recorded calls.
    """

    ratios: dict[str, float]
    ticks: float


class Timed:
    """Machine code of a variant of a function, run many times within one call from Python.

    Args:
        source: The function.
        module: A variant of its module.
        environment: Numba's environment of the function, to which the code points.
    """

    def __init__(self, source: KernelSource, module: Module, environment: Any) -> None:
        self._environment = environment  # lives as long as the code
        code = code_of(with_loop(module, source.wrapper))
        self._engine, self._function = load_code(code, source.wrapper, source.environment, environment)
        self._repetitions = self._global(_REPETITIONS)
        self._ticks = self._global(_TICKS)

    def _global(self, name: str) -> ctypes.c_int64:
        return ctypes.c_int64.from_address(self._engine.get_global_value_address(name))

    def ticks(self, args: tuple[Any, ...], repetitions: int) -> float:
        """Ticks per repetition of a call; modifies the arguments as so many calls do."""
        self._repetitions.value = repetitions
        self._function(None, args, None)
        return self._ticks.value / repetitions


def with_loop(module: Module, wrapper: str) -> Module:
    """A module whose wrapper calls the kernel in a loop, and stores the ticks of the time stamp counter."""
    # The wrapper is outside the fault space, so it is kept as text.  It calls the loop instead of the kernel.
    others = list(module.others)
    number = next(number for number, text in enumerate(others) if wrapper in text.split("\n", 1)[0])
    for kernel in module.functions:
        call = re.compile(rf"{re.escape(kernel.name)} ?\(")
        if call.search(others[number]):
            break
    others[number] = call.sub("@mavfi_loop(", others[number])

    # The counter is read outside the loop, so that short calls are timed as well.
    typed = ", ".join(f"{kind} {parameter}" for kind, parameter in kernel.parameters)
    loop = f"""
@{_REPETITIONS} = global i64 1
@{_TICKS} = global i64 0
declare i64 @llvm.readcyclecounter()
define internal i32 @mavfi_loop({typed}) noinline {{
mavfi.entry:
  %mavfi.n = load volatile i64, ptr @{_REPETITIONS}
  %mavfi.start = call i64 @llvm.readcyclecounter()
  br label %mavfi.loop
mavfi.loop:
  %mavfi.i = phi i64 [ 0, %mavfi.entry ], [ %mavfi.next, %mavfi.loop ]
  %mavfi.status = call i32 {kernel.name}({typed})
  %mavfi.next = add i64 %mavfi.i, 1
  %mavfi.more = icmp ult i64 %mavfi.next, %mavfi.n
  br i1 %mavfi.more, label %mavfi.loop, label %mavfi.done
mavfi.done:
  %mavfi.end = call i64 @llvm.readcyclecounter()
  %mavfi.ticks = sub i64 %mavfi.end, %mavfi.start
  store volatile i64 %mavfi.ticks, ptr @{_TICKS}
  ret i32 %mavfi.status
}}
"""
    return replace(module, others=[*others, loop])


Clock = Callable[[tuple[Any, ...], int], float]
"""Ticks per repetition of a call, as `Timed.ticks`."""


def compare(
    plain: Clock, variants: Mapping[str, Clock], calls: Sequence[tuple[Any, ...]], enough: Callable[[int], bool]
) -> Timing:
    """Time variants in turn on recorded calls, one call per round, until `enough` says so of the number of rounds.

    The order of the variants changes from round to round; each runs on a copy of the arguments.  A short call follows
    others that are not timed: between so many variants the caches hold none of its code.
    """
    clocks = {"": plain, **variants}
    names = list(clocks)

    # 1. How long does a call take?  Short ones are repeated, and follow calls that are not timed.
    call_ticks = min(plain(copied(calls[0]), 1) for _ in range(3))
    repetitions = int(np.clip(_MIN_LOOP_TICKS / max(call_ticks, 1.0), 1, _MAX_REPETITIONS))
    warm_up_calls = 0
    if call_ticks < _SHORT_CALL:
        warm_up_calls = _WARM_UP_CALLS

    def timed(clock: Clock, args: tuple[Any, ...]) -> float:
        for _ in range(warm_up_calls):
            clock(copied(args), 1)
        return clock(copied(args), repetitions)

    # 2. Rounds, each with one call and another order of the variants; the ticks of each variant, by its name.
    rounds: list[dict[str, float]] = []
    while len(rounds) < max(_MIN_ROUNDS, len(calls)) or not enough(len(rounds)):
        start = len(rounds) % len(names)
        args = calls[len(rounds) % len(calls)]
        rounds.append({name: timed(clocks[name], args) for name in names[start:] + names[:start]})

    # 3. Medians over the fastest rounds of each call, and over all calls their mean, weighted by plain time.
    plain_ticks = []
    medians: dict[str, list[np.floating[Any]]] = {name: [] for name in variants}
    for index in range(len(calls)):
        call_rounds = quiet(rounds[index :: len(calls)])
        plain_ticks.append(np.median([ticks[""] for ticks in call_rounds]))
        for name in variants:
            medians[name].append(np.median([ticks[name] / ticks[""] for ticks in call_rounds]))
    ratios = {name: float(np.average(medians[name], weights=plain_ticks)) for name in variants}
    return Timing(ratios, float(np.mean(plain_ticks)))


def quiet(rounds: Sequence[Mapping[str, float]]) -> list[Mapping[str, float]]:
    """The fastest rounds of a call by the time of all variants together, which prefers none of them."""
    count = max(_MIN_QUIET, math.ceil(_QUIET_SHARE * len(rounds)))
    return sorted(rounds, key=lambda ticks: sum(ticks.values()))[:count]
