"""A flight that is put back to any of its instants goes on as it went on the first time, bit for bit."""

import gc
import weakref
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest

from mavfi.campaign.tools import host_tools
from mavfi.detectors import Alarm
from mavfi.errors import BadInputError
from mavfi.hosts import checkpoints, memory
from mavfi.hosts.local import Host, fly
from mavfi.sim.simulator import Simulator
from mavfi.states import STATES
from tests.hosts.missions import STACKS, fault, mission

KERNELS = ("point_cloud", "octomap", "collision_check", "planner", "trajectory", "waypoint", "pid")


class Nervous:
    """Alarms at every n-th publication of some states, so that every stage is run again now and then."""

    pitch = {"perception.collision_status": 3, "planning.path": 2, "planning.waypoint": 9, "control.command": 97}

    def start(self):
        self.accepted = dict.fromkeys(STATES, 1)

    def check(self, state, time_us):
        name = state.spec.name
        due = name in self.pitch and self.accepted[name] % self.pitch[name] == 0
        return Alarm("nervous", state.spec.stage.value) if due else None

    def accept(self, state, time_us):
        self.accepted[state.spec.name] += 1


@dataclass
class Stop:
    moment: checkpoints.Moment
    host: Host
    record: tuple = field(init=False)

    def __post_init__(self):
        host = self.host
        self.record = host.rows[:], host.events[:], host.alarms[:], checkpoints.counts_of(host)
        self.taps = memory.save(host.injector), memory.save(host.detector)
        self.redoing = bool(host.redo)

    def go_on(self):
        host, (rows, events, alarms, counts) = self.host, self.record
        checkpoints.put(host, self.moment)
        host.status = None
        host.rows, host.events, host.alarms = rows[:], events[:], alarms[:]
        checkpoints.set_counts(host, counts)
        host.injector, host.detector = (memory.restored(tap) for tap in self.taps)
        with np.errstate(all="ignore"):
            host.run()
        return host.flight().log


