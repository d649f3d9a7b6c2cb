"""Short missions, flown once each, and what else tests need."""

from functools import cache

import numpy as np
import pytest

from mavfi.detectors import Alarm, Detector
from mavfi.faults.fault import FaultSite
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.levels.state.fault import StateFault
from mavfi.mission import ARRIVAL_RADIUS, FLY_AWAY_MARGIN, MissionSpec, MissionStatus, time_limit
from mavfi.sim.environments.generated import arena_world
from tests.night import at_night

AUTOPILOTS = ("published", "hardened")
each_autopilot = pytest.mark.parametrize("autopilot", ["published", *at_night("hardened")])
"""By day the default profile, at night both."""
GOAL = (22.0, -4.0, 3.0)
"""There is a predicted collision and a second plan on the way."""
FAR_GOAL = (45.0, 5.0, 3.0)
"""Behind an obstacle: planners differ."""


def mission(autopilot="published", goal=GOAL, **changes):
    """22 m through dense boxes, about 8 s; to the far goal 35 m, about 15 s."""
    return resolve(MissionSpec(environment="dense", seed=1, autopilot=autopilot, goal=goal, **changes))


@cache
def golden(autopilot="published"):
    return fly(mission(autopilot), profile=True)


def fault(state, field, at, bit=None, element=None):
    return StateFault(FaultSite(state, field, element), int(1e6 * at), bit)


def ends_as_its_status_says(flight):
    """Whether the last row of the record is where, or when, a mission with that status ends."""
    world, status, scenario = flight.world, flight.log.status, mission()
    at = flight.log.columns("x", "y", "z")[-1]
    home = np.linalg.norm(at - world.goal) < ARRIVAL_RADIUS
    outside = np.maximum(world.arena_lower - at, at - world.arena_upper).max() > FLY_AWAY_MARGIN
    late = flight.log.column("time")[-1] >= 0.99 * time_limit(world.course, scenario.v_max, scenario.platform)
    expected = {MissionStatus.SUCCESS: home, MissionStatus.FLY_AWAY: outside, MissionStatus.TIMEOUT: late}
    return expected.get(status, not (home or outside or late))


class Scripted(Detector):
    """A detector that alarms at the n-th publication of one state, and remembers what it was shown."""

    def __init__(self, state="", n=10, stage="control", times=1, **alarm):
        self.state, self.n, self.stage, self.times, self.alarm = state, n, stage, times, alarm

    def start(self):
        self.seen, self.accepted, self.alarmed = 0, [], []

    def check(self, state, time_us):
        if state.spec.name != self.state:
            return None
        self.seen += 1
        if not self.n <= self.seen < self.n + self.times:
            return None
        self.alarmed.append((time_us, state.copy()))
        return Alarm("scripted", self.stage, **self.alarm)

    def accept(self, state, time_us):
        self.accepted.append((time_us, state.spec.name))


def walled(seed, start=None, goal=None):
    """A start in a closed yard."""
    del seed
    lower = [(5.0, -8.0, 0.0), (5.0, 7.0, 0.0), (4.0, -8.0, 0.0), (20.0, -8.0, 0.0)]
    upper = [(21.0, -7.0, 12.0), (21.0, 8.0, 12.0), (5.0, 8.0, 12.0), (21.0, 8.0, 12.0)]
    ends = (start or (12.0, 0.0, 3.0), goal or (60.0, 0.0, 3.0))
    return arena_world(np.array(lower), np.array(upper), *(np.array(end, float) for end in ends))
