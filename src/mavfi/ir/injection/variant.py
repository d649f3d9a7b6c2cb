"""The instrumented variant of one signature of a kernel, in memory: its modes, and the report of an injection.

A variant has one control block, and all variants share one arena: not for several threads at once.
"""

import ctypes
import mmap
import os
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numba
import numpy as np

from mavfi.errors import MavfiError
from mavfi.ir.build import Rewrite, Rewriting, check, environment_of, load_code, name_of
from mavfi.ir.injection.arena import FRAMES, arena, copy_result
from mavfi.ir.injection.build import Built, cached_build
from mavfi.ir.injection.instrument import HISTOGRAM
from mavfi.ir.injection.runtime import (
    MASK_BYTES,
    NEVER,
    REPORT_BYTES,
    REPORT_WORDS,
    WORDS,
    ControlWord,
    RunMode,
)
from mavfi.ir.injection.table import InjectionSite, SiteTable


@dataclass(frozen=True, slots=True)
class InjectionReport:
    """Report of an injection.

    Attributes:
        site: The static instruction.
        before: The bits of its result, as an integer.
        after: The bits of the injected value.
        planned: Whether the call used memory at planned addresses only: then its effect is the same everywhere.
    """

    site: InjectionSite
    before: int
    after: int
    planned: bool


def changed_nothing(report: InjectionReport | None) -> bool:
    """Whether nothing changed: the index was not reached, or its value has no such bit."""
    return report is None or not (report.before ^ report.after) & ((1 << report.site.width) - 1)


class BlockProfile(NamedTuple):
    """Block executions of a call.

    Attributes:
        result: Result of the call.
        histogram: Execution counts of blocks. Shape (blocks,).
        trace: The first blocks in order. Shape (n,).
    """

    result: Any
    histogram: np.ndarray
    trace: np.ndarray


@dataclass(frozen=True, slots=True)
class _TallyCode:
    """Machine code that counts block executions only: the engine that owns it, and where it finds its histogram."""

    engine: Any
    function: Any
    histogram_address: ctypes.c_void_p