def fly_with_stops(scenario, detector=None, strike=None, pitch=20):
    host = Host(scenario, strike, detector, rewindable=True)
    host.begin()
    stops = []
    with np.errstate(all="ignore"):
        while host.status is None:
            stops.append(Stop(checkpoints.take(host), host))
            host.run(len(host.rows) // pitch * pitch + pitch)
    return host.flight().log, stops


def content(log):
    return log.rows.tobytes(), log.status, log.events, log.injections, log.alarms, log.meta


def detector_of(name, profile, scenario):
    return host_tools().load_detector(name, profile, None, scenario)[0]


CASES = {
    "published": lambda: (mission(), None, None),
    "hardened": lambda: (mission("hardened"), None, None),
    "noise": lambda: (mission(depth_noise=0.01), None, None),
    "rrt": lambda: (mission(planner="rrt"), None, None),
    "rrt_star": lambda: (mission(planner="rrt_star"), None, None),
    "octree": lambda: (mission(map="octree"), Nervous(), None),
    "gaussian": lambda: (mission(), detector_of("gaussian", "paper", mission()), fault("control.command", "vx", 4, 62)),
    "autoencoder": lambda: (
        mission(), detector_of("autoencoder", "paper", mission()), fault("planning.waypoint", "x", 4, 61)
    ),
    "tuned": lambda: (
        mission("hardened"), detector_of("autoencoder", "tuned", mission("hardened")),
        fault("planning.waypoint", "x", 4, 61),
    ),
    "recovery": lambda: (mission(), Nervous(), fault("perception.point_cloud", "z", 4, 30, element=1000)),
    "recovery hardened": lambda: (mission("hardened"), Nervous(), fault("planning.trajectory", "y", 1, 62, element=9)),
}  # fmt: skip


IN_THE_FAST_SUITE = ("published", "hardened", "octree", "gaussian", "autoencoder", "recovery")


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=() if case in IN_THE_FAST_SUITE else pytest.mark.slow) for case in CASES]
)
def test_a_flight_goes_on_from_any_checkpoint_as_it_did(case):
    scenario, detector, strike = CASES[case]()
    truth = content(fly(scenario, strike, detector).log)
    log, stops = fly_with_stops(scenario, detector, strike)
    assert content(log) == truth, "to take checkpoints changes nothing"
    chosen = stops[:: max(1, len(stops) // 4)]
    if isinstance(detector, Nervous):
        assert {alarm.state for alarm in log.alarms} == set(Nervous.pitch)
        redoing = [stop for stop in stops if stop.redoing]
        assert redoing and log.alarms
        chosen += redoing[:: max(1, len(redoing) // 3)]
    for stop in reversed(chosen):  # latest first: what was written since must not shine through
        assert content(stop.go_on()) == truth


@cache
def nervous_flight(stack):
    detector = Nervous()
    return content(fly(mission(stack), None, detector).log)


def go_on_from_everywhere(stack="published"):
    """Whether a flight with alarms in every stage goes on as it did, from instants in the middle of everything."""
    log, stops = fly_with_stops(mission(stack), Nervous(), pitch=7)
    assert content(log) == nervous_flight(stack)
    try:  # from the middle backwards, so that what is forgotten is what came later
        return all(content(stop.go_on()) == nervous_flight(stack) for stop in stops[len(stops) // 2 :: -6])
    except (IndexError, KeyError, BadInputError):  # pieces of two instants that do not fit together
        return False


@pytest.mark.slow
def test_nothing_is_forgotten():
    assert go_on_from_everywhere()


@pytest.mark.slow
@pytest.mark.parametrize("name", KERNELS)
def test_a_checkpoint_that_forgets_a_kernel_is_noticed(name, monkeypatch):
    kind = type(Host(mission()).kernels[name])
    monkeypatch.setattr(kind, "not_memory", tuple(vars(Host(mission()).kernels[name])))
    stack = "hardened" if name == "octomap" else "published"  # there the clock follows the known space, scan by scan
    assert not go_on_from_everywhere(stack)


@pytest.mark.parametrize("name", ["redo", "command"])
def test_a_checkpoint_that_forgets_a_part_of_the_host_is_noticed(name, monkeypatch):
    monkeypatch.setattr(Host, "not_memory", (*Host.not_memory, name))
    assert not go_on_from_everywhere()


def test_a_checkpoint_that_forgets_the_vehicle_or_the_detector_is_noticed(monkeypatch):
    monkeypatch.setattr(Nervous, "not_memory", ("accepted",), raising=False)
    assert not go_on_from_everywhere()
    monkeypatch.undo()
    monkeypatch.setattr(Simulator, "restore", lambda *_: None)
    assert not go_on_from_everywhere()


def test_a_moment_is_recognised_and_no_other_is():
    _, stops = fly_with_stops(mission(), pitch=50)
    host = stops[0].host
    for stop in stops[::4]:
        checkpoints.put(host, stop.moment)
        assert [checkpoints.is_at(host, other.moment) for other in stops] == [other is stop for other in stops]


@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_that_differs_is_seen(name):
    _, stops = fly_with_stops(mission(), pitch=100)
    host, moment = stops[3].host, stops[3].moment
    saved = memory.save(stops[-1].host.kernels[name])
    checkpoints.put(host, moment)
    assert checkpoints.is_at(host, moment)
    memory.restored(saved)
    assert not checkpoints.is_at(host, moment)


def test_what_a_checkpoint_copies_is_small():
    """Maps are shared as changes; scratch is left out.  A new array of a kernel that is large shows up here."""

    def size(saved):
        if isinstance(saved, np.ndarray):
            return saved.nbytes
        if type(saved) is memory._Saved:
            return size(saved.content) if memory._kind(saved.target) == "object" else 0
        if isinstance(saved, dict):
            return sum(map(size, saved.values()))
        return sum(map(size, saved)) if isinstance(saved, (list, tuple)) else 0

    for stack in STACKS:
        _, stops = fly_with_stops(mission(stack), pitch=100)
        for name, saved in dict(stops[-1].moment.memory.content)["kernels"].items():
            assert size(saved) < 300_000, name


def test_a_flight_that_is_over_frees_its_maps_at_once():
    gc.collect()
    gc.disable()
    try:
        room = weakref.ref(fly(mission()).pipeline["planner"].room)
        assert room() is None, "nothing refers back to it"
    finally:
        gc.enable()
