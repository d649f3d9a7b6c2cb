"""Journal of a large array's changes: going back costs as much as has changed since.

A map has 10^5 to 10^7 voxels, of which a scan touches some thousand.  So a snapshot of a map is the list of its changes
so far (shared with every other snapshot), not a copy of its voxels.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """One change; the same object wherever it is part of what happened.

    Attributes:
        places: Flat indices, in the order in which they were written. Shape (n,), int32.
        before: Their values before. Shape (n,).
        after: Their values since. Shape (n,).
    """

    places: np.ndarray
    before: np.ndarray
    after: np.ndarray


Put = Callable[[np.ndarray, np.ndarray], None]
"""Writes values to places of the array; called with the places and the values."""


class Changes:
    """All changes of an array that was zero at first.

    Args:
        array: The array; only compared with, never written to here. Shape (n,).
    """

    def __init__(self, array: np.ndarray) -> None:
        self._array = array
        self._list: list[Change] = []
        self._twin: np.ndarray | None = None
        self._twin_list: list[Change] = []

    def __len__(self) -> int:
        return len(self._list)

    def note(self, places: np.ndarray, before: np.ndarray, after: np.ndarray) -> None:
        """Remember a change that was just made; the arrays are kept."""
        self._list.append(Change(places, before, after))

    def forget(self) -> None:
        """Forget all changes: the present contents become the base."""
        self._list.clear()

    def take_back(self, down_to: int, put: Put) -> None:
        """Undo the newest changes until so many are left; `put` writes to the array and to arrays derived from it."""
        while len(self._list) > down_to:
            change = self._list.pop()
            put(change.places[::-1], change.before[::-1])

    def save(self) -> tuple[Change, ...]:
        """All changes so far, oldest first; later changes do not alter it."""
        return tuple(self._list)

    def restore(self, saved: tuple[Change, ...]) -> np.ndarray:
        """Go back to the instant at which `save` returned this.

        Returns:
            Contents of the array then; the caller writes them to the array, and must not change them.
        """
        twin = self._twin_at(saved)
        self._list = list(saved)
        return twin

    def _twin_at(self, saved: tuple[Change, ...]) -> np.ndarray:
        """A second array, led along the saved changes from where it was led last."""
        if self._twin is None:
            self._twin = np.zeros_like(self._array)
        common = _common(self._twin_list, saved)
        for change in reversed(self._twin_list[common:]):
            self._twin[change.places[::-1]] = change.before[::-1]
        for change in saved[common:]:
            self._twin[change.places] = change.after
        self._twin_list = list(saved)
        return self._twin

    def same(self, saved: tuple[Change, ...], revocable: int) -> bool:
        """Whether the array equals, bit for bit, its contents when `save` returned this.

        Args:
            saved: What `save` gave.
            revocable: So many of the newest changes may be taken back: they must be the same, too.
        """
        if len(saved) == len(self._list) == _common(self._list, saved):
            return True
        if not self._same_newest(saved, revocable):
            return False
        twin = self._twin_at(saved)
        bits = f"u{twin.itemsize}"
        return np.array_equal(self._array.view(bits), twin.view(bits))

    def _same_newest(self, saved: tuple[Change, ...], count: int) -> bool:
        if min(len(saved), len(self._list)) < count:
            return False
        newest = zip(self._list[len(self._list) - count :], saved[len(saved) - count :], strict=True)
        return all(
            mine is theirs
            or (mine.places.tobytes() == theirs.places.tobytes() and mine.before.tobytes() == theirs.before.tobytes())
            for mine, theirs in newest
        )


def _common(one: list[Change], other: tuple[Change, ...]) -> int:
    """How many changes at the beginning are the same objects."""
    count = 0
    for mine, theirs in zip(one, other, strict=False):
        if mine is not theirs:
            break
        count += 1
    return count
