from pathlib import Path

import numpy as np
import pytest

from mavfi.flight.compose import new_loop
from mavfi.flight.fly import fly
from mavfi.flight.latencies import Latencies
from mavfi.mission import MissionStatus
from mavfi.states import STATES, states_with
from tests.core.flights.missions import AUTOPILOTS, each_autopilot, ends_as_its_status_says, fault, golden, mission
from tests.night import at_night

ROOT = Path(__file__).parents[3]


@each_autopilot
def test_the_short_mission_succeeds_and_replans(autopilot):
    log = golden(autopilot).log
    assert log.status is MissionStatus.SUCCESS
    assert log.count("plan") >= 2 and log.count("collision_predicted") >= 1
    assert np.isfinite(log.rows).all()
    assert log.injections == [] and log.alarms == []


@each_autopilot
def test_the_same_scenario_gives_the_same_bytes(autopilot):
    again = fly(mission(autopilot))
    assert again.log.digest() == golden(autopilot).log.digest()
    assert again.log.rows.tobytes() == golden(autopilot).log.rows.tobytes()
    assert again.log.events == golden(autopilot).log.events


def test_jitter_of_latencies_is_a_function_of_the_seed():
    scenario = mission(latency_jitter=1.0)
    jittered = fly(scenario).log
    assert jittered.digest() == fly(scenario).log.digest() != golden().log.digest()
    # the same world and pipeline, whose latencies another seed draws
    loop = new_loop(scenario)
    loop.latencies = Latencies(scenario.platform, scenario.seed + 1, scenario.latency_jitter)
    assert not np.array_equal(loop.fly().log.rows, jittered.rows)


@pytest.mark.slow
@each_autopilot
@pytest.mark.parametrize("state", states_with("truth"))
def test_a_null_fault_gives_the_golden_digest(state, autopilot):
    spec = STATES[state]
    flight = fly(mission(autopilot), fault(state, spec.fields[0].name, 5.0))
    assert flight.log.digest() == golden(autopilot).log.digest()
    (injection,) = flight.log.injections
    published = (golden(autopilot).profile.times_us[state] >= 5_000_000).any()
    assert injection.activated == published
    assert injection.before == injection.after


ONE_OF_EACH_STAGE = ("perception.collision_status", "planning.waypoint", "control.command")
DEAD = [
    (autopilot, state, field.name)
    for autopilot in AUTOPILOTS
    for state, spec in states_with("truth").items()
    for field in spec.fields
    if field.dead_in(autopilot)
]
DEAD_BY_DAY = [case for case in DEAD if case[0] == "published"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("autopilot", "state", "field"), [*DEAD_BY_DAY, *at_night(*(case for case in DEAD if case not in DEAD_BY_DAY))]
)
def test_a_fault_in_a_dead_field_is_masked(autopilot, state, field):
    kind = STATES[state].find(field).dtype
    struck = 0.5 * golden(autopilot).profile.times_us[state][[0, -1]].sum() * 1e-6
    bit = {"f8": 62, "i4": 30, "?": 0}[kind]
    flight = fly(mission(autopilot), fault(state, field, struck, bit, element=0))
    assert flight.log.injections[0].activated
    assert flight.log.digest() == golden(autopilot).log.digest()


@each_autopilot
def test_injected_twins_are_equal_until_the_fault_and_differ_after(autopilot):
    flight = fly(mission(autopilot), fault("planning.waypoint", "y", 4.0, 60))
    (injection,) = flight.log.injections
    assert injection.activated and injection.before != injection.after
    ours, theirs = flight.log.rows, golden(autopilot).log.rows
    n = min(len(ours), len(theirs))
    differs = (ours[:n] != theirs[:n]).any(axis=1)
    before = ours[:n, 0] <= injection.time_s
    assert differs.any() and not differs[before].any()


@each_autopilot
def test_a_fault_strikes_the_first_publication_at_or_after_its_time_once(autopilot):
    times = golden(autopilot).profile.times_us["planning.waypoint"]
    due = times[times >= 4_000_000][0]
    changed = []

    def watch(state, time_us):
        if state.spec.name == "planning.waypoint" and abs(state.header["z"][0]) > 100.0:
            changed.append(time_us)

    flight = fly(mission(autopilot), fault("planning.waypoint", "z", 4.0, 61), recorders=[watch])
    assert flight.log.injections[0].time_s == pytest.approx(1e-6 * due)
    assert changed == [due]


@pytest.mark.slow
@each_autopilot
@pytest.mark.parametrize(
    "state", [*ONE_OF_EACH_STAGE, *at_night(*(name for name in states_with("truth") if name not in ONE_OF_EACH_STAGE))]
)
def test_a_flipped_exponent_in_any_field_ends_in_a_status(state, autopilot):
    spec = STATES[state]
    times = golden(autopilot).profile.times_us[state]
    for name in dict.fromkeys(field.name for field in spec.fields):
        bit = {"f8": 62, "f4": 30, "i4": 30, "?": 0}[spec.find(name).dtype]
        flight = fly(mission(autopilot), fault(state, name, 1e-6 * times[len(times) // 2], bit, element=0))
        log = flight.log
        assert log.injections[0].activated and ends_as_its_status_says(flight)
        assert np.isfinite(log.columns("x", "y", "z", "vx", "vy", "vz")).all()
