import numpy as np
import pytest

from mavfi.config import PlatformConfig, shipped
from mavfi.flight.fly import fly
from mavfi.states import STATES, states_with
from tests.core.flights.missions import each_autopilot, golden, mission

CAUSES = {
    "perception.point_cloud": ("sensor.depth",),
    "perception.map_update": ("perception.point_cloud",),
    "planning.trajectory": ("planning.path",),
}


def publications(scenario):
    seen = {name: [] for name in states_with(scenario.localization.kind)}
    flight = fly(scenario, recorders=[lambda state, time_us: seen[state.spec.name].append(time_us)])
    return seen, flight


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["i9-9940x", "cortex-a57"])
@each_autopilot
def test_nothing_is_seen_before_its_latency_has_passed(autopilot, platform):
    seen, _ = publications(mission(autopilot, platform=platform))
    latency = shipped("platforms", PlatformConfig, platform).latency_us
    for name, causes in CAUSES.items():
        due = {time + latency[STATES[name].writer] for cause in causes for time in seen[cause]}
        assert seen[name] and set(seen[name]) <= due
    captured = np.array(seen["sensor.depth"][: len(seen["perception.map_update"])])
    whole = latency["point_cloud"] + latency["octomap"]
    assert (np.array(seen["perception.map_update"]) - captured == whole).all()
    status = np.array(seen["perception.collision_status"])
    triggers = np.array(seen["perception.map_update"] + seen["planning.trajectory"])
    assert np.isin(status - latency["collision_check"], triggers).all() or autopilot == "hardened"
    ticks = np.array(seen["control.command"]) - latency["pid"]
    assert (ticks % 20_000 == 0).all() and len(set(ticks)) == len(ticks)


def test_perception_runs_back_to_back_and_ten_times_a_second_at_most():
    seen, _ = publications(mission())
    gaps = np.diff(seen["sensor.depth"])
    assert (gaps == 289_000).all()
    platform = mission().platform
    fast = platform.model_copy(update={"latency_us": dict.fromkeys(platform.latency_us, 1000)})
    seen, _ = publications(mission().model_copy(update={"platform": fast}))
    assert (np.diff(seen["sensor.depth"]) == 100_000).all()


@each_autopilot
def test_the_log_counts_what_was_published_and_what_it_cost(autopilot):
    seen, flight = publications(mission(autopilot))
    meta = flight.log.meta
    assert meta["publications"] == {name: len(times) for name, times in seen.items()}
    latency = mission(autopilot).platform.latency_us
    assert meta["compute_us"]["planner"] == latency["planner"] * len(seen["planning.path"])
    steps = meta["compute_us"]["pid"] / latency["pid"]
    assert 0 <= steps - len(seen["control.command"]) <= 1  # the last one may not have been seen any more
    assert set(meta["recompute_us"].values()) == {0}


def test_the_profile_lists_the_publications_that_consumers_act_on():
    profile = golden().profile
    seen, flight = publications(mission())
    for name, times in seen.items():
        if not STATES[name].acted_on:
            assert profile.times_us[name].tolist() == times
    assert len(profile.times_us["perception.collision_status"]) == flight.log.count("collision_predicted")
    assert (profile.counts["sensor.depth"] == 64 * 48).all()


def test_rows_are_written_once_in_each_control_period():
    time = golden().log.column("time")
    np.testing.assert_allclose(np.diff(time), 0.02, atol=1e-9)
    assert time[0] == 0.0
