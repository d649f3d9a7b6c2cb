import pytest

from mavfi.campaign.golden import GoldenFlight, Row, Setting, fly_row, measure
from mavfi.errors import BadInputError

FARM = Setting("farm", "hardened")


def flight(seed=1, status="success", time_s=30.0):
    return GoldenFlight(seed, status, time_s, 150.0, 0.5, 0.3, 1.05, 2, 0, 1, 0, (1.0, 2.0, 3.0), "")


def test_a_row_counts_successes_and_takes_times_of_flights_that_arrived():
    row = Row(FARM, (flight(1, time_s=30.0), flight(2, time_s=40.0), flight(3, "timeout", 150.0)))
    assert (row.success.successes, row.success.n) == (2, 3)
    assert row.flight_times() == pytest.approx((35.0, 39.5, 40.0))
    assert [lost.seed for lost in row.failures()] == [3]
    assert Row(FARM, (flight(status="collision"),)).flight_times() is None


def test_the_command_flies_the_mission_again():
    setting = Setting("dense", "hardened", platform="cortex-a57", v_max=5.0, depth_noise=0.02)
    words = setting.command(10_003).split()
    options = dict(zip(words[2::2], words[3::2], strict=True))
    assert options == {
        "--environment": "dense", "--seed": "10003", "--stack": "hardened", "--planner": "rrt_connect",
        "--platform": "cortex-a57", "--v-max": "5", "--depth-noise": "0.02", "--picture": "flight.png",
    }  # fmt: skip
    scenario = setting.scenario(10_003)
    assert (scenario.v_max, scenario.camera.noise, scenario.platform.name) == (5.0, 0.02, "cortex-a57")


def test_a_flight_is_judged_by_the_true_world():
    one = measure((FARM, 10_000))
    assert one.success and one.events == "" and one.warnings == 0
    assert 0.15 < one.clearance_m < 10.0 and 0.0 < one.tracking_m < 1.0 and 0.9 < one.speed_share < 1.1
    assert 25.0 < one.time_s < one.limit_s == pytest.approx(150.0, abs=10.0)


def test_a_flight_that_did_not_arrive_tells_its_last_events(monkeypatch):
    from mavfi.hosts import inprocess

    monkeypatch.setattr(inprocess, "time_limit", lambda *_: 6.0)
    one = measure((Setting("dense", "hardened"), 1))
    assert one.status == "timeout" and one.time_s == pytest.approx(6.0)
    assert "s trajectory seq 1, points " in one.events


def test_rows_are_flown_in_the_order_of_seeds_on_any_number_of_workers():
    seen = []
    row = fly_row(FARM, 3, 2, 20_000, lambda done, wanted: seen.append((done, wanted)))
    assert [one.seed for one in row.flights] == [20_000, 20_001, 20_002]
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert fly_row(FARM, 1, 1, 20_001).flights == row.flights[1:2]


def test_what_cannot_be_flown_is_told_before_the_first_flight():
    with pytest.raises(BadInputError, match="nowhere"):
        fly_row(Setting("nowhere", "hardened"), 1, 1)
