"""Injections into recorded calls of a function, plain or protected: uniform over dynamic instructions, then bits.

Arguments are copied with the layout that selects the compiled signature.  An output is the result of a function or an
argument that it changes, but no work array and no unused row.
"""

import ctypes
import inspect
import mmap
from collections import Counter
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from mavfi.extras.hardening.duplicate import MESSAGE
from mavfi.faults.levels.instruction.plan import budget_for
from mavfi.faults.levels.instruction.table import InjectionSite
from mavfi.faults.levels.instruction.variant import Passes, Variant
from mavfi.ir.forked import run_in_child
from mavfi.outcomes import Effect

_LIBC = ctypes.CDLL(None, use_errno=True)
_MAX_RECORDED_BYTES = 1 << 27
"""Largest memory of the recorded arguments of one function."""
_MIN_MAPPED_BYTES = 1 << 16
"""Smallest size of an array for which a separate memory mapping pays."""


def copied(value: Any) -> Any:  # noqa: ANN401 - numbers, arrays and tuples of these
    """A deep copy; arrays keep strides, access and common memory, since Numba compiles by these."""
    return _copy(value, {}, read_only=False)


def read_only_copy(value: Any) -> Any:  # noqa: ANN401
    """A deep copy whose large arrays are in memory that nothing can write; it is copied again before use.

    Forked processes share this memory: its page tables, which for all recorded calls take two thirds of the time of a
    fork, are not copied, and an injected fault cannot write to it.
    """
    return _copy(value, {}, read_only=True)


def _copy(value: Any, memories: dict[int, tuple[int, np.ndarray]], *, read_only: bool) -> Any:
    """A deep copy.

    Args:
        value: Numbers, arrays and tuples of these.
        memories: Lowest address, and copy, of the memory of each array that owns some, by its id; extended.
        read_only: Whether copies of large arrays are write-protected.
    """
    if isinstance(value, tuple):
        parts = [_copy(part, memories, read_only=read_only) for part in value]
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
        memories[id(root)] = _memory(root, read_only=read_only)
    start, memory = memories[id(root)]
    moved: np.ndarray = np.ndarray(value.shape, value.dtype, memory.data, value.ctypes.data - start, value.strides)
    moved.flags.writeable = value.flags.writeable
    return moved


def _memory(root: np.ndarray, *, read_only: bool) -> tuple[int, np.ndarray]:
    """Lowest address of an array, and a copy of its memory."""
    if root.size:
        low, high = np.lib.array_utils.byte_bounds(root)
    else:
        low = root.ctypes.data
        high = root.ctypes.data
    size = high - low
    if not read_only or size < _MIN_MAPPED_BYTES:
        memory = np.empty(max(size, 1), np.uint8)
        ctypes.memmove(memory.ctypes.data, low, size)
        return low, memory
    memory = np.frombuffer(mmap.mmap(-1, size), np.uint8)
    ctypes.memmove(memory.ctypes.data, low, size)
    if _LIBC.mprotect(ctypes.c_void_p(memory.ctypes.data), ctypes.c_size_t(size), mmap.PROT_READ):
        raise OSError(ctypes.get_errno(), "mprotect")
    return low, memory


def same_bits(value: Any, other: Any) -> bool:  # noqa: ANN401
    """Whether numbers, arrays and tuples of these are equal bit for bit, with types and shapes."""
    if type(value) is not type(other):
        return False
    if isinstance(value, tuple | list):
        return len(value) == len(other) and all(map(same_bits, value, other))
    if isinstance(value, np.ndarray):
        return value.dtype == other.dtype and value.shape == other.shape and _same_memory(value, other)
    if isinstance(value, float | complex | np.generic):
        return np.asarray(value).tobytes() == np.asarray(other).tobytes()
    return bool(value == other)


def _same_memory(array: np.ndarray, other: np.ndarray) -> bool:
    left = np.ascontiguousarray(array)
    right = np.ascontiguousarray(other)
    # without temporary arrays, which large outputs would need
    addresses = (ctypes.c_void_p(array.ctypes.data) for array in (left, right))
    return int(_LIBC.memcmp(*addresses, ctypes.c_size_t(left.nbytes))) == 0


def size_of(value: Any) -> int:  # noqa: ANN401
    """Bytes of the arrays in a value."""
    if isinstance(value, tuple):
        return sum(map(size_of, value))
    if isinstance(value, np.ndarray):
        return value.nbytes
    return 0


