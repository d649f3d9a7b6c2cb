from dataclasses import replace

from mavfi.mission import MissionSpec
from tools.golden_rates import COLUMNS, GoldenFlight, row, settings

GOOD = GoldenFlight(
    seed=10_000,
    arrived=True,
    time_s=30.0,
    clearance_m=0.5,
    tracking_m=0.3,
    speed_share=1.05,
    plans=3,
    failed_plans=0,
    alarms=1,
    warnings=0,
)
LOST = replace(GOOD, seed=10_001, arrived=False, time_s=90.0, clearance_m=-0.1, plans=1, failed_plans=4)


def test_a_row_sums_its_flights_and_names_those_that_did_not_arrive():
    mission = MissionSpec(environment="dense", autopilot="hardened", v_max=5.0, wind=3.0)
    cells = dict(zip((column.key for column in COLUMNS), row(mission, [GOOD, LOST]), strict=True))
    assert cells["environment"] == "dense, wind gusts of 3 m/s" and cells["lost_seeds"] == "10001"
    assert (cells["arrived"].successes, cells["arrived"].n) == (1, 2)
    assert (cells["time_median"], cells["time_max"], cells["closest"]) == (30.0, 30.0, -0.1)
    assert (cells["replans_median"], cells["replans_max"], cells["failed_plans"]) == (1.0, 2, 4)


def test_every_setting_is_a_row_once():
    missions = [mission for _, mission in settings()]
    assert len({mission.model_dump_json() for mission in missions}) == len(missions)
    assert {mission.planner for mission in missions} == {"rrt", "rrt_connect", "rrt_star"}
