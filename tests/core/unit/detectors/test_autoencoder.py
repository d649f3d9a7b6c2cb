import pytest

from mavfi.detectors.autoencoder import AutoencoderDetector
from tests.core.unit.detectors.streams import flight, fly, later, strike


@pytest.fixture
def events():
    return flight(400)


@pytest.mark.slow
def test_the_paper_policy_recomputes_control_and_abandons_a_struck_way_point(models, events):
    detector = AutoencoderDetector(models["autoencoder-paper"], "paper")
    struck = later(events, "planning.waypoint", 20)
    alarms = dict(fly(detector, strike(events, struck, "x", -1e30)))
    assert (alarms[struck].stage, alarms[struck].abandon_waypoint, alarms[struck].stop) == ("control", True, False)
    assert alarms[struck].fields == ("planning.waypoint.x",)
    struck = later(events, "control.command", 333)
    alarms = dict(fly(detector, strike(events, struck, "vy", 1e30)))
    assert (alarms[struck].stage, alarms[struck].abandon_waypoint, alarms[struck].stop) == ("control", False, False)


def test_alarms_persist_when_the_way_point_in_force_was_anomalous_too(models, events):
    detector = AutoencoderDetector(models["autoencoder-paper"], "paper")
    first, second = (later(events, "planning.waypoint", count) for count in (20, 21))
    alarms = dict(fly(detector, strike(strike(events, first, "x", -1e30), second, "x", 1e30)))
    assert (alarms[first].stop, alarms[second].stop) == (False, True)


def test_the_authors_aad_drops_the_way_point_and_stops_at_the_second_anomaly_of_a_state(models, events):
    for state, field in (("planning.waypoint", "x"), ("control.command", "vy")):
        detector = AutoencoderDetector(models["autoencoder-paper"], "published_aad")
        first, second = (later(events, state, count) for count in (20, 21))
        alarms = dict(fly(detector, strike(strike(events, first, field, -1e30), second, field, 1e30)))
        for struck, stop in ((first, False), (second, True)):
            alarm = alarms[struck]
            assert (alarm.stage, alarm.abandon_waypoint, alarm.withhold, alarm.stop) == ("control", True, True, stop)
    struck = later(events, "perception.collision_status", 10)
    alarm = dict(fly(detector, strike(events, struck, "future_collision_seq", 4096)))[struck]
    assert (alarm.stage, alarm.abandon_waypoint, alarm.withhold, alarm.stop) == ("control", False, False, False)


def test_an_accepted_anomaly_is_not_held_against_what_follows(models, events):
    for name in ("autoencoder-paper", "autoencoder-tuned"):
        detector = AutoencoderDetector(models[name])
        golden = {number for number, _ in fly(detector, events)}
        struck, after = (later(events, "planning.waypoint", count) for count in (20, 21))
        alarms = {number for number, _ in fly(detector, strike(events, struck, "x", -1e30))} - golden
        assert alarms == {struck, after}  # the jump there and the jump back, no command in between


@pytest.mark.parametrize(
    ("name", "count", "field", "value", "stage"),
    [
        ("perception.collision_status", 40, "future_collision_seq", 4096, "perception"),
        ("planning.waypoint", 20, "vx", -1e20, "planning"),
        ("control.command", 333, "vz", 1e20, "control"),
    ],
)
def test_the_keyed_policy_recomputes_the_stage_of_the_largest_residual(
    models, events, name, count, field, value, stage
):
    struck = later(events, name, count)
    alarms = dict(fly(AutoencoderDetector(models["autoencoder-tuned"]), strike(events, struck, field, value)))
    assert (alarms[struck].stage, alarms[struck].abandon_waypoint) == (stage, False)


def test_tuned_is_silent_in_golden_flights_and_sees_two_metres(models):
    detector = AutoencoderDetector(models["autoencoder-tuned"])
    for seed in range(500, 504):
        golden = flight(seed)
        assert len(fly(detector, golden)) <= 1  # 30 flights of training are few
        struck = later(golden, "planning.waypoint", 23)
        y = float(golden[struck][0].header["y"][0])
        assert struck in dict(fly(detector, strike(golden, struck, "y", y + 2.0)))
