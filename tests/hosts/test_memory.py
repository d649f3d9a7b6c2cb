from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pytest

from mavfi.hosts import memory
from mavfi.states import new_state


@dataclass(slots=True)
class Slotted:
    number: float = 1.0
    items: list = field(default_factory=list)


class Pair(NamedTuple):
    one: np.ndarray
    two: float


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


class Thing:
    not_memory = ("scratch",)

    def __init__(self):
        self.array = np.arange(3.0)
        self.alias = self.array
        self.scratch = np.arange(3.0)
        self.slotted = Slotted(2.0, [np.zeros(2)])
        self.pair = Pair(np.ones(2), 3.0)
        self.table = {"a": [1, 2], "b": (np.zeros(1), None)}
        self.keeper = Keeper()
        self.state = new_state("control.command")


CHANGES = {
    "array": lambda t: t.array.__setitem__(1, np.nan),
    "zero": lambda t: t.array.__setitem__(0, -0.0),
    "dtype": lambda t: setattr(t, "array", t.array.astype(np.float32)),
    "slotted": lambda t: setattr(t.slotted, "number", -2.0),
    "nested": lambda t: t.slotted.items[0].__setitem__(0, 1.0),
    "longer": lambda t: t.slotted.items.append(1),
    "tuple": lambda t: t.pair.one.__setitem__(0, 0.0),
    "replaced": lambda t: setattr(t, "pair", Pair(np.ones(2), 3.5)),
    "dict": lambda t: t.table["a"].append(3),
    "order": lambda t: t.table.__setitem__("a", t.table.pop("a")),
    "kind": lambda t: setattr(t, "table", None),
    "own": lambda t: setattr(t.keeper, "value", 2),
    "state": lambda t: setattr(t, "state", new_state("control.tracking")),
    "new": lambda t: setattr(t, "more", 1),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_change_is_noticed_and_undone(change):
    thing = Thing()
    saved = memory.save(thing)
    assert memory.same(thing, saved)
    change(thing)
    assert not memory.same(thing, saved)
    for _ in range(2):  # and again: what is saved is not used up
        assert memory.restored(saved) is thing
        if change is CHANGES["new"]:
            del thing.more
        assert memory.same(thing, saved)
        assert thing.array.tobytes() == np.arange(3.0).tobytes()
        change(thing)


def test_scratch_is_left_alone():
    thing = Thing()
    saved = memory.save(thing)
    thing.scratch[0] = 7.0
    assert memory.same(thing, saved)
    memory.restored(saved)
    assert thing.scratch[0] == 7.0


def test_what_two_places_share_they_share_again():
    thing = Thing()
    saved = memory.save([thing, thing.array, thing.slotted.items])
    thing.array = np.zeros(1)
    back, array, items = memory.restored(saved)
    assert back is thing and array is thing.array is thing.alias and items is thing.slotted.items
    array[0] = 9.0
    assert not memory.same(thing.array, saved[1]), "what is restored is not what is saved"


def test_bits_count_not_values():
    assert memory.same(float("nan"), memory.save(float("nan")))
    assert not memory.same(0.0, -0.0)
    assert not memory.same(1, 1.0)
    assert not memory.same(True, 1)
    state = new_state("control.command")
    assert memory.same(state.copy(), memory.save(state))
    other = state.copy()
    other.header["vx"] = -0.0
    assert not memory.same(other, memory.save(state))


def test_what_cannot_be_saved_is_an_error():
    with pytest.raises(TypeError):
        memory.save({"generator": (number for number in ())})


def test_a_generator_of_random_numbers_is_saved():
    thing = {"random": np.random.default_rng(1)}
    saved = memory.save(thing)
    drawn = memory.restored(saved)["random"].random(3)
    assert drawn.tobytes() == memory.restored(saved)["random"].random(3).tobytes()
