"""Words of a kernel's memory: every number that it remembers, by name, found by reflection; counted and changed.

Names are those of the code: `decisions.acted_seq`, `now.trajectory.x` (a word for each point), `trajectories[1].x` (the
second of the mapping's values), `clock[0]`; of a map the name of its array, `log_odds`.  Text, None, keys of mappings
and lengths are no words.  Marks (names that begin with `marked`) are none either: they are what a recomputation goes
back to, and are written before each step.

A value that is remembered under two names has its words under both, and a change under one name leaves the other as it
is: each is a copy of the node's own.  A message that kernels share is copied before it is changed.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavfi.pipeline.memory import Memory, Remembers
from mavfi.states import State

INTEGER = "i4"
"""Type of remembered integers: counters and instants (us) of a node; those of messages have it, too."""
_MARK = "marked"
_FLAG = {"b1": "?"}
_INDEX = re.compile(r"\[\d+\]")
_PARTS = re.compile(r"[^.\[\]]+")
Change = Callable[[np.ndarray], None]
"""Changes one word in place, given as an array of shape (1,) of its type."""


@dataclass(frozen=True, slots=True)
class Words:
    """Numbers of one type under one name; those of an array count in C order."""

    name: str
    dtype: str
    count: int

    def named(self, text: str) -> range:
        """Which of them a text names: all if it is the name, its end, or part of it without the places in lists.

        With an index behind it, `x[3]`, the text names that word.
        """
        if not text or self._ends_with(text) or self._has(text):
            return range(self.count)
        whole, bracket, index = text.removesuffix("]").rpartition("[")
        of_array = self._ends_with(whole) or (self._has(whole) and not self.name.endswith("]"))
        if not bracket or not index.isdigit() or not of_array:
            return range(0)
        return range(self.count)[int(index) : int(index) + 1]

    def _ends_with(self, text: str) -> bool:
        return f".{self.name}".endswith(f".{text}")

    def _has(self, text: str) -> bool:
        return f".{text}." in f".{_INDEX.sub('', self.name)}."


def words_of(kernel: Remembers) -> Iterator[Words]:
    """Everything that a kernel remembers now, in the order of its memory."""
    yield from _in_memory("", kernel.memory)
    for keeper in kernel.keepers:
        for name, array in keeper.arrays().items():
            yield Words(name, _code(array), array.size)


def change(kernel: Remembers, name: str, index: int, apply: Change) -> tuple[Any, Any] | None:
    """Change one word of what a kernel remembers; gives its value before and after, None if there is no such word."""
    if not any(words.name == name and 0 <= index < words.count for words in words_of(kernel)):
        return None
    for keeper in kernel.keepers:
        array = keeper.arrays().get(name)
        if array is not None:
            return _apply(array.reshape(-1)[index : index + 1], apply)
    first, *rest = _PARTS.findall(name)
    changed, before, after = _changed(getattr(kernel.memory, first), rest, index, apply)
    setattr(kernel.memory, first, changed)
    return before, after


# ---- finding ---------------------------------------------------------------------------------------------------------
def _in_memory(start: str, memory: Memory) -> Iterator[Words]:
    for name in memory.__slots__:
        if not name.startswith(_MARK):
            yield from _in_value(f"{start}{name}", getattr(memory, name))


def _in_value(name: str, value: Any) -> Iterator[Words]:
    if isinstance(value, State):
        for field in dict.fromkeys(value.spec.fields):  # a name in list and header means the list's, as everywhere
            in_list = field in value.spec.elements
            if in_list or not value.spec.in_elements(field.name):
                yield Words(f"{name}.{field.name}", field.dtype, len(value.elements) if in_list else 1)
    elif isinstance(value, np.ndarray):
        yield Words(name, _code(value), value.size)
    elif isinstance(value, Memory):
        yield from _in_memory(f"{name}.", value)
    elif isinstance(value, (list, tuple, dict)):
        for place, item in enumerate(value.values() if isinstance(value, dict) else value):
            yield from _in_value(f"{name}[{place}]", item)
    elif isinstance(value, (bool, int, float)):
        yield Words(name, _scalar_type(value), 1)


def _code(array: np.ndarray) -> str:
    code = array.dtype.str[1:]
    return _FLAG.get(code, code)


def _scalar_type(value: float) -> str:
    return "?" if isinstance(value, bool) else INTEGER if isinstance(value, int) else "f8"


# ---- changing --------------------------------------------------------------------------------------------------------
def _apply(word: np.ndarray, apply: Change) -> tuple[Any, Any]:
    before = word[0].item()
    apply(word)
    return before, word[0].item()


def _changed(value: Any, path: list[str], index: int, apply: Change) -> tuple[Any, Any, Any]:
    """A value with one word changed, and that word before and after; the value itself stays, since others may have it.

    `path` leads from the value to the word.
    """
    if isinstance(value, State):
        state = value.copy()
        container = state.elements if state.spec.in_elements(path[0]) else state.header
        return state, *_apply(container[path[0]][index : index + 1], apply)
    if isinstance(value, np.ndarray):
        array = value.copy()
        return array, *_apply(array.reshape(-1)[index : index + 1], apply)
    if not path:
        word = np.array([value]).astype(_scalar_type(value))
        before, after = _apply(word, apply)
        return type(value)(after), before, after
    first, *rest = path
    if isinstance(value, Memory):
        inner, before, after = _changed(getattr(value, first), rest, index, apply)
        memory = value.copy()
        object.__setattr__(memory, first, inner)  # it may be one that is replaced, never changed
        return memory, before, after
    key = list(value)[int(first)] if isinstance(value, dict) else int(first)
    inner, before, after = _changed(value[key], rest, index, apply)
    if isinstance(value, tuple):
        items = (*value[:key], inner, *value[key + 1 :])
        return type(value)(*items) if hasattr(value, "_fields") else items, before, after
    container = value.copy()
    container[key] = inner
    return container, before, after
