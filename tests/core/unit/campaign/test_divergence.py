import numpy as np
import pytest

from mavfi.campaign.divergence import TimedState, departure, first_difference, spread
from mavfi.mission import MissionStatus
from mavfi.record import COLUMNS, FlightLog
from mavfi.states import STATES, new_state


def _publication(time_us, x=1.0, name="planning.waypoint"):
    state = new_state(name)
    state.header["x"] = x
    return TimedState(time_us, state)


def test_nan_and_negative_zero_differ_by_their_bits():
    assert first_difference([_publication(0, 0.0)], [_publication(0, -0.0)]).field == "x"
    assert first_difference([_publication(0, np.nan)], [_publication(0, np.nan)]) is None


def test_elements_and_lengths_of_lists_are_named():
    before, after, longer = new_state("planning.path", 3), new_state("planning.path", 3), new_state("planning.path", 4)
    after.elements["y"][2] = 1.0
    assert first_difference([TimedState(0, before)], [TimedState(0, after)]).field == "y[2]"
    difference = first_difference([TimedState(0, before)], [TimedState(0, longer)])
    assert (difference.field, difference.golden, difference.injected) == ("number of elements", 3, 4)


def test_publications_are_compared_by_state_and_number():
    """One state is held back; all else comes in another order, and is the same."""
    command = _publication(6, name="sensor.odometry")
    golden = [_publication(5), command, _publication(10, 2.0)]
    injected = [command, _publication(8), _publication(10, 3.0)]
    difference = first_difference(golden, injected)
    assert (difference.state, difference.field, difference.golden_us, difference.injected_us) == (
        "planning.waypoint",
        "",
        5,
        8,
    )
    injected = [_publication(5), command, _publication(12, 3.0)]
    difference = first_difference(golden, injected)
    assert (difference.field, difference.golden, difference.injected, difference.golden_us, difference.injected_us) == (
        "x",
        2.0,
        3.0,
        10,
        12,
    )


def test_the_first_in_time_is_reported_whatever_state_comes_first_in_the_lists():
    golden = [_publication(0), _publication(2, name="sensor.odometry"), _publication(9, name="sensor.odometry")]
    injected = [_publication(0), _publication(2, 5.0, name="sensor.odometry"), _publication(9, 7.0)]
    difference = first_difference(golden, injected)
    assert (difference.state, difference.time_us) == ("sensor.odometry", 2)


def test_a_publication_that_one_flight_alone_has():
    difference = first_difference([_publication(0)], [_publication(0), _publication(7)])
    assert (difference.golden_us, difference.injected_us) == (None, 7)
    difference = first_difference([_publication(0), _publication(7)], [_publication(0)])
    assert (difference.golden_us, difference.injected_us, difference.time_us) == (7, None, 7)


def _log(offsets, speed=1.0):
    """A flight along x with these offsets along y."""
    rows = np.zeros((len(offsets), len(COLUMNS)))
    rows[:, 0] = 0.02 * np.arange(len(offsets))
    rows[:, 1] = speed * rows[:, 0]
    rows[:, 2] = offsets
    return FlightLog(rows, MissionStatus.SUCCESS)


def test_departure_is_where_the_distance_exceeds_the_limit():
    left_path = departure(_log([0, 0, 0, 0, 0]), _log([0, 0.05, 0.2, 0.7, 0.3]))
    assert left_path.time_s == pytest.approx(0.04)
    assert left_path.position == pytest.approx((0.04, 0.2, 0.0))
    assert (left_path.largest_m, left_path.largest_s) == (pytest.approx(0.7), pytest.approx(0.06))
    assert left_path.behind_s == pytest.approx(0.0)


def test_a_flight_that_is_late_on_the_same_path_never_leaves_it():
    golden, slow = _log(np.zeros(101), speed=20.0), _log(np.zeros(201), speed=7.0)
    left_path = departure(golden, slow)
    assert left_path.time_s is None
    assert left_path.largest_m == pytest.approx(0.0, abs=1e-12)
    assert left_path.behind_s == pytest.approx(4.0 - 4.0 * 7.0 / 20.0)
    assert departure(slow, golden).behind_s == pytest.approx(2.0 - 4.0)  # beyond the end of the other path


def test_departure_of_a_corrupted_flight_is_infinite():
    assert departure(_log([0, 0, 0]), _log([0, np.nan, 0])).largest_m == np.inf
    assert departure(_log([0, 0, 0]), _log([0, 0, np.nan])).behind_s is None


def test_an_error_spreads_from_state_to_state_and_may_die_out():
    def odometry(time_us, x=1.0):
        return _publication(time_us, x, "sensor.odometry")

    golden = [_publication(0), odometry(1), _publication(2), odometry(3), _publication(4), odometry(5)]
    injected = [_publication(0), odometry(1), _publication(2, 9.0), odometry(3, 8.0), _publication(4), odometry(5, 8.0)]
    first, second = spread(golden, injected)
    assert (first.name, first.first_us, first.last_us, first.differing, first.compared) == (
        "planning.waypoint",
        2,
        2,
        1,
        3,
    )
    assert not first.to_the_end and second.to_the_end
    assert (second.name, second.first_us, second.kernel) == ("sensor.odometry", 3, STATES["sensor.odometry"].writer)
    late = [*golden[:-1], odometry(9)]
    assert spread(golden, late) == [], "an instant is no value"
