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
_KEPT_BYTES = 1 << 27
"""Most memory of the recorded arguments of one function."""
_LARGE_BYTES = 1 << 16
"""Least size of an array that is worth a mapping of its own."""


def copied(value: Any) -> Any:  # noqa: ANN401 - numbers, arrays and tuples of these
    """A deep copy; arrays keep strides, access and common memory, since Numba compiles by these."""
    return _copied(value, {}, read_only=False)


def kept(value: Any) -> Any:  # noqa: ANN401
    """The same, to be copied again before use: large arrays are in memory that nothing can write.

    Forks share it. They do not copy its page tables, which for all recorded calls takes two thirds of a fork, and a
    fault in one of them cannot reach it.
    """
    return _copied(value, {}, read_only=True)


def _copied(value: Any, known: dict[int, tuple[int, np.ndarray]], *, read_only: bool) -> Any:
    """A copy; `known`: lowest address and copy of the memory of arrays that own some, by their id."""
    if isinstance(value, tuple):
        parts = [_copied(part, known, read_only=read_only) for part in value]
        if hasattr(value, "_fields"):
            return type(value)(*parts)
        return tuple(parts)
    if not isinstance(value, np.ndarray) or value.dtype.hasobject:
        return value
    root = value
    while isinstance(root.base, np.ndarray):
        root = root.base
    if id(root) not in known:
        known[id(root)] = _memory(root, read_only=read_only)
    start, memory = known[id(root)]
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
    if not read_only or size < _LARGE_BYTES:
        memory = np.empty(max(size, 1), np.uint8)
        ctypes.memmove(memory.ctypes.data, low, size)
        return low, memory
    memory = np.frombuffer(mmap.mmap(-1, size), np.uint8)
    ctypes.memmove(memory.ctypes.data, low, size)
    if _LIBC.mprotect(ctypes.c_void_p(memory.ctypes.data), ctypes.c_size_t(size), mmap.PROT_READ):
        raise OSError(ctypes.get_errno(), "mprotect")
    return low, memory


def same_bits(one: Any, other: Any) -> bool:  # noqa: ANN401
    """Whether numbers, arrays and tuples of these are equal bit for bit, with types and shapes."""
    if type(one) is not type(other):
        return False
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(same_bits, one, other))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and _same_memory(one, other)
    if isinstance(one, float | complex | np.generic):
        return np.asarray(one).tobytes() == np.asarray(other).tobytes()
    return bool(one == other)


def _same_memory(one: np.ndarray, other: np.ndarray) -> bool:
    left = np.ascontiguousarray(one)
    right = np.ascontiguousarray(other)
    # without temporary arrays, which large outputs would need
    places = (ctypes.c_void_p(array.ctypes.data) for array in (left, right))
    return int(_LIBC.memcmp(*places, ctypes.c_size_t(left.nbytes))) == 0


def size_of(value: Any) -> int:  # noqa: ANN401
    """Bytes of the arrays in a value."""
    if isinstance(value, tuple):
        return sum(map(size_of, value))
    if isinstance(value, np.ndarray):
        return value.nbytes
    return 0


class Recording:
    """Arguments of some calls of a function, evenly spread over all of them.

    Attributes:
        total: Number of calls so far.
        kept: Arguments before the call, by its number.

    Args:
        most: At most twice as many calls are kept, fewer if they need more than `_KEPT_BYTES`.
    """

    def __init__(self, most: int = 12) -> None:
        self._most = most
        self._stride = 1
        self.total = 0
        self.kept: dict[int, tuple[Any, ...]] = {}

    def note(self, args: tuple[Any, ...]) -> None:
        """Count a call that is about to be made, and keep its arguments if it is its turn."""
        call = self.total
        self.total = self.total + 1
        if call % self._stride:
            return
        self.kept[call] = kept(args)
        while len(self.kept) > 1 and (len(self.kept) * size_of(args) > _KEPT_BYTES or len(self.kept) > 2 * self._most):
            self._stride *= 2
            self.kept = {number: own for number, own in self.kept.items() if number % self._stride == 0}


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
    own = []
    for name, value in zip(names, args, strict=True):
        if name not in work:
            own.append(value[:rows] if name in counted else value)
    return result, *own


