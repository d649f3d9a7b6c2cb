from dataclasses import replace

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.hosts.loop.compose import resolve
from tools import golden
from tools.golden import GoldenFlight, Row, Setting, fly_row, measure, turns_back

FARM = Setting.of("farm", "hardened")


def flight(seed=1, status="success", time_s=30.0):
    return GoldenFlight(seed, status, time_s, 150.0, 0.5, 0.3, 1.05, 2, 0, 1, 0, (1.0, 2.0, 3.0), "", "")


def test_a_row_counts_successes_and_takes_times_of_flights_that_arrived():
    row = Row(FARM, (flight(1, time_s=30.0), flight(2, time_s=40.0), flight(3, "timeout", 150.0)))
    assert (row.success.successes, row.success.n) == (2, 3)
    assert row.flight_times() == pytest.approx((35.0, 39.5, 40.0))
    assert [lost.seed for lost in row.failures()] == [3]
    assert Row(FARM, (flight(status="collision"),)).flight_times() is None


def test_the_command_flies_the_mission_again():
    setting = Setting.of("dense", "hardened", platform="cortex-a57", v_max=5.0, depth_noise=0.02)
    words = setting.command(10_003).split()
    options = dict(zip(words[2::2], words[3::2], strict=True))
    assert options == {
        "--environment": "dense", "--seed": "10003", "--autopilot": "hardened", "--planner": "rrt_connect",
        "--platform": "cortex-a57", "--v-max": "5", "--depth-noise": "0.02", "--picture": "flight.png",
    }  # fmt: skip
    scenario = resolve(setting.spec(10_003))
    assert (scenario.v_max, scenario.camera.noise, scenario.platform.name) == (5.0, 0.02, "cortex-a57")


def test_ends_and_resolution_reach_mission_and_command():
    setting = Setting.of("dense", "hardened", map_resolution=0.25, start=(12.0, -1.5, 3.0), goal=(100.0, 0.0, 3.0))
    scenario, command = resolve(setting.spec(1)), setting.command(1)
    assert (scenario.map.resolution, scenario.start, scenario.goal) == (0.25, (12.0, -1.5, 3.0), (100.0, 0.0, 3.0))
    assert "--start 12 -1.5 3 --goal 100 0 3 " in command and "--map-resolution 0.25 " in command
    assert resolve(FARM.spec(1)).map.resolution == 0.5 and "--map-resolution" not in FARM.command(1)


def test_bars_are_met_or_not():
    wanted = replace(FARM, least=97, quality=True)
    good = [flight(seed) for seed in range(97)]
    lost = [flight(seed, "timeout") for seed in range(97, 101)]
    assert [bar.met for bar in Row(wanted, (*good, *lost[:3])).bars()] == [True] * 4
    assert [bar.met for bar in Row(wanted, (*good, *lost)).bars()] == [False, True, True, True]
    for change in ({"clearance_m": 0.149}, {"tracking_m": 1.0}, {"speed_share": 1.101}):
        bars = Row(wanted, (*good, replace(lost[0], **change))).bars()
        assert sum(not bar.met for bar in bars) == 1
    assert Row(FARM, (flight(),)).bars() == []


def test_going_back_counts_once_until_the_goal_comes_nearer_again():
    assert turns_back(np.array([50.0, 40.0, 44.0, 30.0, 20.0])) == 0
    assert turns_back(np.array([50.0, 40.0, 46.0, 60.0, 57.0, 58.0, 30.0])) == 1
    assert turns_back(np.array([50.0, 40.0, 46.0, 40.0, 46.0, 10.0])) == 2


def test_wind_and_localization_are_part_of_a_setting():
    setting = Setting.of("dense", "published", wind=3.0, localization="estimator")
    assert "--wind 3 --localization estimator" in setting.command(1)
    scenario = resolve(setting.spec(1))
    assert (scenario.wind.gust, scenario.localization.kind) == (3.0, "estimator")


def test_a_flight_is_judged_by_the_true_world():
    one = measure((FARM, 10_000))
    assert one.success and one.events == "" and one.warnings == 0
    assert 0.15 < one.clearance_m < 10.0 and 0.0 < one.tracking_m < 1.0 and 0.9 < one.speed_share < 1.1
    assert 25.0 < one.time_s < one.limit_s == pytest.approx(150.0, abs=10.0)


def test_a_flight_that_did_not_arrive_tells_its_last_events(monkeypatch):
    monkeypatch.setattr("mavfi.hosts.loop.judge.time_limit", lambda *_: 6.0)
    one = measure((Setting.of("dense", "hardened"), 1))
    assert one.status == "timeout" and one.time_s == pytest.approx(6.0)
    assert "s trajectory seq 1, points " in one.events
    assert one.cause.startswith("flew ") and one.cause.endswith("turned back 0 times")


def test_a_collision_tells_whether_the_map_knew(monkeypatch):
    flown = []
    fly = golden.fly
    monkeypatch.setattr(golden, "fly", lambda scenario: flown.append(fly(scenario)) or flown[-1])
    monkeypatch.setattr(
        "mavfi.pipeline.clearance_map.ClearanceMap.apply", lambda clearance, _: setattr(clearance, "updates", 1)
    )  # blind
    one = measure((Setting.of("dense", "published"), 1))
    assert one.status == "collision" and one.clearance_m < 0.01
    assert one.cause.startswith("touched what its map had not seen, ")
    clearance = flown[0].pipeline["planner"].clearance_map
    clearance.cells[:] = 2
    monkeypatch.setattr(golden, "fly", lambda scenario: flown[0])
    assert measure((Setting.of("dense", "published"), 1)).cause.startswith("touched what its map held for occupied, ")


@pytest.mark.slow
def test_rows_are_flown_in_the_order_of_seeds_on_any_number_of_workers():
    seen = []
    row = fly_row(FARM, 3, 2, 20_000, lambda done, wanted: seen.append((done, wanted)))
    assert [one.seed for one in row.flights] == [20_000, 20_001, 20_002]
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert fly_row(FARM, 1, 1, 20_001).flights == row.flights[1:2]


def test_what_cannot_be_flown_is_refused_before_the_first_flight():
    with pytest.raises(BadInputError, match="nowhere"):
        fly_row(Setting.of("nowhere", "hardened"), 1, 1)
