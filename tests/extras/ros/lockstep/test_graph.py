"""Who publishes what to whom: derived from the kernels, with and without nodes in the way."""

from functools import cache

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.bench.sealed import Checksum, Duplicate
from mavfi.extras.ros.lockstep.host import configure, isolation
from mavfi.extras.ros.lockstep.plan import INJECTOR, WORLD, FlightGraph, FlightPlan
from mavfi.faults.fault import FaultSite
from mavfi.levels.state.fault import StateFault
from mavfi.pipeline.ppc import build_pipeline
from tests.core.flights.missions import mission
from tests.extras.ros.lockstep.needs import NOWHERE


@cache
def pipeline():
    return build_pipeline(configure(mission()))


def routes(injected):
    return FlightGraph(pipeline(), injected).routes


def test_every_kernel_is_run_by_one_node():
    nodes = FlightGraph(pipeline()).nodes
    assert sorted(kernel for kernels in nodes.values() for kernel in kernels) == sorted(pipeline())
    assert nodes["planner"] == ("planner", "trajectory")


@pytest.mark.parametrize("detector", [Checksum(), Duplicate()])
def test_detectors_that_take_part_in_what_is_not_published_are_refused(detector):
    with pytest.raises(
        BadInputError, match=rf"{type(detector).__name__}: takes part in what is not published; allowed"
    ):
        FlightPlan(NOWHERE, scenario := mission(), configure(scenario), detector=detector)


def test_a_fault_that_may_lose_a_message_is_refused():
    fault = StateFault(FaultSite("planning.path", "length_z"), 0, 31)
    with pytest.raises(BadInputError, match=r"planning.path.length_z: is the length of a list; allowed on ROS"):
        FlightPlan(NOWHERE, scenario := mission(), configure(scenario), fault)


def test_with_an_estimator_its_kernel_is_a_node_and_the_world_reads_what_it_says():
    plan = FlightPlan(NOWHERE, scenario := mission(localization="estimator"), configure(scenario))
    found = plan.graph.routes
    assert plan.nodes[0] == "state_estimation" and "sensor.odometry" not in found
    for sensor in ("sensor.imu", "sensor.position"):
        assert (found[sensor].writer, found[sensor].readers) == (WORLD, ("state_estimation",))
    estimate = found["perception.odometry"]
    assert estimate.writer == "state_estimation"
    assert estimate.readers == ("collision_check", "planner", "waypoint", "pid")
    assert plan.world_listens("perception.odometry")


def test_an_injector_sits_at_one_state():
    found = routes("planning.waypoint")
    way = found["planning.waypoint"]
    assert (way.first, way.nodes, way.sender) == (f"{way.final}/raw", ("waypoint", INJECTOR), INJECTOR)
    assert [name for name, other in found.items() if INJECTOR in other.nodes] == ["planning.waypoint"]


def test_without_a_private_network_there_is_no_flight(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BadInputError, match=r"no private network.*--allow-bind-all"):
        isolation()
    assert isolation(allow_bind_all=True) == []
