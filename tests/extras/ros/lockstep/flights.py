"""Short flights on ROS, and the comparison with those of one process."""

import json

from mavfi.extras.ros.lockstep.host import configure, fly
from mavfi.extras.ros.lockstep.plan import FlightPlan
from mavfi.flight.compose import resolve
from mavfi.mission import MissionSpec
from tests.extras.ros.lockstep.needs import ANY, find

NODES = ("point_cloud", "octomap", "collision_check", "planner", "waypoint", "pid")
SHORT = (16.0, 0.0, 3.0)


def short(**changes):
    return resolve(MissionSpec(environment="sparse", seed=7, goal=SHORT, **changes))


def plan(scenario, fault=None, detector=None, ros=ANY, **options):
    return FlightPlan(find(ros), scenario, configure(scenario), fault, detector, **options)


def there(scenario, fault=None, detector=None, **options):
    return fly(plan(scenario, fault, detector, **options)).flight.log


def same(log, other):
    """Whether two records agree in everything: bits, events, injections, alarms, counts."""
    assert log.digest() == other.digest()
    assert log.alarms == other.alarms
    assert [injection.to_json() for injection in log.injections] == [
        injection.to_json() for injection in other.injections
    ]  # infinity is text
    assert json.loads(json.dumps(log.meta)) == json.loads(json.dumps(other.meta))
    assert log.events == other.events
