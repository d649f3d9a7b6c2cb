"""Small plug-ins with compiled functions, which tests fly: planner, map, detector, flight controller."""

import numpy as np

from mavfi.detectors import Alarm, Detector
from mavfi.kernels.perception.octomap import insert_scan
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.random import seed_generator
from mavfi.pipeline.control import Tracker
from mavfi.pipeline.maps import DenseMap
from mavfi.pipeline.waypoints import SetpointGenerator
from mavfi.sim.cascade import Cascade
from mavfi.states import floats


@kernel_jit
def blend(share, a, b):
    return (1.0 - share) * a + share * b


@kernel_jit
def track(start, goal, height, path):
    """Way-points at a height; named as a function of mavfi."""
    for n in range(len(path)):
        share = n / (len(path) - 1)
        for axis in range(3):
            path[n, axis] = blend(share, start[axis], goal[axis])
        if 0 < n < len(path) - 1:
            path[n, 2] += height
    return len(path)


class Straight:
    compiled = (track,)

    def __init__(self, config, seed):
        self.random = seed_generator(seed, 1)
        self.heights = np.full(3, 0.3)

    def arrays(self):
        return {"heights": self.heights}

    def search(self, counter, grid, start, goal, lower, upper):
        path = np.zeros((4, 3))
        return path[: track(start, goal, height=float(self.heights[0]), path=path)]


def make_straight(config, seed):
    return Straight(config, seed)


make_straight.compiled = (track,)


class Wrapped(DenseMap):
    """The map of mavfi, whose own function it names."""

    compiled = {"insert": insert_scan}


@kernel_jit
def largest(command):
    size = 0.0
    for axis in range(len(command)):
        size = max(size, abs(command[axis]))
    return size


class Largest(Detector):
    source = "too_large"

    def __init__(self, limit=50.0):
        self.limits = np.array([limit])

    @property
    def compiled(self):
        return {"judge": largest}

    def arrays(self):
        return {"limits": self.limits}

    def check(self, state, time_us):
        if state.spec.name == "control.command" and not largest(floats(state.header, 3)) <= self.limits[0]:
            return Alarm("too_large", stage="control")


@kernel_jit
def limited(thrusts, most, result):
    for rotor in range(4):
        result[rotor] = min(max(thrusts[rotor], 0.0), most)


class Limited(Cascade):
    compiled = (limited,)

    def __init__(self, start):
        super().__init__(start)
        self._most = start.vehicle.max_rotor_thrust

    def arrays(self):
        return {"memory": self.memory}

    def rotors(self, time_us, setpoint, odometry, force):
        result = np.zeros(4)
        limited(super().rotors(time_us, setpoint, odometry, force), self._most, result)
        return result


def plain(values):
    return values.sum()


class Plain(Straight):
    compiled = ()


class Uncompiled(Straight):
    compiled = (plain,)


class Twice(Straight):
    compiled = (track, track)


class Text(Straight):
    compiled = "track"


class pid(Straight):  # noqa: N801 - the name of a kernel
    pass


@kernel_jit
def shifted(point, height):
    point[2] += height


class Higher(SetpointGenerator):
    """Way-points a little higher."""

    compiled = (shifted,)

    def step(self, time_us):
        states = super().step(time_us)
        for state in states:
            shifted(floats(state.header, 7), 0.01)
        return states


@kernel_jit
def steer(waypoint, odometry, command):
    for axis in range(3):
        command[axis] = waypoint[4 + axis] + 1.5 * (waypoint[axis] - odometry[axis])


class Proportional(Tracker):
    """A proportional controller."""

    compiled = (steer,)

    def step(self, time_us):
        command, tracking = super().step(time_us)
        if self.memory.waypoint is not None:
            steer(floats(self.memory.waypoint.header, 11), self.memory.odometry, floats(command.header, 4))
        return [command, tracking]