class Variant:
    """Instrumented machine code of a kernel, which modifies its arguments as the kernel does.

    Attributes:
        table: The static instructions.
        sizes: Number of sites of each block. Shape (blocks,).
        ir_sha256: Digest of the IR.
    """

    def __init__(self, built: Built, environment: Any) -> None:
        """Load the machine code.

        Args:
            built: The machine code.
            environment: Numba's environment of the kernel.
        """
        self.table: SiteTable = built.table
        self.sizes = np.array(built.table.sizes(), np.int64)
        self.ir_sha256 = built.ir_sha256
        self._built = built
        self._environment = environment  # kept alive: the code points to it
        self._engine, self._function = self._load(built.code)
        self._tally: _TallyCode | None = None
        # Map the globals of the machine code.
        self._control = self._array("mavfi_control", ctypes.c_int64, WORDS)
        self._keep = self._array("mavfi_keep", ctypes.c_uint8, MASK_BYTES)
        self._flip = self._array("mavfi_flip", ctypes.c_uint8, MASK_BYTES)
        arena()  # mapped now: the code uses its addresses
        self._owned = built.owned
        self._constants = [
            (constant.address, self._engine.get_global_value_address(_linker_name(constant.name)), constant.size)
            for constant in built.constants
        ]
        self._reader_pid = -1
        self.claim_report()
        self._control[ControlWord.STOP] = ctypes.cast(ctypes.CDLL(None)._exit, ctypes.c_void_p).value or 0
        self._set(RunMode.INJECT, NEVER)

    def _load(self, code: bytes) -> tuple[Any, Any]:
        """Engine of an object file, and its function."""
        return load_code(code, self._built.wrapper, self._built.environment, self._environment)

    def claim_report(self) -> None:
        """Direct reports of later injections to this process; called by the reading process before it forks.

        Forks share the memory, so that it survives a crashed child: two workers must not use their parent's report.
        """
        if self._reader_pid == os.getpid():
            return
        self._reader_pid = os.getpid()
        report = np.frombuffer(mmap.mmap(-1, REPORT_BYTES), np.uint8)
        self._injected = report[: 8 * REPORT_WORDS].view(np.int64)
        self._values = report[8 * REPORT_WORDS :]
        self._control[ControlWord.REPORT] = report.ctypes.data

    def _array(self, name: str, kind: Any, count: int) -> np.ndarray:
        """A global of the machine code."""
        return np.ctypeslib.as_array((kind * count).from_address(self._engine.get_global_value_address(name)))

    def _set(self, mode: RunMode, threshold: int) -> None:
        """Prepare a run: counter, stack and constants as at the start of a call."""
        control = self._control
        control[ControlWord.COUNTER] = 0
        control[ControlWord.INJECTED] = 0
        control[ControlWord.PLANNED] = 0
        control[ControlWord.FRAME] = FRAMES
        for target, source, size in self._constants:
            ctypes.memmove(target, source, size)
        control[ControlWord.MODE] = mode
        control[ControlWord.THRESHOLD] = threshold

    def _run(self, mode: RunMode, threshold: int, args: tuple[Any, ...], **words: int) -> Any:
        """Run with the given words of the control block."""
        self._set(mode, threshold)
        for name, word in words.items():
            self._control[ControlWord[name]] = word
        try:
            return self._function(None, args, None)
        finally:
            self._set(RunMode.INJECT, NEVER)

    def count(self, *args: Any) -> tuple[Any, int]:
        """Run without a fault; returns the result and the number of values written."""
        self._set(RunMode.INJECT, NEVER)
        result = self._function(None, args, None)
        return result, int(self._control[ControlWord.COUNTER])

    def tally(self, *args: Any) -> tuple[Any, np.ndarray]:
        """Run without a fault; returns the result and execution counts of blocks; faster than `profile`."""
        if self._tally is None:
            engine, function = self._load(self._built.tally)
            address = ctypes.c_void_p.from_address(engine.get_global_value_address(HISTOGRAM))
            self._tally = _TallyCode(engine, function, address)
        histogram = np.zeros(len(self.table.blocks), np.int64)
        self._tally.histogram_address.value = histogram.ctypes.data
        return self._tally.function(None, args, None), histogram

    def written(self, times: np.ndarray) -> int:
        """Number of values written, from the execution count of each block. Shape (blocks,)."""
        return int(times @ self.sizes)

    def profile(self, *args: Any, room: int = 0) -> BlockProfile:
        """Run without a fault, and note at most `room` blocks in the order of their execution."""
        histogram = np.zeros(len(self.table.blocks), np.int64)
        trace = np.zeros(max(room, 1), np.int32)
        result = self._run(
            RunMode.PROFILE,
            0,
            args,
            HISTOGRAM=histogram.ctypes.data,
            TRACE=trace.ctypes.data,
            TRACE_ROOM=room,
            TRACE_LENGTH=0,
        )
        return BlockProfile(result, histogram, trace[: int(self._control[ControlWord.TRACE_LENGTH])])

    def resolve(self, indices: Sequence[int], *args: Any) -> tuple[Any, list[InjectionSite | None]]:
        """Run without a fault; returns the result and the site of each dynamic index, None beyond the last."""
        wanted = np.array(sorted(set(indices)), np.int64)
        blocks = np.full(len(wanted), -1)
        offsets = np.full(len(wanted), -1)
        first = NEVER
        if len(wanted):
            first = int(wanted[0])
        result = self._run(
            RunMode.RESOLVE,
            first,
            args,
            EVENTS=wanted.ctypes.data,
            EVENT_COUNT=len(wanted),
            EVENT_BLOCKS=blocks.ctypes.data,
            EVENT_OFFSETS=offsets.ctypes.data,
            NEXT_EVENT=0,
        )
        sites: dict[int, InjectionSite] = {}
        for index, block, offset in zip(wanted, blocks, offsets, strict=True):
            if block >= 0:
                sites[int(index)] = self.table.blocks[block][offset]
        return result, [sites.get(index) for index in indices]

    def inject(self, index: int, keep: int, flip: int, budget: int, *args: Any) -> Any:
        """Run with one injection: the value at this dynamic index, from 0, becomes (value & keep) ^ flip.

        A kernel that exceeds its budget of values ends the process with status `HANG_EXIT`, one that accesses memory
        that it does not own with `WILD_EXIT`.
        """
        for memory, mask in ((self._keep, keep), (self._flip, flip)):
            memory[:] = np.frombuffer((mask % (1 << 8 * MASK_BYTES)).to_bytes(MASK_BYTES, "little"), np.uint8)
        placed = None
        if self._owned:
            placed = arena().place(args)
        if placed is None:
            return self._inject_unplanned(index, budget, args)
        # With all its memory in the arena, the effect of a corrupted address is the same in every process.
        self._injected[:] = (0, 0, 0, 1)
        words = {"TARGET": index, "BUDGET": budget, "PLANNED": 1, "HEAP": placed.heap}
        try:
            result = copy_result(self._run(RunMode.INJECT, index, placed.args, **words))
        except MemoryError:  # the arena is full, not the machine; the arguments are still those before the call
            if self._fits(args):
                raise AllocationError("an array is too large") from None
            return self._inject_unplanned(index, budget, args)
        except BaseException:
            placed.take_back()
            raise
        placed.take_back()
        return result

    def _inject_unplanned(self, index: int, budget: int, args: tuple[Any, ...]) -> Any:
        """Inject with the memory of the process, where a corrupted address has other effects in another process."""
        self._injected[:] = (0, 0, 0, 0)
        return self._run(RunMode.INJECT, index, args, TARGET=index, BUDGET=budget)

    def _fits(self, args: tuple[Any, ...]) -> bool:
        """Whether the arena has enough memory for a call without a fault; the arguments are not modified."""
        placed = arena().place(args)
        assert placed is not None  # the same arguments fitted before
        report = self._injected.copy()
        try:
            self._run(RunMode.INJECT, NEVER, placed.args, TARGET=NEVER, BUDGET=NEVER, PLANNED=1, HEAP=placed.heap)
        except MemoryError:
            return False
        finally:
            self._injected[:] = report
        return True

    def report(self) -> InjectionReport | None:
        """Report of the last injection, here or in a forked child; None if the index was not reached."""
        injected, block, offset, planned = self._injected.tolist()
        if not injected:
            return None
        site = self.table.blocks[block][offset]
        size = -(-site.width // 8)
        before = self._values[:size]
        after = self._values[MASK_BYTES : MASK_BYTES + size]
        return InjectionReport(
            site,
            int.from_bytes(before.tobytes(), "little"),
            int.from_bytes(after.tobytes(), "little"),
            planned=bool(planned),
        )


def _linker_name(name: str) -> str:
    """The name of a global as used by the linker."""
    return name[1:].strip('"')


# ---- The variants of this process.

_variants: "weakref.WeakKeyDictionary[Any, dict[tuple[Any, ...], Variant]]" = weakref.WeakKeyDictionary()
"""Variants of each kernel, by signature and rewriting."""
_variants_by_key: "weakref.WeakKeyDictionary[Any, dict[Any, Variant]]" = weakref.WeakKeyDictionary()
"""The same by what determines the types of the arguments: hashing Numba types takes longer than a short call."""
_types: dict[Any, Any] = {}
"""Numba types of arguments, by what determines them."""
_INT_LIMIT = 1 << 63
"""Numba types a Python integer as int64 below it, and as uint64 from it on."""


def signature_of(args: tuple[Any, ...]) -> tuple[Any, ...]:
    """Numba types of arguments; cached by what determines them, since Numba derives them again for each call."""
    key = _type_key(args)
    if key is None:
        return tuple(numba.typeof(argument) for argument in args)  # type: ignore[no-untyped-call]
    if key not in _types:
        _types[key] = tuple(numba.typeof(argument) for argument in args)  # type: ignore[no-untyped-call]
    return cast(tuple[Any, ...], _types[key])


def _type_key(value: Any) -> Any:
    """What determines the Numba type of a value; None = unknown."""
    kind = type(value)
    if kind is int and -_INT_LIMIT <= value < _INT_LIMIT:
        return kind
    if kind is np.ndarray:
        return value.dtype, value.ndim, value.flags.num
    if kind in (float, bool):
        return kind
    if isinstance(value, np.generic):
        return kind, value.dtype
    if isinstance(value, tuple):
        parts = tuple(map(_type_key, value))
        if None in parts:
            return None
        return (kind, parts)
    return None


def variant_for(kernel: Any, args: tuple[Any, ...], rewriting: Rewriting | None = None) -> Variant:
    """`variant_of` for the types of these arguments."""
    if rewriting is not None:
        signature = signature_of(args)
        return variant_of(kernel, signature, rewriting(name_of(kernel), signature))
    key = _type_key(args)
    if key is None:
        return variant_of(kernel, signature_of(args))
    variants = _variants_by_key.setdefault(kernel, {})
    if key not in variants:
        variants[key] = variant_of(kernel, signature_of(args))
    return variants[key]


def variant_of(kernel: Any, signature: tuple[Any, ...], rewrite: Rewrite | None = None) -> Variant:
    """The variant for a signature, built or loaded at its first use; a parent process loads it before it forks.

    With `rewrite` it is the variant of the rewritten kernel, e.g. a protected one.

    Raises:
        NotInstrumentableError: The kernel cannot be instrumented exactly.
        BuildError: The compiler crashed.
    """
    check(kernel)
    rewrite_key = b""
    if rewrite is not None:
        rewrite_key = rewrite.key
    variants = _variants.setdefault(kernel, {})
    key = (signature, rewrite_key)
    if key not in variants:
        built = cached_build(kernel, signature, rewrite)
        variants[key] = Variant(built, environment_of(kernel, signature))
    return variants[key]


# ---- Reasons why a fault is not injected: always an error, never a silent omission.


class MismatchError(MavfiError):
    """The fault was drawn for other machine code: other source or compiler."""


class AllocationError(MavfiError):
    """An injected kernel requested more memory than available."""


# ---- Instrumented functions: each replaces a compiled function in a flight, and counts or resolves.
# With `rewriting`, their instructions are those of the rewritten function, e.g. of the protected one.
#
# `plan.choose` draws call and index from the counts of a first flight; a second flight resolves the instructions.


class Profiling:
    """Counts the values that each call of a compiled function writes, and the executions of each static instruction.

    Attributes:
        counts: Number of values, by call.
        digests: Digest of the executed IR, by call.
    """

    def __init__(self, function: Any, rewriting: Rewriting | None = None) -> None:
        self.function = function
        self.rewriting = rewriting
        self.counts: list[int] = []
        self.digests: list[str] = []
        self._times: dict[str, tuple[SiteTable, np.ndarray]] = {}

    def __call__(self, *args: Any) -> Any:
        """Call the function; bit-identical result."""
        variant = variant_for(self.function, args, self.rewriting)
        result, times = variant.tally(*args)
        _, total = self._times.setdefault(variant.ir_sha256, (variant.table, np.zeros_like(times)))
        total += times
        self.counts.append(variant.written(times))
        self.digests.append(variant.ir_sha256)
        return result

    def executed(self) -> list[tuple[str, InjectionSite, int]]:
        """All executed static instructions: digest of the IR, instruction, execution count."""
        return [
            (digest, site, times)
            for digest, (table, total) in self._times.items()
            for site, times in table.executions(total)
            if times
        ]


class Resolving:
    """Finds the static instructions at wanted dynamic indices of some calls of a compiled function.

    Attributes:
        sites: Static instructions by call and index, as far as the calls have been made; None = beyond the last value.
    """

    def __init__(self, function: Any, wanted: Mapping[int, Sequence[int]], rewriting: Rewriting | None = None) -> None:
        """Prepare to replace a function.

        Args:
            function: The compiled function.
            wanted: Dynamic indices by number of the call, from 0.
            rewriting: Rewriting of the function, see above.
        """
        self._function = function
        self._rewriting = rewriting
        self._wanted = wanted
        self._calls = 0
        self.sites: dict[tuple[int, int], InjectionSite | None] = {}

    @property
    def done(self) -> bool:
        """Whether the last wanted call has been made."""
        return self._calls > max(self._wanted, default=-1)

    def is_wanted(self, calls: range) -> bool:
        """Whether any of some calls is wanted, and has not been made."""
        return any(call in calls and (call, self._wanted[call][0]) not in self.sites for call in self._wanted)

    def continue_at(self, call: int) -> None:
        """The next call has this number."""
        self._calls = call

    def __call__(self, *args: Any) -> Any:
        """Call the function; bit-identical result."""
        call = self._calls
        self._calls += 1
        indices = self._wanted.get(call)
        if not indices:
            return self._function(*args)
        result, sites = variant_for(self._function, args, self._rewriting).resolve(indices, *args)
        self.sites.update({(call, index): site for index, site in zip(indices, sites, strict=True)})
        return result
