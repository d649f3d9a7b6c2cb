import numpy as np
import pytest

from mavfi.detectors.gaussian import GaussianDetector
from mavfi.detectors.model import Model
from mavfi.detectors.scoring import NOT_FINITE
from mavfi.numerics import welford
from tests.core.unit.detectors.streams import command, flight, fly, later, status, strike, waypoint

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


def test_the_stage_of_an_alarm_is_that_of_its_state():
    detector = paper(trained(1000.0))
    first = [status(30.0, 0), waypoint([1, 0, 0], [0, 0, 0]), command([0, 0, 0])]
    struck = [status(30.0, 99), waypoint([1e9, 0, 0], [0, 0, 0]), command([0, 0, -1e9])]
    assert [alarm.stage for alarm in publish(detector, *first, *struck)[3:]] == ["perception", "planning", "control"]


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


def test_check_remembers_nothing(models):
    for name in ("gaussian-paper", "gaussian-tuned"):
        detector, undisturbed = GaussianDetector(models[name]), GaussianDetector(models[name])
        for state, time_us in flight(77, ticks=200):
            for strange in (command([np.nan, 1e300, 0]), waypoint([5e5, 0, 0], [0, 0, 0], trajectory=9), status(0, 7)):
                detector.check(strange, time_us + 3)
            assert detector.check(state, time_us) == undisturbed.check(state, time_us)
            detector.accept(state, time_us)
            undisturbed.accept(state, time_us)
            assert detector.memory() == undisturbed.memory()


def test_a_big_flip_is_caught_on_its_publication(models):
    events = flight(101)
    struck = later(events, "planning.waypoint", 20)
    x = float(events[struck][0].header["x"][0])
    detector = GaussianDetector(models["gaussian-paper"])
    before = [number for number, _ in fly(detector, events)]
    alarms = dict(fly(detector, strike(events, struck, "x", x * 2.0**64)))
    assert struck not in before
    assert alarms[struck].fields == ("planning.waypoint.x",)
    assert alarms[struck].stage == "planning"


def test_tuned_is_silent_in_golden_flights_and_sees_two_metres(models):
    detector = GaussianDetector(models["gaussian-tuned"])
    for seed in range(200, 206):
        events = flight(seed)
        assert fly(detector, events) == []
        for count in (7, 23):
            struck = later(events, "planning.waypoint", count)
            y = float(events[struck][0].header["y"][0])
            assert fly(detector, strike(events, struck, "y", y + 2.0))[0][0] == struck


def test_tuned_sees_a_command_between_switches_that_would_be_normal_at_one(models):
    events = flight(300)
    commands = [number for number, (state, _) in enumerate(events) if state.spec.name == "control.command"]
    quiet = commands[330]
    vx = float(events[quiet][0].header["vx"][0])
    alarms = fly(GaussianDetector(models["gaussian-tuned"]), strike(events, quiet, "vx", vx + 2.0))
    assert alarms[0][0] == quiet
    assert alarms[0][1].stage == "control"
