"""A user's own map: what is asked of it, and the example."""

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.kernels.perception.octomap import UpdateRule, insert_scan
from mavfi.pipeline import maps
from mavfi.pipeline.functions import PLAIN
from mavfi.pipeline.maps import DenseMap, make_map

FRAME = KeyFrame(0.5, 0.25, 0.25, 0.25, 0, 0, 0, 20, 20, 20)
RULE = UpdateRule(0.85, -0.4, -2.0, 3.5)
SIZE = 8000


class Own:
    """A map that does nothing; the tests break it."""

    answer = (np.zeros(1, np.int32), np.zeros(1, np.float32))

    def __init__(self, frame, rule, max_range):
        self.log_odds = np.zeros(frame.nx * frame.ny * frame.nz, np.float32)

    def insert(self, points, origin):
        return self.answer

    def mark(self):
        pass

    def rollback(self):
        pass


def custom_map(monkeypatch, **broken):
    """A map of the class above with other attributes."""
    kind = type("Own", (Own,), broken)
    monkeypatch.setattr(maps, "find_map", lambda name: kind)
    return make_map("mine:Own", FRAME, RULE, 5.0)


def scan(*points):
    return np.array(points, np.float32).reshape(-1, 3), np.array([1.0, 5.0, 5.0])


def raising(*_):
    raise RuntimeError("two\nlines")


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ({"rollback": None}, "lacks rollback"),
        ({"__init__": lambda self: None}, "cannot be built .TypeError"),
        (
            {"log_odds": property(lambda self: np.zeros(3, np.float32)), "__init__": lambda self, *_: None},
            r"log_odds has shape \(3,\); allowed: \(8000,\)",
        ),
        (
            {"log_odds": property(lambda self: np.zeros(SIZE)), "__init__": lambda self, *_: None},
            "log_odds is float64; allowed: float32",
        ),
    ],
)
def test_a_class_that_does_not_fit_is_found_when_it_is_built(monkeypatch, broken, message):
    with pytest.raises(BadInputError, match=f"map 'mine:Own': {message}"):
        custom_map(monkeypatch, **broken)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "insert raised TypeError"),
        (
            (np.zeros(2, np.int32), np.zeros(3, np.float32)),
            r"gave shapes \(2,\) and \(3,\); allowed: \(n,\) and \(n,\)",
        ),
        ((np.zeros(2, np.int64), np.zeros(2, np.float32)), "gave int64 and float32; allowed: int32 and float32"),
        ((np.array([0, SIZE], np.int32), np.zeros(2, np.float32)), "gave voxels from 0 to 8000; allowed: 0 to 7999"),
    ],
)
def test_an_answer_that_does_not_fit_is_found_at_the_first_scan(monkeypatch, answer, message):
    guarded = custom_map(monkeypatch, answer=answer)
    with pytest.raises(BadInputError, match=message) as caught:
        guarded.insert(*scan())
    assert str(caught.value).startswith("map 'mine:Own': ") and "\n" not in str(caught.value)


def test_what_a_map_raises_is_one_line_that_names_it(monkeypatch):
    guarded = custom_map(monkeypatch, insert=raising)
    with pytest.raises(BadInputError, match="map 'mine:Own': insert raised RuntimeError: two lines"):
        guarded.insert(*scan())


@pytest.mark.parametrize("rewindable", [False, True])
def test_a_voxel_outside_of_the_grid_ends_the_step(rewindable):
    def corrupted(*args):
        count = insert_scan(*args)
        args[8][count - 1] = SIZE  # the list of updated voxels
        return count

    functions = PLAIN.instrumented(("insert_scan",), lambda name, function: corrupted)
    dense = DenseMap(FRAME, RULE, 5.0, functions, rewindable=rewindable)
    with pytest.raises(IndexError, match="8000 is out of bounds"):
        dense.insert(*scan((4.0, 5.0, 5.0)))
