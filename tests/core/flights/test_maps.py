import numpy as np
import pytest

from mavfi.config import MapConfig
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec
from tests.core.flights.missions import AUTOPILOTS, Scripted, each_autopilot, fault, golden, mission


def of_kind(scenario, kind, resolution=0.5):
    return scenario.model_copy(update={"map": MapConfig(kind=kind, resolution=resolution)})


@pytest.mark.slow
@each_autopilot
def test_a_flight_with_an_octree_has_the_digest_of_one_with_an_array(autopilot):
    flight = fly(mission(autopilot, map="octree"), profile=True)
    assert flight.log.digest() == golden(autopilot).log.digest()
    assert flight.log.events == golden(autopilot).log.events
    dense, octree = golden(autopilot).pipeline["octomap"].map, flight.pipeline["octomap"].map
    assert type(dense) is not type(octree)
    assert dense.log_odds.tobytes() == octree.log_odds.tobytes()
    for name, lengths in flight.profile.counts.items():
        np.testing.assert_array_equal(lengths, golden(autopilot).profile.counts[name])


@pytest.mark.slow
@each_autopilot
def test_a_recomputed_perception_is_the_same_with_both_maps(autopilot):
    logs = []
    for kind in ("dense", "octree"):
        detector = Scripted("perception.map_update", 5, "perception", times=3)
        logs.append(fly(mission(autopilot, map=kind), detector=detector).log)
    assert logs[0].alarms == logs[1].alarms and logs[0].alarms[0].outcome == "accepted"
    assert logs[0].digest() == logs[1].digest()


def test_a_struck_cloud_ends_the_same_with_both_maps():
    struck = fault("perception.point_cloud", "x", 5.0, 30, element=7)
    logs = [fly(mission(map=kind), struck).log for kind in ("dense", "octree")]
    assert logs[0].injections[0].activated and logs[0].digest() == logs[1].digest()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("environment", "autopilot"),
    [
        pytest.param(
            environment, autopilot, marks=() if (environment, autopilot) == ("dense", "published") else pytest.mark.long
        )
        for environment in ("dense", "factory", "sparse", "farm")
        for autopilot in AUTOPILOTS
    ],
)
def test_whole_missions_have_the_same_digest_with_both_maps(environment, autopilot):
    for seed, resolution in ((0, 0.5), (1, 0.5), (2, 0.4)):
        scenario = resolve(MissionSpec(environment=environment, seed=seed, autopilot=autopilot))
        logs = [fly(of_kind(scenario, kind, resolution)).log for kind in ("dense", "octree")]
        assert logs[0].digest() == logs[1].digest()
