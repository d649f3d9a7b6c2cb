"""Words of a kernel's memory: every persistent number by name, found by reflection; for counting and modification.

Names follow the code: `decisions.acted_seq`, `now.trajectory.x` (one word per point), `trajectories[1].x` (second value
of the mapping), `clock[0]`; for a map the name of its array, `log_odds`.  Text, None, mapping keys and lengths are
excluded.  So are marks (names that begin with `marked`): they are the rollback copies, overwritten before each step.

A value stored under two names has words under both, and a change under one name leaves the other unchanged, as separate
copies in a node would.  A message shared by kernels is copied before modification.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavfi.pipeline.memory import Memory, Remembers
from mavfi.states import State

INTEGER = "i4"
"""Type code of stored integers: counters and instants (us) of a node, as in messages."""
_MARK = "marked"
"""Beginning of the names of memory that only a rollback reads: no site of faults."""
_FLAG = {"b1": "?"}
"""Type codes that differ from NumPy's."""
_INDEX = re.compile(r"\[\d+\]")
"""An index in a name."""
_PARTS = re.compile(r"[^.\[\]]+")
"""The parts of a name: attributes and indices."""
ChangeWord = Callable[[np.ndarray], None]
"""Modifies one word in place, passed as an array of shape (1,) of its type."""


@dataclass(frozen=True, slots=True)
class Words:
    """Numbers of one type under one name; array elements are indexed in C order."""

    name: str
    dtype: str
    count: int

    def named(self, text: str) -> range:
        """Indices of the words that a text selects: all, if it is the name, its suffix, or part of it without indices.

        With an index appended, `x[3]`, the text selects a single word.
        """
        if not text or self._ends_with(text) or self._has(text):
            return range(self.count)
        whole, bracket, index = text.removesuffix("]").rpartition("[")
        of_array = self._ends_with(whole) or (self._has(whole) and not self.name.endswith("]"))
        if not bracket or not index.isdigit() or not of_array:
            return range(0)
        return range(self.count)[int(index) : int(index) + 1]

    def _ends_with(self, text: str) -> bool:
        """Whether the name is a text, or ends with it after a dot."""
        return f".{self.name}".endswith(f".{text}")

    def _has(self, text: str) -> bool:
        """Whether a text is part of the name, without regard to indices."""
        return f".{text}." in f".{_INDEX.sub('', self.name)}."


def collapsed(names: Iterable[str]) -> list[str]:
    """Names for a message, those that differ only in indices as one: `crumbs[...].x`."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(_INDEX.sub("[...]", name), []).append(name)
    shown = []
    for general, members in groups.items():
        if len(members) > 1:
            shown.append(general)
        else:
            shown.append(members[0])
    return shown


def words_of(kernel: Remembers) -> Iterator[Words]:
    """All words that a kernel currently stores, in the order of its memory."""
    yield from _in_memory("", kernel.memory)
    for keeper in kernel.keepers:
        for name, array in keeper.arrays().items():
            yield Words(name, _code(array), array.size)


def change(kernel: Remembers, name: str, index: int, apply: ChangeWord) -> tuple[Any, Any] | None:
    """Modify one word of a kernel's memory; returns its value before and after, None if the word does not exist."""
    if not any(words.name == name and 0 <= index < words.count for words in words_of(kernel)):
        return None
    for keeper in kernel.keepers:
        array = keeper.arrays().get(name)
        if array is not None:
            return _apply(array.reshape(-1)[index : index + 1], apply)
    first, *rest = _PARTS.findall(name)
    changed_copy, before, after = _with_changed_word(getattr(kernel.memory, first), rest, index, apply)
    setattr(kernel.memory, first, changed_copy)
    return before, after


# ---- enumeration -----------------------------------------------------------------------------------------------------
def _in_memory(start: str, memory: Memory) -> Iterator[Words]:
    """Words of a memory, whose names begin with `start`."""
    for name in memory.__match_args__:
        if not name.startswith(_MARK):
            yield from _in_value(f"{start}{name}", getattr(memory, name))


def _in_value(name: str, value: Any) -> Iterator[Words]:
    """Words of a value of this name."""
    if isinstance(value, State):
        for field in dict.fromkeys(value.spec.fields):  # a name in both elements and header denotes the element field
            if field in value.spec.elements:
                yield Words(f"{name}.{field.name}", field.dtype, len(value.elements))
            elif not value.spec.in_elements(field.name):
                yield Words(f"{name}.{field.name}", field.dtype, 1)
    elif isinstance(value, np.ndarray):
        yield Words(name, _code(value), value.size)
    elif isinstance(value, Memory):
        yield from _in_memory(f"{name}.", value)
    elif isinstance(value, (list, tuple, dict)):
        items: Iterable[Any] = value
        if isinstance(value, dict):
            items = value.values()
        for position, item in enumerate(items):
            yield from _in_value(f"{name}[{position}]", item)
    elif isinstance(value, (bool, int, float)):
        yield Words(name, _scalar_type(value), 1)


def _code(array: np.ndarray) -> str:
    """Type code of an array."""
    code = array.dtype.str[1:]
    return _FLAG.get(code, code)


def _scalar_type(value: float) -> str:
    """Type code with which a number of Python is stored."""
    if isinstance(value, bool):
        return "?"
    if isinstance(value, int):
        return INTEGER
    return "f8"


# ---- modification ----------------------------------------------------------------------------------------------------
def _apply(word: np.ndarray, apply: ChangeWord) -> tuple[Any, Any]:
    """Change a word in place; returns its value before and after."""
    before = word[0].item()
    apply(word)
    return before, word[0].item()


def _with_changed_word(value: Any, path: list[str], index: int, apply: ChangeWord) -> tuple[Any, Any, Any]:
    """Copy of a value with one word modified, and that word before and after; the original may be shared.

    `path` leads from the value to the word.
    """
    # The word is in this value: change it in a copy.
    if isinstance(value, State):
        state = value.copy()
        rows = state.header
        if state.spec.in_elements(path[0]):
            rows = state.elements
        return state, *_apply(rows[path[0]][index : index + 1], apply)
    if isinstance(value, np.ndarray):
        array = value.copy()
        return array, *_apply(array.reshape(-1)[index : index + 1], apply)
    if not path:
        word = np.array([value]).astype(_scalar_type(value))
        before, after = _apply(word, apply)
        return type(value)(after), before, after

    # It is in an attribute, or in an item of a container: change that, and put it into a copy of this value.
    first, *rest = path
    if isinstance(value, Memory):
        inner, before, after = _with_changed_word(getattr(value, first), rest, index, apply)
        memory = value.copy()
        object.__setattr__(memory, first, inner)  # the class may be frozen
        return memory, before, after
    key: Any = int(first)
    if isinstance(value, dict):
        key = list(value)[key]  # names have the position of an item
    inner, before, after = _with_changed_word(value[key], rest, index, apply)
    # A tuple cannot be changed: build another one, with the same names.
    if isinstance(value, tuple):
        items = (*value[:key], inner, *value[key + 1 :])
        if hasattr(value, "_fields"):
            return type(value)(*items), before, after
        return items, before, after
    container = value.copy()
    container[key] = inner
    return container, before, after
