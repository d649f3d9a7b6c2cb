"""Words of a memory: found, named and changed."""

import struct
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.pipeline.memory import Memory, Remembers, same
from mavfi.pipeline.words import Words, change, collapsed, words_of
from mavfi.states import new_state


def test_names_that_differ_only_in_indices_are_told_as_one():
    names = ["odometry", *(f"crumbs[{index}].x" for index in range(60)), "paths[0].x[1]", "last[2]"]
    assert collapsed(names) == ["odometry", "crumbs[...].x", "paths[0].x[1]", "last[2]"]


@dataclass(frozen=True, slots=True)
class Inner(Memory):
    number: int = 3
    ratio: float = -0.5
    ready: bool = False


@dataclass(slots=True)
class Outer(Memory):
    inner: Inner = field(default_factory=Inner)
    array: np.ndarray = field(default_factory=lambda: np.arange(6.0).reshape(2, 3))
    clock: tuple = (1.0, 2, True)
    crumbs: list = field(default_factory=lambda: [np.zeros(2), np.ones(2)])
    table: dict = field(default_factory=lambda: {7: new_state("planning.trajectory", 2), 9: None})
    state: object = field(default_factory=lambda: new_state("planning.waypoint"))
    text: str = "no word"
    marked: tuple = (1, 2.0)


class Map:
    def __init__(self):
        self.cells = np.zeros(5, np.uint8)

    def save(self):
        return self.cells.copy()

    def arrays(self):
        return {"cells": self.cells}


class Kernel(Remembers):
    def __init__(self):
        self.memory, self.keepers = Outer(), (Map(),)


def flipping(bit):
    def apply(word):
        raw = np.frombuffer(word.tobytes(), np.uint8).copy()
        raw[bit // 8] ^= 1 << bit % 8
        word[:] = raw.view(word.dtype)

    return apply


FOUND = {words.name: words for words in words_of(Kernel())}
PLACES = [(words, index) for words in FOUND.values() for index in range(words.count)]


def test_every_number_is_found_once_and_nothing_else():
    names = [words.name for words in words_of(Kernel())]
    assert len(names) == len(set(names))
    assert {"inner.number", "inner.ratio", "inner.ready", "array", "clock[0]", "clock[1]", "clock[2]", "cells"} <= set(
        names
    )
    assert {"crumbs[0]", "crumbs[1]", "table[0].x", "table[0].trajectory_seq", "state.index"} <= set(names)
    assert not [name for name in names if name.startswith(("marked", "text", "table[1]"))]
    assert FOUND["array"] == Words("array", "f8", 6) and FOUND["table[0].x"] == Words("table[0].x", "f8", 2)
    assert [FOUND[f"clock[{index}]"].dtype for index in range(3)] == ["f8", "i4", "?"]
    assert FOUND["cells"] == Words("cells", "u1", 5)


@given(st.sampled_from(PLACES), st.data())
def test_a_change_reaches_one_word_and_the_same_change_takes_it_back(word_index, data):
    words, index = word_index
    bit = data.draw(st.integers(0, 0 if words.dtype == "?" else 8 * np.dtype(words.dtype).itemsize - 1))
    kernel, twin = Kernel(), Kernel()
    before, after = change(kernel, words.name, index, flipping(bit))
    values, golden = contents(kernel), contents(twin)
    assert [word_index for word_index in values if values[word_index] != golden[word_index]] == [(words.name, index)]
    again = change(kernel, words.name, index, flipping(bit))
    assert bits(again[0]) == bits(after) and bits(again[1]) == bits(before) and contents(kernel) == golden
    assert kernel.memory.same(twin.memory)


def bits(value):
    return struct.pack("d", value)


def contents(kernel):
    """Every word by name and index, as it is read without a change."""
    places = [(words.name, index) for words in words_of(kernel) for index in range(words.count)]
    return {place: bits(change(kernel, *place, lambda word: None)[0]) for place in places}


def test_what_others_hold_stays_as_it_is():
    kernel = Kernel()
    state, inner, array, saved = kernel.memory.state, kernel.memory.inner, kernel.memory.array, kernel.save()
    for name in ("state.x", "inner.number", "array", "clock[1]", "crumbs[1]", "table[0].y"):
        assert change(kernel, name, 0, flipping(3)) is not None
    assert same(state, new_state("planning.waypoint")) and inner == Inner() and same(saved[0], Outer())
    assert array.sum() == 15.0 and not kernel.memory.same(saved[0])


@pytest.mark.parametrize(("name", "index"), [("nothing", 0), ("array", 6), ("table[3].x", 0), ("marked[0]", 0)])
def test_no_such_word_changes_nothing(name, index):
    kernel = Kernel()
    assert change(kernel, name, index, flipping(0)) is None and kernel.memory.same(Outer())


@pytest.mark.parametrize(
    ("text", "name", "indices"),
    [
        ("array", "array", range(6)),
        ("array[4]", "array", range(4, 5)),
        ("number", "inner.number", range(1)),
        ("inner", "inner.number", range(1)),
        ("umber", "inner.number", range(0)),
        ("table.x", "table[0].x", range(2)),
        ("x[1]", "table[0].x", range(1, 2)),
        ("table[1].x", "table[0].x", range(0)),
        ("clock[0]", "clock[1]", range(0)),
        ("clock", "clock[1]", range(1)),
        ("array[x]", "array", range(0)),
    ],
)
def test_words_are_named_by_the_end_of_their_name_or_a_part_of_it(text, name, indices):
    assert list(FOUND[name].named(text)) == list(indices)
