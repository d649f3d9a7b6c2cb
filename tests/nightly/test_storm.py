"""A sample of the long test `storm`: one flipped bit in a kernel's input or memory never stops or derails a kernel."""

from functools import cache

import numpy as np
import pytest

from mavfi.detectors.detector import Alarm
from mavfi.kernels.planning.trajectory import POINT_LIMIT
from mavfi.states import BASELINES, STATES, WATCHING
from tests.nightly.tapes import AUTOPILOTS, ESTIMATOR, flip_array, play, record
from tests.nightly.watching import play_watching, record_watching

KERNELS = ("point_cloud", "octomap", "collision_check", "planner", "trajectory", "waypoint", "pid")
TRIALS = 25


@cache
def tapes():
    return record()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "autopilot"),
    [*((name, autopilot) for name in KERNELS for autopilot in AUTOPILOTS), (ESTIMATOR, "hardened")],
)
def test_a_flipped_bit_never_stops_a_kernel(name, autopilot):
    chosen = [tape for tape in tapes() if tape.name == name and tape.autopilot == autopilot]
    assert chosen
    random = np.random.default_rng([*KERNELS, ESTIMATOR].index(name))
    labels = set()
    with np.errstate(all="ignore"):
        for trial in range(TRIALS):
            label, outputs = "", []
            for item in play(chosen[trial % len(chosen)], random):
                if isinstance(item, str):
                    label = item
                    labels.add(label)
                else:
                    outputs += item
            assert all(state.spec is STATES[state.spec.name] for state in outputs), label
            assert all(len(state.elements) <= 2_000_000 for state in outputs), label
            assert all(len(s.elements) <= POINT_LIMIT for s in outputs if s.spec.name == "planning.trajectory"), label
    assert len(labels) > TRIALS // 2


@pytest.mark.slow
def test_a_flipped_bit_in_the_memory_of_a_detector_never_makes_it_raise():
    random, tapes, labels = np.random.default_rng(5), record_watching(), set()
    assert {tape.name for tape in tapes} == set(WATCHING) - set(BASELINES)
    with np.errstate(all="ignore"):
        for trial in range(4 * TRIALS):
            for item in play_watching(tapes[trial % len(tapes)], random):
                labels |= {item} if isinstance(item, str) else set()
                assert item is None or isinstance(item, (str, Alarm))
    assert len(labels) > 3 * TRIALS


def test_a_strike_flips_exactly_one_bit():
    random = np.random.default_rng(0)
    for dtype in (np.float64, np.float32, np.int32, np.uint8, np.int16):
        array = np.ones(7, dtype)
        before = np.frombuffer(array.tobytes(), np.uint8)
        flip_array(array, random)
        after = np.frombuffer(array.tobytes(), np.uint8)
        assert int(np.unpackbits(before ^ after).sum()) == 1
