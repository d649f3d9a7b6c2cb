"""Explicit memory: the persistent state of a kernel, as dataclasses of plain values that can be copied and compared.

Plain values are numbers, text, None, published states (immutable), arrays, and tuples, lists and dictionaries of these
and of memories, and sets of text.  Maps are too large to copy: they keep undo logs, see `Keeper`.
"""

import copy
import hashlib
import pickle
import struct
from collections.abc import Iterator, Mapping
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np

from mavfi.states import State


class Memory:
    """Base class of memories; a subclass is a slotted dataclass whose fields are its complete state."""

    __slots__: tuple[str, ...] = ()

    def copy(self) -> Self:
        """A deep copy."""
        return type(self)(*(copied(getattr(self, name)) for name in self.__slots__))

    def same(self, other: Self) -> bool:
        """Whether both are bit-identical."""
        return all(same(getattr(self, name), getattr(other, name)) for name in self.__slots__)


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
        memory, kept = saved
        self.memory = memory.copy()
        for keeper, content in zip(self.keepers, kept, strict=True):
            keeper.restore(content)

    def same(self, saved: Saved) -> bool:
        """Whether the current memory is bit-identical to `saved`."""
        memory, kept = saved
        return self.memory.same(memory) and all(
            keeper.same(content) for keeper, content in zip(self.keepers, kept, strict=True)
        )

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """See `Kernel.resume`; by default no output is read back."""
        return ()

    def fingerprint(self) -> bytes:
        """Hash of the memory, equal in all processes."""
        total = hashlib.sha256()
        for part in _parts(self.save()):
            total.update(part if isinstance(part, bytes) else part.encode())
        return total.digest()


_IMMUTABLE = frozenset((int, float, bool, str, bytes, type(None), State))


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
        return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
    return value.copy() if isinstance(value, Memory) else value


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
        for name in value.__slots__:
            yield from _parts(getattr(value, name))
    elif isinstance(value, (tuple, list, dict)):
        yield str(len(value))
        for item in value.items() if isinstance(value, dict) else value:
            yield from _parts(item)
    elif isinstance(value, float):
        yield struct.pack("d", value)
    elif value is None or isinstance(value, (int, str, bytes)):
        yield repr(value)
    elif isinstance(value, set):
        yield repr(sorted(value))


Content = TypeVar("Content")


class Foreign(Generic[Content]):
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
        """Empty, as the object is opaque."""
        return {}
