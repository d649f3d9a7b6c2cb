"""Explicit memory: the persistent state of a kernel, as dataclasses of plain values that can be copied and compared.

Plain values are numbers, text, None, published states (immutable), arrays, and tuples, lists and dictionaries of these
and of memories, and sets of text.

A map has 10^5 to 10^7 voxels, of which a scan updates a few thousand.  A snapshot of a map is therefore the list of its
changes so far (shared with all other snapshots), not a copy of its voxels; the cost of a rollback is proportional to
the number of changes since.
"""

import copy
import hashlib
import pickle
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np

from mavfi.errors import BadInputError
from mavfi.states import State


class Memory:
    """Base class of memories; a subclass is a slotted dataclass whose fields are its complete state."""

    __slots__ = ()
    __match_args__: tuple[str, ...] = ()  # of a dataclass: names of all fields, inherited ones too

    def copy(self) -> Self:
        """A deep copy."""
        return type(self)(*(copied(getattr(self, name)) for name in self.__match_args__))

    def same(self, other: Self) -> bool:
        """Whether both are bit-identical."""
        return all(same(getattr(self, name), getattr(other, name)) for name in self.__match_args__)


def zeros(*shape: int) -> Any:  # noqa: ANN401 - a field of a dataclass
    """A field of a memory: an array that is zero at first."""
    return field(default_factory=lambda: np.zeros(shape))


class Keeper(Protocol):
    """Large state that manages its own snapshots: a map, or a user's own path search."""

    def save(self) -> Any:  # noqa: ANN401 (each has its own form)
        """Immutable snapshot of the current state."""

    def restore(self, saved: Any) -> None:  # noqa: ANN401
        """Restore the result of `save`."""

    def same(self, saved: Any) -> bool:  # noqa: ANN401
        """Whether the current state is bit-identical to `saved`."""

    def arrays(self) -> dict[str, np.ndarray]:
        """Numeric memory by name: the arrays themselves, not copies."""


class Scratch(Protocol):
    """Work arrays of a kernel: not memory, as a step writes before it reads; but a step with a fault may read first."""

    def save(self) -> Any:  # noqa: ANN401 (each has its own form)
        """What determines the current contents; immutable."""

    def restore(self, saved: Any) -> None:  # noqa: ANN401
        """Continue from the result of `save`; the arrays themselves follow by `fill`."""

    def fill(self) -> None:
        """Write the contents of the last restored `save` to the arrays."""


Saved = tuple[Memory, tuple[Any, ...]]
"""Copies of a kernel's memory, and of its keepers."""


class Remembers:
    """Base class of kernels with explicit memory.

    Attributes:
        memory: The complete memory, except for the keepers.
        keepers: Its maps.
        scratch: Its work arrays that functions with faults may read; None = it has some that cannot be saved.
    """

    memory: Memory
    keepers: tuple[Keeper, ...] = ()
    scratch: tuple[Scratch, ...] | None = ()

    def save(self) -> Saved:
        """Snapshot of the current memory."""
        return self.memory.copy(), tuple(keeper.save() for keeper in self.keepers)

    def restore(self, saved: Saved) -> None:
        """Restore the result of `save`, which remains valid for further restores."""
        memory, contents = saved
        self.memory = memory.copy()
        for keeper, content in zip(self.keepers, contents, strict=True):
            keeper.restore(content)

    def same(self, saved: Saved) -> bool:
        """Whether the current memory is bit-identical to `saved`."""
        memory, contents = saved
        return self.memory.same(memory) and all(
            keeper.same(content) for keeper, content in zip(self.keepers, contents, strict=True)
        )

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """See `Kernel.resume`; by default no output is read back."""
        return ()

    def fingerprint(self) -> bytes:
        """Hash of the memory, equal in all processes."""
        total = hashlib.sha256()
        for part in _parts(self.save()):
            if isinstance(part, str):
                part = part.encode()
            total.update(part)
        return total.digest()


_IMMUTABLE = frozenset((int, float, bool, str, bytes, type(None), State))
"""Types whose values need no copy; published states are never modified."""


def copied(value: Any) -> Any:  # noqa: ANN401
    """A deep copy of a plain value."""
    if type(value) in _IMMUTABLE:
        return value
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, (list, set)):
        return type(value)(copied(item) for item in value)
    if isinstance(value, dict):
        return {key: copied(item) for key, item in value.items()}
    if isinstance(value, tuple):
        items = map(copied, value)
        if hasattr(value, "_fields"):
            return type(value)(*items)
        return tuple(items)
    if isinstance(value, Memory):
        return value.copy()
    return value


def same(value: Any, other: Any) -> bool:  # noqa: ANN401
    """Whether two plain values are bit-identical (NaN equals the same NaN, 0.0 differs from -0.0)."""
    return value is other or list(_parts(value)) == list(_parts(other))


def _parts(value: Any) -> Iterator[str | bytes]:  # noqa: ANN401
    """Type and content of a plain value: equal lists of these for equal bits."""
    yield type(value).__name__
    if isinstance(value, np.ndarray | np.generic):
        yield f"{value.dtype.str}{value.shape}"
        yield value.tobytes()
    elif isinstance(value, State):
        yield from (value.spec.name, value.header.tobytes(), value.elements.tobytes())
    elif isinstance(value, Memory):
        for name in value.__match_args__:
            yield from _parts(getattr(value, name))
    elif isinstance(value, dict):
        yield str(len(value))
        for item in value.items():
            yield from _parts(item)
    elif isinstance(value, (tuple, list)):
        yield str(len(value))
        for item in value:
            yield from _parts(item)
    elif isinstance(value, float):
        yield struct.pack("d", value)
    elif value is None or isinstance(value, (int, str, bytes)):
        yield repr(value)
    elif isinstance(value, set):
        yield repr(sorted(value))


