import numpy as np
import pytest

from mavfi.detectors.gaussian import GaussianDetector
from mavfi.detectors.model import Model
from mavfi.detectors.scoring import NOT_FINITE
from mavfi.numerics import welford
from tests.core.unit.detectors.streams import command, flight, fly, later, strike

ORIGIN = {"stack": "published", "platform": "i9-9940x", "v_max": 3.0, "planner": "rrt_connect"}


def paper(statistics, sigmas=5.0):
    parameters = {"statistics": statistics, "sigmas": sigmas, "min_count": 20.0}
    return GaussianDetector(Model("gaussian", "paper", "paper-13", "interval", parameters, ORIGIN))


def trained(count, mean=0.0, sigma=1.0):
    return [[count, mean, sigma**2 * (count - 1.0)] for _ in range(13)]


def statistics(detector):
    """k, M, S of each field, from what the detector remembers."""
    (*_, learned), _ = detector.memory()
    return np.frombuffer(learned).reshape(13, 3)


def publish(detector, *states):
    alarms = []
    for number, state in enumerate(states):
        alarms.append(detector.check(state, 20_000 * number))
        detector.accept(state, 20_000 * number)
    return alarms


def test_an_alarm_is_n_deviations_away_from_the_mean():
    within, beyond = command([2.0**2, 0, 0]), command([2.0**3, 0, 0])  # 5 and 6 octaves above 0.25 m/s
    assert publish(paper(trained(1000.0)), command([0, 0, 0]), within) == [None, None]
    alarm = publish(paper(trained(1000.0)), command([0, 0, 0]), beyond)[1]
    assert (alarm.source, alarm.stage, alarm.fields) == ("gaussian", "control", ("control.command.vx",))
    assert alarm.score == pytest.approx(6 / 5)
    assert publish(paper(trained(1000.0), sigmas=6.0), command([0, 0, 0]), beyond) == [None, None]


def test_the_deviation_has_a_floor():
    still = trained(1000.0, sigma=0.0)
    assert publish(paper(still), command([0, 0, 0]), command([0.9, 0, 0]))[1] is None  # 2 codes <= 5 * 0.5
    assert publish(paper(still), command([0, 0, 0]), command([1.1, 0, 0]))[1] is not None  # 3 codes


def test_few_samples_raise_no_alarm_but_what_is_not_finite_does():
    assert publish(paper(trained(19.0)), command([0, 0, 0]), command([1e9, 0, 0]))[1] is None
    alarm = publish(paper(trained(0.0)), command([0, np.nan, np.inf]))[0]
    assert (alarm.score, alarm.fields) == (NOT_FINITE, ("control.command.vy", "control.command.vz"))


def test_statistics_continue_online_with_normal_values_only():
    detector = paper(trained(100.0))
    speeds = [0.0, 0.3, 0.9, 0.3, 1e12, 0.3, 0.3]
    publish(detector, *(command([speed, 0, 0]) for speed in speeds))
    expected = (100.0, 0.0, 99.0)
    for delta in (1, 1, -1, 0):  # the jump to 1e12 and the one back are left out
        expected = welford.update(*expected, float(delta))
    assert statistics(detector)[9] == pytest.approx(expected)
    detector.start()
    assert statistics(detector)[9] == pytest.approx((100.0, 0.0, 99.0))


def test_tuned_is_silent_in_golden_flights_and_sees_two_metres(models):
    detector = GaussianDetector(models["gaussian-tuned"])
    for seed in range(200, 206):
        events = flight(seed)
        assert fly(detector, events) == []
        for count in (7, 23):
            struck = later(events, "planning.waypoint", count)
            y = float(events[struck][0].header["y"][0])
            assert fly(detector, strike(events, struck, "y", y + 2.0))[0][0] == struck


@pytest.mark.parametrize(
    ("state", "count", "field", "value", "expected"),
    [
        ("planning.waypoint", 20, "x", -1e30, ("planning", False, False)),
        ("control.command", 333, "vy", 1e30, ("control", True, True)),
        ("perception.collision_status", 40, "future_collision_seq", 4096, ("control", False, False)),
    ],
)
def test_the_authors_gad_recomputes_planning_and_drops_a_command_with_its_way_point(
    models, state, count, field, value, expected
):
    detector = GaussianDetector(models["gaussian-tuned"], "published_gad")
    events = flight(400)
    struck = later(events, state, count)
    alarm = dict(fly(detector, strike(events, struck, field, value)))[struck]
    assert (alarm.stage, alarm.abandon_waypoint, alarm.withhold) == expected
    assert not alarm.stop
