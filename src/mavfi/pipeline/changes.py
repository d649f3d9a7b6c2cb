"""Undo log of a large array: the cost of a rollback is proportional to the number of changes since.

A map has 10^5 to 10^7 voxels, of which a scan updates a few thousand.  A snapshot of a map is therefore the list of its
changes so far (shared with all other snapshots), not a copy of its voxels.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class Change:
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
        self._list: list[Change] = []
        self._copy: np.ndarray | None = None
        self._copied: list[Change] = []

    def __len__(self) -> int:
        return len(self._list)

    def note(self, places: np.ndarray, before: np.ndarray, after: np.ndarray) -> None:
        """Append a change that was just made; the arrays are not copied."""
        self._list.append(Change(places, before, after))

    def forget(self) -> None:
        """Clear the log: the current contents become the base."""
        self._list.clear()

    def take_back(self, down_to: int, put: Put) -> None:
        """Undo the latest changes until `down_to` are left; `put` writes to the array and to those derived from it."""
        while len(self._list) > down_to:
            change = self._list.pop()
            put(change.places[::-1], change.before[::-1])

    def save(self) -> tuple[Change, ...]:
        """All changes so far, oldest first; unaffected by later changes."""
        return tuple(self._list)

    def restore(self, saved: tuple[Change, ...]) -> np.ndarray:
        """Restore the log to a saved one.

        Returns:
            Contents of the array at that time, read-only; the caller writes them to the array.
        """
        copy = self._copy_at(saved)
        self._list = list(saved)
        return copy

    def _copy_at(self, saved: tuple[Change, ...]) -> np.ndarray:
        """A second copy of the array, moved from the snapshot used last to `saved`."""
        if self._copy is None:
            self._copy = np.zeros_like(self._array)
        common = common_length(self._copied, saved)
        for change in reversed(self._copied[common:]):
            self._copy[change.places[::-1]] = change.before[::-1]
        for change in saved[common:]:
            self._copy[change.places] = change.after
        self._copied = list(saved)
        return self._copy

    def same(self, saved: tuple[Change, ...], revocable: int) -> bool:
        """Whether the array is bit-identical to its contents at the time of `saved`.

        Args:
            saved: Result of `save`.
            revocable: Number of latest changes that may be undone, which must also be identical.
        """
        if len(saved) == len(self._list) == common_length(self._list, saved):
            return True
        if not self._same_newest(saved, revocable):
            return False
        copy = self._copy_at(saved)
        bits = f"u{copy.itemsize}"
        return np.array_equal(self._array.view(bits), copy.view(bits))

    def _same_newest(self, saved: tuple[Change, ...], count: int) -> bool:
        if min(len(saved), len(self._list)) < count:
            return False
        newest = zip(self._list[len(self._list) - count :], saved[len(saved) - count :], strict=True)
        return all(
            mine is theirs
            or (mine.places.tobytes() == theirs.places.tobytes() and mine.before.tobytes() == theirs.before.tobytes())
            for mine, theirs in newest
        )


def common_length(one: Sequence[Any], other: Sequence[Any]) -> int:
    """Number of leading changes that are identical objects."""
    count = 0
    for mine, theirs in zip(one, other, strict=False):
        if mine is not theirs:
            break
        count += 1
    return count
