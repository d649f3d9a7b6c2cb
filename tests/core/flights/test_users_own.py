"""The longer examples of a user's own map and vehicle, flown."""

import pytest
from examples.map_forgetting import ForgettingMap

from mavfi.flight.fly import fly
from mavfi.mission import MissionStatus
from tests.core.flights.missions import Scripted, each_autopilot, golden, mission

MAP = "examples.map_forgetting:ForgettingMap"
VEHICLE = "examples/vehicle/courier.yaml"


@each_autopilot
def test_the_example_of_a_map_flies_the_mission(autopilot, monkeypatch):
    monkeypatch.setattr(ForgettingMap, "memory", 8)  # the mission is short
    flight = fly(mission(autopilot, map=MAP))
    assert flight.log.status is MissionStatus.SUCCESS
    assert flight.log.digest() == fly(mission(autopilot, map=MAP)).log.digest()
    cells, all_known = ((f.pipeline["octomap"].map.log_odds != 0).sum() for f in (flight, golden(autopilot)))
    assert cells < 0.9 * all_known


def test_a_map_that_forgets_nothing_yet_flies_as_the_dense_one():
    flight = fly(mission(map=MAP))
    assert flight.log.digest() == golden().log.digest()


def test_a_recomputed_scan_is_the_same_with_the_example():
    detector = Scripted("perception.map_update", 5, "perception", times=3)
    log = fly(mission(map=MAP), detector=detector).log
    assert log.alarms[0].outcome == "accepted"


@pytest.mark.slow
@each_autopilot
def test_the_example_of_a_vehicle_flies_the_mission(autopilot, pytestconfig):
    vehicle = str(pytestconfig.rootpath / VEHICLE)
    flight = fly(mission(autopilot, vehicle=vehicle))
    assert flight.log.status is MissionStatus.SUCCESS
    assert flight.log.digest() != golden(autopilot).log.digest()
    assert flight.log.digest() == fly(mission(autopilot, vehicle=vehicle)).log.digest()
    assert flight.log.count("warning") == 0


def test_a_larger_collision_radius_keeps_more_distance(pytestconfig):
    from mavfi.flight.compose import pipeline_config

    vehicle = str(pytestconfig.rootpath / VEHICLE)
    plain, big = (pipeline_config(m, golden().world, None) for m in (mission(), mission(vehicle=vehicle)))
    assert big.plan_radius / plain.plan_radius == pytest.approx(0.45 / 0.35)


def test_a_shipped_vehicle_can_take_the_environment_s_place():
    scenario = mission(vehicle="small_quad")
    assert scenario.vehicle.name == scenario.environment.vehicle == "small_quad"
    assert mission(vehicle="airsim_quad") == mission()
