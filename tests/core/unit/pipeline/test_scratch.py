"""Work arrays at earlier instants: as they were, whatever happened since."""

import numpy as np
import pytest

from mavfi.errors import MavfiError
from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.kernels.perception.octomap import UpdateRule
from mavfi.pipeline.maps import DenseMap

FRAME = KeyFrame(0.5, 0.25, 0.25, 0.25, 0, 0, 0, 20, 20, 10)
RULE = UpdateRule(*(np.float32(value) for value in (0.85, -0.4, -2.0, 3.5)))
ARRAYS = ("stamp", "touched", "before", "log_odds")


def scan(seed):
    random = np.random.default_rng(seed)
    points = random.uniform((0.5, 0.5, 0.5), (9.5, 9.5, 4.5), (60, 3)).astype(np.float32)
    return points, np.array([5.0, 5.0, 2.5])


def contents(one):
    return {name: getattr(one._arrays, name).copy() for name in ARRAYS} | {"number": one._arrays.number}


@pytest.fixture
def flown():
    """A map after six scans, one of which was undone; what it saved after each, and the contents then."""
    one, saved, then = DenseMap(FRAME, RULE, 8.0, rewindable=True), [], []
    for seed in range(6):
        one.mark()
        one.insert(*scan(seed))
        if seed == 2:
            one.rollback()
        saved.append((one.save(), one.scratch[0].save()))
        then.append(contents(one))
    return one, saved, then


def back_to(one, saved):
    memory, scratch = saved
    one.restore(memory)
    one.scratch[0].restore(scratch)
    one.scratch[0].fill()


@pytest.mark.parametrize("order", [(0, 3, 5), (5, 4, 0), (2, 3, 2), (1, 1, 4)])
def test_arrays_of_a_map_are_as_they_were(flown, order):
    one, saved, then = flown
    for place in order:
        back_to(one, saved[place])
        now = contents(one)
        assert all(np.array_equal(now[name], then[place][name]) for name in (*ARRAYS, "number"))


def test_scans_that_do_not_lead_to_the_map_are_refused(flown):
    one, saved, _ = flown
    one.restore(saved[4][0])
    one.scratch[0].restore(saved[3][1])
    with pytest.raises(MavfiError, match="a map differs from its scans"):
        one.scratch[0].fill()