class CallRecording:
    """Arguments of some calls of a function, evenly spread over all of them.

    Attributes:
        total: Number of calls so far.
        arguments: Arguments before the call, by its number.

    Args:
        enough: At most twice as many calls are recorded, fewer if they need more than `_MAX_RECORDED_BYTES`.
    """

    def __init__(self, enough: int = 12) -> None:
        self._max_calls = 2 * enough
        self._stride = 1
        self.total = 0
        self.arguments: dict[int, tuple[Any, ...]] = {}

    def note(self, args: tuple[Any, ...]) -> None:
        """Count a call that is about to be made, and record its arguments if it is its turn."""
        call = self.total
        self.total += 1
        if call % self._stride:
            return
        self.arguments[call] = read_only_copy(args)
        # When there are too many, every other one goes, and later ones are recorded half as often.
        while len(self.arguments) > 1 and self._is_full(size_of(args)):
            self._stride *= 2
            self.arguments = {n: recorded for n, recorded in self.arguments.items() if n % self._stride == 0}

    def _is_full(self, bytes_per_call: int) -> bool:
        calls = len(self.arguments)
        return calls * bytes_per_call > _MAX_RECORDED_BYTES or calls > self._max_calls


# ---- outputs --------------------------------------------------------------------------------------------------------

_WORK = {
    "plan_rrt": ("tree",),
    "plan_rrt_connect": ("trees",),
    "plan_rrt_star": ("tree",),
    "shortcut_random": ("buffer",),
}
"""Arguments that are written before they are read, by function."""
_COUNTED = {
    "insert_scan": ("touched", "before"),
    "collect": ("touched",),
    "apply_updates": ("journal_voxels", "journal_cells"),
    **dict.fromkeys(("plan_rrt", "plan_rrt_connect", "plan_rrt_star", "shortcut_greedy", "shortcut_random"), ("path",)),
}
"""Arguments whose rows beyond the resulting number are undefined."""


def outputs_of(entry: str, function: Any, result: Any, args: tuple[Any, ...]) -> tuple[Any, ...]:
    """Result and changed arguments of a call; all of them for a function that is not the pipeline's."""
    names = tuple(inspect.signature(function.py_func).parameters)
    work = _WORK.get(entry, ())
    counted = _COUNTED.get(entry, ())
    rows = _rows(result)
    changed = []
    for name, value in zip(names, args, strict=True):
        if name in counted:
            changed.append(value[:rows])
        elif name not in work:
            changed.append(value)
    return result, *changed


def _rows(result: Any) -> int:
    """The resulting number of rows: the last one of several numbers; a corrupted one must not be an error."""
    if isinstance(result, tuple):
        result = result[-1]
    if isinstance(result, (int, np.integer)):
        return max(int(result), 0)
    return 0


# ---- injections -----------------------------------------------------------------------------------------------------

_SURVIVED = (Effect.MASKED, Effect.SDC, Effect.DETECTED, Effect.EXCEPTION, Effect.NOT_ACTIVATED)
"""Effects that do not end the process."""
_SURVIVED_LABELS = tuple(effect.label for effect in _SURVIVED)
MASKED, SDC, DETECTED, EXCEPTION, NOT_ACTIVATED = _SURVIVED_LABELS
_TIMEOUT_S = 60.0
"""Time after which a child process hangs, in addition to a second per fault."""


class InjectionPoint(NamedTuple):
    """A bit of the result of one dynamic instruction.

    Attributes:
        call: Index of the recorded call.
        block: Of the table of sites.
        number: Execution of the block within the call, from 0.
        offset: Of the site in the block.
        bit: 0 = least significant.
    """

    call: int
    block: int
    number: int
    offset: int
    bit: int


