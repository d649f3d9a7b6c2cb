from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pytest

from mavfi.pipeline.memory import Memory, OpaqueKeeper, Remembers, copied, same
from mavfi.states import new_state


class Pair(NamedTuple):
    one: np.ndarray
    two: float


@dataclass(slots=True)
class Inner(Memory):
    number: float = 1.0
    items: list = field(default_factory=list)


@dataclass(slots=True)
class Outer(Memory):
    array: np.ndarray = field(default_factory=lambda: np.arange(3.0))
    inner: Inner = field(default_factory=lambda: Inner(2.0, [np.zeros(2)]))
    pair: Pair = field(default_factory=lambda: Pair(np.ones(2), 3.0))
    table: dict = field(default_factory=lambda: {"a": [1, 2], "b": (np.zeros(1), None)})
    state: object = field(default_factory=lambda: new_state("control.command"))


class Keeper:
    """Saves itself."""

    def __init__(self):
        self.value = 1

    def save(self):
        return self.value

    def restore(self, saved):
        self.value = saved

    def same(self, saved):
        return self.value == saved

    def arrays(self):
        return {}


class Thing(Remembers):
    def __init__(self):
        self.memory, self.keepers, self.scratch = Outer(), (Keeper(),), np.zeros(3)


CHANGES = {
    "array": lambda t: t.memory.array.__setitem__(1, np.nan),
    "zero": lambda t: t.memory.array.__setitem__(0, -0.0),
    "dtype": lambda t: setattr(t.memory, "array", t.memory.array.astype(np.float32)),
    "inner": lambda t: setattr(t.memory.inner, "number", -2.0),
    "longer": lambda t: t.memory.inner.items.append(1),
    "tuple": lambda t: t.memory.pair.one.__setitem__(0, 0.0),
    "dict": lambda t: t.memory.table["a"].append(3),
    "kind": lambda t: setattr(t.memory, "table", None),
    "keeper": lambda t: setattr(t.keepers[0], "value", 2),
    "state": lambda t: setattr(t.memory, "state", new_state("control.tracking")),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_change_is_noticed_and_undone(change):
    thing = Thing()
    saved, print_ = thing.save(), thing.fingerprint()
    assert thing.same(saved) and Thing().fingerprint() == print_
    change(thing)
    assert not thing.same(saved)
    assert thing.fingerprint() != print_
    for _ in range(2):  # and again: what is saved is not used up
        thing.restore(saved)
        assert thing.same(saved) and thing.fingerprint() == print_
        assert thing.memory.array.tobytes() == np.arange(3.0).tobytes()
        change(thing)


def test_scratch_is_left_alone():
    thing = Thing()
    saved, print_ = thing.save(), thing.fingerprint()
    thing.scratch[0] = 7.0
    assert thing.same(saved) and thing.fingerprint() == print_
    thing.restore(saved)
    assert thing.scratch[0] == 7.0


def test_bits_count_not_values():
    assert same(float("nan"), float("nan"))
    assert not same(0.0, -0.0)
    assert not same(1, 1.0)
    assert not same(True, 1)
    state = new_state("control.command")
    assert same(copied([state]), [state])


class Own:
    """A thing of a user's own."""

    def __init__(self):
        self.random, self.seen = np.random.default_rng(1), [np.zeros(2)]


def test_a_thing_of_a_users_own_is_copied_whole():
    keeper = OpaqueKeeper(Own())
    saved = keeper.save()
    assert keeper.same(saved)
    keeper.content.seen[0][0] = 1.0
    drawn = keeper.content.random.random(3)
    assert not keeper.same(saved)
    for _ in range(2):
        keeper.restore(saved)
        assert keeper.same(saved) and keeper.content.seen[0][0] == 0.0
        assert keeper.content.random.random(3).tobytes() == drawn.tobytes()
