"""Flights whose pipeline does not get the true pose: what it sees, what faults and recomputation do to it."""

from functools import cache

import numpy as np
import pytest

from mavfi.config import LocalizationConfig
from mavfi.flight.compose import detector_for
from mavfi.flight.decide import RecoveryPolicy
from mavfi.flight.fly import fly
from mavfi.levels.memory.fault import MemoryFault
from mavfi.mission import MissionStatus
from mavfi.states import ODOMETRY, STATES, floats, states_with
from tests.core.flights.missions import (
    each_autopilot,
    ends_as_its_status_says,
    fault,
    golden,
    mission,
)

ESTIMATE = ODOMETRY["estimator"]


def estimating(autopilot="hardened", **figures):
    plain = mission(autopilot, localization="estimator")
    return plain.model_copy(update={"localization": LocalizationConfig(kind="estimator", **figures)})


class Seen:
    """Observer that keeps the publications of some states."""

    def __init__(self, *names):
        self.rows = {name: [] for name in names}

    def __call__(self, state, time_us):
        if state.spec.name in self.rows:
            self.rows[state.spec.name].append((time_us, state))


@cache
def flown(autopilot="hardened"):
    seen = Seen(ESTIMATE, "sensor.depth", "sensor.position", "sensor.imu")
    return fly(estimating(autopilot), profile=True, recorders=[seen]), seen.rows


@each_autopilot
def test_the_acceptance_test_reads_the_estimate(autopilot):
    scenario = mission(autopilot, localization="estimator")
    detector, _ = detector_for(scenario, "acceptance", "paper")
    log = fly(scenario, detector=detector).log
    assert not log.alarms and log.digest() == fly(scenario).log.digest()
    assert np.abs(detector.arrays()["vehicle"]).max() > 20.0, "the estimate at the end, not the start"


def errors(flight, estimates):
    """Distances of estimates at control ticks from the truth (m)."""
    log = flight.log
    at = {time: floats(state.header, 3) for time, state in estimates}
    times = np.round(1e6 * log.column("time")).astype(int)[:-1]
    return np.linalg.norm(np.array([at[time] for time in times]) - log.columns("x", "y", "z")[:-1], axis=1)


@pytest.mark.slow
@each_autopilot
def test_with_an_estimator_it_arrives_and_knows_where_it_is(autopilot):
    flight, rows = flown(autopilot)
    assert flight.log.status is MissionStatus.SUCCESS
    distances = errors(flight, rows[ESTIMATE])
    assert np.sqrt(np.mean(distances**2)) < 0.05 and distances.max() < 0.25
    assert flight.log.digest() != golden(autopilot).log.digest()
    assert fly(estimating(autopilot)).log.digest() == flight.log.digest()


@each_autopilot
def test_only_what_exists_is_published_counted_and_profiled(autopilot):
    counts = flown(autopilot)[0].log.meta["publications"]
    assert list(counts) == list(states_with("estimator")) and all(counts.values())
    assert ODOMETRY["truth"] not in counts
    assert list(flown(autopilot)[0].profile.times_us) == list(counts)
    calm = golden(autopilot)
    assert list(calm.log.meta["publications"]) == list(calm.profile.times_us) == list(states_with("truth"))
    assert "localization" not in calm.log.meta["scenario"] and "wind" not in calm.log.meta["scenario"]


def test_sensors_and_estimates_have_their_rates():
    _, rows = flown()
    assert (np.diff([time for time, _ in rows["sensor.imu"]]) == 4_000).all()
    assert (np.diff([time for time, _ in rows["sensor.position"]]) == 100_000).all()
    assert [time for time, _ in rows[ESTIMATE]] == [time for time, _ in rows["sensor.imu"]]


def test_images_carry_the_last_estimate_and_not_the_truth():
    flight, rows = flown()
    truth = flight.log.columns("x", "y", "z", "qw", "qx", "qy", "qz")
    times = np.array([time for time, _ in rows[ESTIMATE]])
    for time, image in rows["sensor.depth"]:
        last = rows[ESTIMATE][np.flatnonzero(times <= time)[-1]]
        assert time - last[0] < 4_000
        pose, believed = floats(image.header, 7), floats(last[1].header, 10)
        np.testing.assert_array_equal(pose, np.append(believed[:3], believed[6:]))
        assert not (truth == pose).all(axis=1).any()


