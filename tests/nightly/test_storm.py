"""A sample of the long test `storm`: one flipped bit in an input or in memory never stops or derails a kernel."""

import numpy as np
import pytest

from mavfi.detectors.detector import Alarm
from mavfi.kernels.planning.trajectory import POINT_LIMIT
from mavfi.states import STATES, WATCHING
from tests.nightly.tapes import ESTIMATOR, KernelTape, flip_array, record

KERNELS = ("point_cloud", "octomap", "collision_check", "planner", "trajectory", "waypoint", "pid", ESTIMATOR)
DETECTORS = set(WATCHING)
TRIALS = 20
"""Of each kernel and detector."""


@pytest.mark.slow
def test_a_flipped_bit_never_stops_a_kernel_or_a_detector():
    random, labels, tapes = np.random.default_rng(1), set(), record()
    assert {tape.name for tape in tapes} == {*KERNELS, *DETECTORS}
    for name in (*KERNELS, *sorted(DETECTORS)):
        tapes_of_name = [tape for tape in tapes if tape.name == name]
        for trial in range(TRIALS):
            tape = tapes_of_name[trial * len(tapes_of_name) // TRIALS]
            with np.errstate(all="ignore"):
                items = list(tape.play(random))
            (label,) = (item for item in items if isinstance(item, str))
            labels.add(label)
            for result in items:
                if isinstance(tape, KernelTape):
                    assert_published(result, label)
                else:
                    assert result is None or isinstance(result, (str, Alarm)), label
    assert len(labels) > TRIALS * len({tape.name for tape in tapes}) / 2


def assert_published(result, label):
    """A step gives messages of known types and bounded length; the label of the flip is among the results."""
    for state in [] if isinstance(result, str) else result:
        assert state.spec is STATES[state.spec.name], label
        assert len(state.elements) <= (POINT_LIMIT if state.spec.name == "planning.trajectory" else 2_000_000), label


def test_a_strike_flips_exactly_one_bit():
    random = np.random.default_rng(0)
    for dtype in (np.float64, np.float32, np.int32, np.uint8, np.int16):
        array = np.ones(7, dtype)
        before = np.frombuffer(array.tobytes(), np.uint8)
        flip_array(array, random)
        after = np.frombuffer(array.tobytes(), np.uint8)
        assert int(np.unpackbits(before ^ after).sum()) == 1