class Battery:
    """Recorded calls of a function, with instrumented code of a variant of it.

    Args:
        entry: Name of the function, see `outputs_of`.
        function: The plain compiled function.
        variant: Instrumented code, plain or protected.
        calls: Arguments.
    """

    def __init__(self, entry: str, function: Any, variant: Variant, calls: Sequence[tuple[Any, ...]]) -> None:
        self._entry = entry
        self._function = function
        self.variant = variant
        self.calls = calls

    @cached_property
    def executions(self) -> np.ndarray:
        """Executions of each block in each call. Shape (calls, blocks)."""
        return np.array([self.variant.tally(*copied(args))[1] for args in self.calls])

    @cached_property
    def counts(self) -> np.ndarray:
        """Dynamic instructions of each call. Shape (calls,)."""
        return self.executions @ self.variant.sizes

    @cached_property
    def _golden(self) -> list[tuple[Any, ...]]:
        """Outputs of each call of plain code."""
        golden = []
        for recorded in self.calls:
            args = copied(recorded)
            result = self._function(*args)  # changes the arguments
            golden.append(read_only_copy(self._outputs(result, args)))
        return golden

    def _outputs(self, result: Any, args: tuple[Any, ...]) -> tuple[Any, ...]:
        return outputs_of(self._entry, self._function, result, args)

    def draw(self, random: np.random.Generator, n: int) -> list[InjectionPoint]:
        """Draw `n` points, uniformly over the dynamic instructions of all calls, then over the bits of the result."""
        sizes = self.variant.sizes
        weights = (self.executions * sizes).astype(np.float64).ravel()
        points = []
        for flat in random.choice(weights.size, size=n, p=weights / weights.sum()):
            call, block = divmod(int(flat), len(sizes))
            offset = int(random.integers(sizes[block]))
            number = int(random.integers(self.executions[call, block]))
            bit = int(random.integers(self.site(block, offset).width))
            points.append(InjectionPoint(call, block, number, offset, bit))
        return points

    def site(self, block: int, offset: int) -> InjectionSite:
        """A static instruction."""
        return self.variant.table.blocks[block][offset]

    def run(self, points: Sequence[InjectionPoint]) -> list[str]:
        """Effect of each injection, as if each had a child process: several share one for as long as it lives."""
        indices = self._indices(points)
        self.variant.claim_report()
        effects = [""] * len(points)
        for call in {point.call for point in points}:
            remaining = [number for number, point in enumerate(points) if point.call == call]
            # A child ends with the first fault that ends its process; the next child continues behind it.
            while remaining:
                faults = [(indices[number], points[number].bit) for number in remaining]
                effects_in_child = self._effects(call, faults)
                for number, effect in zip(remaining, effects_in_child, strict=False):
                    effects[number] = effect
                remaining = remaining[len(effects_in_child) :]
        return effects

    def _indices(self, points: Sequence[InjectionPoint]) -> list[int]:
        """Dynamic index of each point in its call."""
        starts: dict[tuple[int, int, int], int] = {}
        for call in {point.call for point in points}:
            executions = {(point.block, point.number) for point in points if point.call == call}
            passes = Passes(len(self.variant.table.blocks), executions)
            self.variant.locate(passes, *copied(self.calls[call]))
            for block, number in executions:
                starts[call, block, number] = passes.start(block, number)
        return [starts[point.call, point.block, point.number] + point.offset for point in points]

    def _effects(self, call: int, faults: Sequence[tuple[int, int]]) -> list[str]:
        """Effects of faults (dynamic index and bit) in one child, up to the first that ends it.

        A call outside planned memory ends it, too: it may have written anywhere.
        """
        golden = self._golden[call]
        budget = budget_for(int(self.counts[call]))
        codes = mmap.mmap(-1, len(faults))  # shared with the child: 1 + index in `_SURVIVED_LABELS`; 0 = not injected

        def inject_all() -> bytes:
            for number, (index, bit) in enumerate(faults):
                effect = self._effect_of(copied(self.calls[call]), index, bit, budget, golden)
                codes[number] = 1 + _SURVIVED_LABELS.index(effect)
                report = self.variant.report()
                if report is not None and not report.planned:
                    break
            return b""

        ended = run_in_child(inject_all, _TIMEOUT_S + len(faults))
        effects = [_SURVIVED_LABELS[code - 1] for code in codes[:] if code]
        if ended.how != "done" and len(effects) < len(faults):
            # The child ended in the fault after these; an end before its flip is not its effect.
            effect: str = ended.how
            if self.variant.report() is None:
                effect = NOT_ACTIVATED
            effects.append(effect)
        return effects

    def _effect_of(self, args: tuple[Any, ...], index: int, bit: int, budget: int, golden: tuple[Any, ...]) -> str:
        """Effect of a fault that does not end the process."""
        try:
            result = self.variant.inject(index, -1, 1 << bit, budget, *args)
        except Exception as error:  # noqa: BLE001 - raised by the kernel, or by its wrapper after a detection
            if isinstance(error, SystemError) and MESSAGE in str(error):
                return DETECTED
            return EXCEPTION
        if self.variant.report() is None:
            return NOT_ACTIVATED
        if same_bits(self._outputs(result, args), golden):
            return MASKED
        return SDC


def counts_of(effects: Sequence[str]) -> dict[str, int]:
    """Number of injections by effect, in a fixed order."""
    counted = Counter(effects)
    return {effect.label: counted[effect.label] for effect in Effect if counted[effect.label]}