def _rows(result: Any) -> int:
    """The resulting number of rows: the last one of several numbers; a corrupted one must not be an error."""
    last = result[-1] if isinstance(result, tuple) else result
    if isinstance(last, (int, np.integer)):
        return max(int(last), 0)
    return 0


# ---- injections -----------------------------------------------------------------------------------------------------

_SURVIVED = (Effect.MASKED, Effect.SDC, Effect.DETECTED, Effect.EXCEPTION, Effect.NOT_ACTIVATED)
"""Effects that do not end the process."""
MASKED, SDC, DETECTED, EXCEPTION, NOT_ACTIVATED = _KNOWN = tuple(effect.label for effect in _SURVIVED)
_TIMEOUT = 60.0


class Place(NamedTuple):
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
        return [kept(self._outputs(self._function(*own), own)) for own in map(copied, self.calls)]

    def _outputs(self, result: Any, args: tuple[Any, ...]) -> tuple[Any, ...]:
        return outputs_of(self._entry, self._function, result, args)

    def draw(self, random: np.random.Generator, n: int) -> list[Place]:
        """Draw places, uniformly over the dynamic instructions of all calls, then over the bits of the result."""
        sizes = self.variant.sizes
        weights = (self.executions * sizes).astype(np.float64).ravel()
        found = []
        for flat in random.choice(weights.size, size=n, p=weights / weights.sum()):
            call, block = divmod(int(flat), len(sizes))
            offset = int(random.integers(sizes[block]))
            number = int(random.integers(self.executions[call, block]))
            bit = int(random.integers(self.site(block, offset).width))
            found.append(Place(call, block, number, offset, bit))
        return found

    def site(self, block: int, offset: int) -> InjectionSite:
        """A static instruction."""
        return self.variant.table.blocks[block][offset]

    def run(self, places: Sequence[Place]) -> list[str]:
        """Effect of each injection, as if in a child process of its own: they share one as long as it lives."""
        indices = self._indices(places)
        self.variant.claim_report()
        found = [""] * len(places)
        for call in {place.call for place in places}:
            left = [number for number, place in enumerate(places) if place.call == call]
            while left:
                effects = self._effects(call, [(indices[n], places[n].bit) for n in left])
                for n, effect in zip(left, effects, strict=False):
                    found[n] = effect
                left = left[len(effects) :]
        return found

    def _indices(self, places: Sequence[Place]) -> list[int]:
        """Dynamic index of each place in its call."""
        starts: dict[tuple[int, int, int], int] = {}
        for call in {place.call for place in places}:
            wanted = {(place.block, place.number) for place in places if place.call == call}
            passes = Passes(len(self.variant.table.blocks), wanted)
            self.variant.locate(passes, *copied(self.calls[call]))
            starts.update({(call, *one): passes.start(*one) for one in wanted})
        return [starts[place.call, place.block, place.number] + place.offset for place in places]

    def _effects(self, call: int, faults: Sequence[tuple[int, int]]) -> list[str]:
        """Effects of faults (dynamic index and bit) in one child, up to the first that ends it.

        A call outside planned memory ends it, too: it may have written anywhere.
        """
        golden = self._golden[call]
        budget = budget_for(int(self.counts[call]))
        done = mmap.mmap(-1, len(faults))

        def injected() -> bytes:
            for number, (index, bit) in enumerate(faults):
                done[number] = 1 + _KNOWN.index(self._injected(copied(self.calls[call]), index, bit, budget, golden))
                report = self.variant.report()
                if report is not None and not report.planned:
                    break
            return b""

        ended = run_in_child(injected, _TIMEOUT + len(faults))
        effects = [_KNOWN[code - 1] for code in done[:] if code]
        if ended.how != "done" and len(effects) < len(faults):
            effects.append(NOT_ACTIVATED if self.variant.report() is None else ended.how)
        return effects

    def _injected(self, args: tuple[Any, ...], index: int, bit: int, budget: int, golden: tuple[Any, ...]) -> str:
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
