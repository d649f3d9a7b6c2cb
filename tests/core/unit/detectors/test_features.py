import numpy as np
import pytest

from mavfi.detectors import features
from mavfi.detectors.preprocess import Preprocessor
from mavfi.errors import BadInputError
from mavfi.states import ODOMETRY
from tests.core.unit.detectors.streams import command, odometry, status, waypoint


class Stream:
    """Deltas of one publication after the other."""

    def __init__(self, profile, prediction="interval", monitored="paper-13"):
        self.preprocessor = Preprocessor(monitored, profile, prediction)

    def publish(self, state):
        if state.spec.name == ODOMETRY["truth"]:
            features.note_vehicle(state.header.view(np.uint8), self.preprocessor.watch.vehicle)
        slot = self.preprocessor.slots.get(state.spec.name)
        if slot is None:
            return None, None
        deltas = np.zeros(len(self.preprocessor.fields), np.int16)
        content, watch = state.header.view(np.uint8), self.preprocessor.watch
        regime = features.measure(content, slot, watch, deltas)
        features.commit(content, slot, watch)
        first, last = self.preprocessor.range_of(slot)
        return deltas[first:last].tolist(), regime


def test_a_status_has_the_octaves_of_its_time_and_the_difference_of_its_counter():
    for profile in ("paper", "tuned"):
        stream = Stream(profile)
        stream.publish(status(30.0, 0))
        assert stream.publish(status(6.0, 1))[0] == [-2, 1]
        assert stream.publish(status(6.0, -(2**31)))[0] == [0, -32767]
        assert stream.publish(status(6.0, 2**31 - 1))[0] == [0, 32767]


@pytest.mark.parametrize(("prediction", "x"), [("interval", 11.5), ("trapezoid", 11.0)])
def test_the_first_way_point_of_a_trajectory_is_predicted_from_the_vehicle(prediction, x):
    stream = Stream("tuned", prediction)
    stream.publish(waypoint([90.0, 0.0, 2.0], [2.0, 0.0, 0.0], trajectory=1))
    stream.publish(odometry([10.0, 5.0, 2.0], [1.0, 0.0, 0.0]))
    deltas, regime = stream.publish(waypoint([x, 5.0, 2.0], [3.0, 0.0, 0.0], trajectory=2))
    assert deltas[:3] == [0] * 3
    assert regime == features.NEW_TRAJECTORY
    assert stream.publish(waypoint([x, 6.5, 2.0], [3.0, 0, 0], trajectory=3))[0][1] == 4


def test_a_yaw_that_wraps_is_no_jump_and_one_that_explodes_is():
    stream = Stream("tuned")
    stream.publish(waypoint([0, 0, 0], [0, 0, 0], yaw=3.1))
    assert stream.publish(waypoint([0, 0, 0], [0, 0, 0], yaw=-3.1))[0][3] == 0
    assert stream.publish(waypoint([0, 0, 0], [0, 0, 0], yaw=1e200))[0][3] > 600


def test_a_command_knows_what_was_planned_since_the_last_one():
    stream = Stream("tuned")
    events = [
        (waypoint([0, 0, 0], [1, 0, 0], trajectory=1), features.NEW_TRAJECTORY),
        (command([1, 0, 0]), features.NEW_TRAJECTORY),
        (command([1, 0, 0]), features.PLAIN),
        (waypoint([0.5, 0, 0], [1, 0, 0], trajectory=1), features.SWITCH),
        (command([1, 0, 0]), features.SWITCH),
        (waypoint([0, 0, 0], [1, 0, 0], trajectory=2), features.NEW_TRAJECTORY),
        (waypoint([0.5, 0, 0], [1, 0, 0], trajectory=2), features.SWITCH),
        (command([1, 0, 0]), features.NEW_TRAJECTORY),
        (status(30.0, 0), features.NEW_TRAJECTORY),
        (status(30.0, 0), features.PLAIN),
    ]
    assert [stream.publish(state)[1] for state, _ in events] == [regime for _, regime in events]


@pytest.mark.parametrize("profile", ["paper", "tuned"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_said_by_itself_and_never_overflows(profile, value):
    stream = Stream(profile)
    stream.publish(waypoint([1.0, 2.0, 3.0], [1.0, 0.0, 0.0]))
    stream.publish(waypoint([1.5, 2.0, 3.0], [1.0, 0.0, 0.0]))
    deltas, regime = stream.publish(waypoint([2.0, 2.0, value], [1.0, 0.0, 0.0]))
    assert regime == -1 - features.SWITCH
    assert abs(deltas[2]) > 1000
    deltas, regime = stream.publish(waypoint([1.7e308, -1.7e308, 3.0], [-1.7e308, 1.7e308, 0.0]))
    assert regime == features.SWITCH
    assert abs(deltas[0]) > 1000


@pytest.mark.parametrize(
    "names", [("paper-14", "paper", "interval"), ("paper-13", "best", "interval"), ("paper-13", "tuned", "x")]
)
def test_unknown_names_are_refused_with_what_is_allowed(names):
    with pytest.raises(BadInputError, match="not known.*; allowed: "):
        Preprocessor(*names)
