import json

import pytest

from mavfi.config import PlatformConfig, parse, shipped
from mavfi.errors import BadInputError
from mavfi.flight.compose import resolve
from mavfi.mission import MissionSpec, Scenario, time_limit

LATER = {
    "arrival_radius": 8.0,
    "time_limit_factor": 9.0,
    "latency_jitter": 1.0,
    "planner_latency": 3.0,
    "detector_place": "published",
}
"""Keys that earlier versions did not have, at other values than their defaults."""


def test_the_time_limit_is_150_s_at_the_defaults():
    platform = shipped("platforms", PlatformConfig, "i9-9940x")
    assert time_limit(100.0, 3.0, platform) == pytest.approx(150.0)
    slow = shipped("platforms", PlatformConfig, "cortex-a57")
    assert time_limit(100.0, 3.0, slow) == pytest.approx(150.0 * slow.time_limit_factor)
    assert time_limit(50.0, 1.5, platform) == pytest.approx(150.0)


def test_the_range_of_the_camera_is_the_missions_or_the_environments():
    assert resolve(MissionSpec(environment="sparse")).camera.range == 20.0
    assert resolve(MissionSpec(environment="sparse", camera_range=7.0, depth_noise=0.01)).camera.range == 7.0


def test_a_scenario_survives_json_with_the_same_key():
    scenario = resolve(MissionSpec(environment="dense", seed=7, autopilot="hardened", start=(10.0, 0.0, 3.0)))
    text = json.dumps(scenario.to_json())
    again = Scenario.model_validate(json.loads(text))
    assert again == scenario and again.key() == scenario.key()


def test_renamed_fields_are_stored_by_their_older_names_and_read_by_both():
    scenario = resolve(MissionSpec(environment="dense", seed=7))
    data = scenario.to_json()
    assert list(data)[:4] == ["environment", "seed", "stack", "vehicle"] and list(data["vehicle"])[4] == "hull_radius"
    newer = {**data, "vehicle": {**data["vehicle"]}}
    newer["autopilot"] = newer.pop("stack")
    newer["vehicle"]["collision_radius"] = newer["vehicle"].pop("hull_radius")
    assert Scenario.model_validate(newer) == Scenario.model_validate(data) == scenario


def test_options_that_are_off_are_not_in_the_key():
    plain = resolve(MissionSpec(environment="dense", seed=7)).to_json()
    assert not {"wind", "localization", "dead_node", *LATER} & set(plain) and "alarm" not in plain["stack"]
    assert not set(LATER) & set(MissionSpec().to_json())
    assert set(LATER.items()) <= set(MissionSpec(**LATER).to_json().items())
    on = {"wind": 2.0, "localization": "estimator", "dead_node": "readback", "alarm": "repeated"}
    full = resolve(MissionSpec(environment="dense", seed=7, **on))
    data = json.loads(json.dumps(full.to_json()))
    assert data["wind"]["gust"] == 2.0 and data["localization"]["kind"] == "estimator"
    assert data["dead_node"] == "readback" and data["stack"]["alarm"] == "repeated"
    assert Scenario.model_validate(data) == full


def test_whatever_decides_the_flight_changes_the_key():
    base = {"environment": "dense", "seed": 7}
    changes = [
        {},
        {"seed": 8},
        {"environment": "sparse"},
        {"autopilot": "hardened"},
        {"platform": "cortex-a57"},
        {"v_max": 2.0},
        {"goal": (50.0, 0.0, 3.0)},
        {"depth_noise": 0.1},
        {"wind": 3.0},
        {"localization": "estimator"},
        {"dead_node": "end"},
        {"alarm": "repeated"},
        {"epoch_liveness": 1.0},
        {"arrival_radius": 8.0},
        {"time_limit_factor": 9.0},
        {"latency_jitter": 1.0},
    ]
    assert len({resolve(MissionSpec(**base | change)).key() for change in changes}) == len(changes)


def test_an_older_name_of_a_key_is_read_only_from_what_mavfi_stored():
    with pytest.raises(BadInputError, match=r"^own.yaml: unknown key 'stack'"):
        parse(MissionSpec, {"stack": "hardened"}, "own.yaml")
    assert parse(MissionSpec, {"stack": "hardened"}, "own.yaml", stored=True) == MissionSpec(autopilot="hardened")


def test_a_mission_changes_rules_of_its_profile():
    plain = resolve(MissionSpec(autopilot="hardened"))
    assert resolve(MissionSpec(autopilot="hardened", alarm="one_shot", epoch_liveness=3.0)) == plain
    profile = resolve(MissionSpec(autopilot="hardened", alarm="repeated", epoch_liveness=0.0)).autopilot
    assert profile == plain.autopilot.model_copy(update={"alarm": "repeated", "epoch_liveness": 0.0})