@pytest.mark.slow
def test_without_noise_the_estimate_is_the_truth_but_for_the_steps_of_physics():
    seen = Seen(ESTIMATE)
    flight = fly(estimating(imu_noise=0.0, position_noise=0.0, heading_noise=0.0), recorders=[seen])
    assert flight.log.status is MissionStatus.SUCCESS
    assert errors(flight, seen.rows[ESTIMATE]).max() < 5e-3


@pytest.mark.slow
@each_autopilot
@pytest.mark.parametrize(
    ("state", "field", "bit"), [(ESTIMATE, "x", 56), (ESTIMATE, "y", 63), (ESTIMATE, "z", 62), ("sensor.imu", "fx", 54)]
)
def test_a_fault_in_what_the_vehicle_believes_changes_the_flight(state, field, bit, autopilot):
    flight = fly(estimating(autopilot), fault(state, field, 5.0, bit))
    assert flight.log.injections[0].activated
    assert flight.log.digest() != flown(autopilot)[0].log.digest()
    assert ends_as_its_status_says(flight)


@pytest.mark.slow
@pytest.mark.parametrize("field", [f.name for f in STATES[ESTIMATE].fields if f.dead_in("hardened")])
def test_a_fault_in_a_dead_field_of_the_estimate_is_masked(field):
    flight = fly(estimating(), fault(ESTIMATE, field, 5.0, 62))
    assert flight.log.injections[0].activated and flight.log.digest() == flown()[0].log.digest()


def watched(autopilot, fault, *recorders):
    """A flight under the acceptance test, with the recovery that goes with it."""
    scenario = mission(autopilot, localization="estimator", dead_node="readback")
    detector, _ = detector_for(scenario, "acceptance", "paper")
    recovery = RecoveryPolicy(grain="message", same_twice="escalate")
    return fly(scenario, fault, detector, recovery=recovery, recorders=recorders)


@pytest.mark.slow
@each_autopilot
@pytest.mark.parametrize(("field", "bit"), [("x", 52), ("z", 63), ("vy", 62), ("qz", 61), ("qw", 63)])
def test_a_corrupted_estimate_violates_its_rule_and_is_sent_again(field, bit, autopilot):
    log = watched(autopilot, fault(ESTIMATE, field, 5.0, bit)).log
    assert [(alarm.fields, alarm.action, alarm.outcome) for alarm in log.alarms] == [
        ((f"{ESTIMATE}.{field}",), "resend", "repaired")
    ]
    assert (log.rows == flown(autopilot)[0].log.rows).all()


@pytest.mark.slow
@each_autopilot
@pytest.mark.parametrize(("word", "bit"), [(0, 56), (2, 63), (4, 60), (10, 62)])
def test_a_filter_that_remembers_nonsense_is_restarted_where_it_was(word, bit, autopilot):
    seen = Seen(ESTIMATE)
    corrupted = MemoryFault("state_estimation", "filter.nominal", word, "f8", 5_000_000, bit)
    flight = watched(autopilot, corrupted, seen)
    assert [alarm.action for alarm in flight.log.alarms] == ["resend", "recompute", "restart"]
    assert {alarm.state for alarm in flight.log.alarms} == {ESTIMATE}
    assert flight.log.status is MissionStatus.SUCCESS
    truth = dict(zip(np.round(1e6 * flight.log.column("time")), flight.log.columns("x", "y", "z"), strict=True))
    pairs = [(floats(state.header, 3), truth[time]) for time, state in seen.rows[ESTIMATE] if time in truth]
    assert max(np.linalg.norm(estimate - there) for estimate, there in pairs) < 0.25


@pytest.mark.slow
@pytest.mark.parametrize(
    "figures",
    [
        {"position_noise": 1.0},
        {"imu_noise": 100.0},
        {"heading_noise": 0.3},
        {"imu_noise": 0.0, "position_noise": 0.0, "heading_noise": 0.0},
    ],
)
def test_the_rule_of_the_estimate_knows_the_noise_of_its_sensors(figures):
    scenario = estimating("published", **figures)
    detector, _ = detector_for(scenario, "acceptance", "paper")
    log = fly(scenario, detector=detector).log
    assert [alarm for alarm in log.alarms if alarm.state == ESTIMATE] == []


def test_wind_and_estimator_do_not_share_noise_with_anything():
    windy = mission("hardened", wind=3.0)
    assert fly(windy).world.digest() == golden("hardened").world.digest()
    assert fly(windy).log.digest() != golden("hardened").log.digest()
    assert flown()[0].world.digest() == golden("hardened").world.digest()