# ---- undo logs ------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True, eq=False)
class ArrayChange:
    """One change; the same object in every snapshot that contains it.

    Attributes:
        places: Flat indices in write order. Shape (n,), int32.
        before: Previous values. Shape (n,).
        after: New values. Shape (n,).
    """

    places: np.ndarray
    before: np.ndarray
    after: np.ndarray


Put = Callable[[np.ndarray, np.ndarray], None]
"""Writes values to the array; arguments: flat indices and values."""


class Changes:
    """All changes of an array that was initially zero.

    Args:
        array: The array; read for comparison only. Shape (n,).
    """

    def __init__(self, array: np.ndarray) -> None:
        self._array = array
        self._log: list[ArrayChange] = []
        # A second copy of the array, created by the first `restore`, and the changes that it contains.
        self._replica: np.ndarray | None = None
        self._replica_log: list[ArrayChange] = []

    def __len__(self) -> int:
        return len(self._log)

    def note(self, places: np.ndarray, before: np.ndarray, after: np.ndarray) -> None:
        """Append a change that was just made; the arrays are not copied."""
        self._log.append(ArrayChange(places, before, after))

    def forget(self) -> None:
        """Clear the log: the current contents become the base."""
        self._log.clear()

    def take_back(self, down_to: int, put: Put) -> None:
        """Undo the latest changes until `down_to` are left; `put` writes to the array and to those derived from it."""
        while len(self._log) > down_to:
            change = self._log.pop()
            put(change.places[::-1], change.before[::-1])

    def save(self) -> tuple[ArrayChange, ...]:
        """All changes so far, oldest first; unaffected by later changes."""
        return tuple(self._log)

    def restore(self, saved: tuple[ArrayChange, ...]) -> np.ndarray:
        """Restore the log to a saved one.

        Returns:
            Contents of the array at that time, read-only; the caller writes them to the array.
        """
        copy = self._replica_at(saved)
        self._log = list(saved)
        return copy

    def _replica_at(self, saved: tuple[ArrayChange, ...]) -> np.ndarray:
        """A second copy of the array, moved from the snapshot used last to `saved`."""
        if self._replica is None:
            self._replica = np.zeros_like(self._array)
        # Go back to the last change that both have in common, then forward.
        common = common_length(self._replica_log, saved)
        for change in reversed(self._replica_log[common:]):
            self._replica[change.places[::-1]] = change.before[::-1]
        for change in saved[common:]:
            self._replica[change.places] = change.after
        self._replica_log = list(saved)
        return self._replica

    def same(self, saved: tuple[ArrayChange, ...], revocable: int) -> bool:
        """Whether the array is bit-identical to its contents at the time of `saved`.

        Args:
            saved: Result of `save`.
            revocable: Number of latest changes that may be undone, which must also be identical.
        """
        if len(saved) == len(self._log) == common_length(self._log, saved):
            return True
        # Other changes may have led to the same contents.
        if not self._same_newest(saved, revocable):
            return False
        copy = self._replica_at(saved)
        bits = f"u{copy.itemsize}"
        return np.array_equal(self._array.view(bits), copy.view(bits))

    def _same_newest(self, saved: tuple[ArrayChange, ...], count: int) -> bool:
        """Whether the latest `count` changes would be undone to the same values."""
        if min(len(saved), len(self._log)) < count:
            return False
        newest = zip(self._log[len(self._log) - count :], saved[len(saved) - count :], strict=True)
        return all(
            mine is theirs
            or (mine.places.tobytes() == theirs.places.tobytes() and mine.before.tobytes() == theirs.before.tobytes())
            for mine, theirs in newest
        )


def common_length(left: Sequence[Any], right: Sequence[Any]) -> int:
    """Number of leading changes that are identical objects."""
    count = 0
    for left_change, right_change in zip(left, right, strict=False):
        if left_change is not right_change:
            break
        count += 1
    return count


# ---- opaque objects -------------------------------------------------------------------------------------------------
Content = TypeVar("Content")


class OpaqueKeeper(Generic[Content]):
    """Keeper of a user's opaque object: copied whole, and compared by its pickle.

    Attributes:
        content: The object; replaced by `restore`.
    """

    def __init__(self, content: Content) -> None:
        self.content = content

    def save(self) -> Content:
        """A deep copy."""
        return copy.deepcopy(self.content)

    def restore(self, saved: Content) -> None:
        """Replace the object by a deep copy of the saved one."""
        self.content = copy.deepcopy(saved)

    def same(self, saved: Content) -> bool:
        """Whether both have the same pickle; False if either cannot be pickled."""
        try:
            return pickle.dumps(self.content) == pickle.dumps(saved)
        except Exception:  # noqa: BLE001 - any exception of a user's object
            return False

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays that the object declares, see `declared_arrays`."""
        return declared_arrays(self.content)


def declared_arrays(owner: Any) -> dict[str, np.ndarray]:  # noqa: ANN401 - a user's own
    """The memory that a user's object declares as targets of faults: by its method `arrays`; without one, none.

    Raises:
        BadInputError: The method gives something else than arrays that can be changed in place.
    """
    declare = getattr(owner, "arrays", None)
    if not callable(declare):
        return {}
    arrays = declare()
    what = f"{type(owner).__module__}:{type(owner).__qualname__}: arrays"
    if not isinstance(arrays, Mapping):
        raise BadInputError(f"{what}: returned {arrays!r:.60}; allowed: a dictionary of arrays by name")
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or not array.flags.c_contiguous or not array.flags.writeable:
            raise BadInputError(f"{what}: {name!r}: allowed: a contiguous array that the object itself uses, no copy")
    return dict(arrays)
