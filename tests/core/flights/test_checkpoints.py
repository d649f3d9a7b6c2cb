"""A flight that is put back to any of its instants continues as it did the first time, bit for bit."""

import gc
import weakref
from dataclasses import dataclass, field

import numpy as np
import pytest

from mavfi.detectors import Alarm, Detector
from mavfi.detectors.detector import NoDetector
from mavfi.flight import checkpoints
from mavfi.flight.compose import detector_for, new_loop, watch
from mavfi.flight.fly import fly
from mavfi.flight.loop import HANDLERS, Loop
from mavfi.flight.recovery import DetectorTap
from mavfi.flight.state import EventKind, FlightState
from mavfi.levels.state.injector import StateInjector
from mavfi.states import STATES
from tests.core.flights.missions import Scripted, fault, mission
from tests.night import at_night

KERNELS = ("point_cloud", "octomap", "collision_check", "planner", "trajectory", "waypoint", "pid")


class Nervous(Detector):
    """Alarms at every n-th publication of some states, so that every stage is run again at times."""

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
    """An instant of a flight, and how to continue from there."""

    instant: checkpoints.Instant
    loop: Loop
    watching: Detector
    record: tuple = field(init=False)

    def __post_init__(self):
        record = self.loop.record
        self.record = record.rows[:], record.events[:], record.alarms[:], record.counts()
        self.injector = None if self.loop.taps.injector is None else self.loop.taps.injector.copy()
        self.detector = self.watching.memory()
        self.redoing = bool(self.loop.state.awaited)

    def resume(self):
        loop, (rows, events, alarms, counts) = self.loop, self.record
        checkpoints.put(loop, self.instant)
        loop.record.rows, loop.record.events, loop.record.alarms = rows[:], events[:], alarms[:]
        loop.record.set_counts(counts)
        loop.taps.injector = None if self.injector is None else self.injector.copy()
        self.watching.restore(self.detector)
        if not isinstance(self.watching, NoDetector):
            loop.taps.detector = DetectorTap(loop, self.watching)
        with np.errstate(all="ignore"):
            loop.run()
        return loop.flight().log


def fly_with_stops(scenario, detector=None, injected=None, pitch=20):
    loop = new_loop(scenario, rewindable=True)
    loop.taps.injector = None if injected is None else StateInjector(injected)
    watch(loop, detector)
    loop.begin()
    stops = []
    with np.errstate(all="ignore"):
        while loop.status is None:
            stops.append(Stop(checkpoints.take(loop), loop, detector or NoDetector()))
            loop.run(len(loop.record.rows) // pitch * pitch + pitch)
    return loop.flight().log, stops


def content(log):
    """All of a log; as plain data, since NaN is not NaN."""
    injections, alarms = ([item.to_json() for item in items] for items in (log.injections, log.alarms))
    return log.rows.tobytes(), log.status, log.events, injections, alarms, log.meta


def detector_of(name, profile, scenario):
    return detector_for(scenario, name, profile)[0]


CASES = {
    "published": lambda: (mission(), None, None),
    "hardened": lambda: (mission("hardened"), None, None),
    "noise": lambda: (mission(depth_noise=0.01), None, None),
    "rrt": lambda: (mission(planner="rrt"), None, None),
    "octree": lambda: (mission(map="octree"), Nervous(), None),
    "gaussian": lambda: (mission(), detector_of("gaussian", "paper", mission()), fault("control.command", "vx", 4, 62)),
    "autoencoder": lambda: (
        mission(),
        detector_of("autoencoder", "paper", mission()),
        fault("planning.waypoint", "x", 4, 61),
    ),
    "acceptance": lambda: (
        mission(),
        detector_of("acceptance", "paper", mission()),
        fault("planning.trajectory", "y", 1, 62, element=9),
    ),
    "recovery": lambda: (mission(), Nervous(), fault("perception.point_cloud", "z", 4, 30, element=1000)),
    "recovery hardened": lambda: (mission("hardened"), Nervous(), fault("planning.trajectory", "y", 1, 62, element=9)),
}


@pytest.mark.parametrize(
    "case",
    [
        *("published", "octree", "gaussian", "recovery"),
        *at_night("hardened", "noise", "rrt", "autoencoder", "acceptance", "recovery hardened"),
    ],
)
def test_a_flight_continues_from_any_checkpoint_as_it_did(case):
    scenario, detector, injected = CASES[case]()
    truth = content(fly(scenario, injected, detector).log)
    log, stops = fly_with_stops(scenario, detector, injected)
    assert content(log) == truth, "to take checkpoints changes nothing"
    chosen = stops[:: max(1, len(stops) // 4)]
    if isinstance(detector, Nervous):
        assert {alarm.state for alarm in log.alarms} == set(Nervous.pitch)
        redoing = [stop for stop in stops if stop.redoing]
        assert redoing and log.alarms
        chosen += redoing[:: max(1, len(redoing) // 3)]
    for stop in reversed(chosen):  # latest first: what was written since must not shine through
        assert content(stop.resume()) == truth


def test_an_instant_is_recognised_and_no_other_is():
    _, stops = fly_with_stops(mission(), pitch=50)
    loop = stops[0].loop
    for stop in stops[::4]:
        checkpoints.put(loop, stop.instant)
        assert [checkpoints.is_at(loop, other.instant) for other in stops] == [other is stop for other in stops]


@dataclass(slots=True, eq=False)
class WiderState(FlightState):
    """The state of a flight with one more field, a list that changes in place."""

    visited: list = field(default_factory=list)


def test_a_new_field_of_the_state_is_in_checkpoints_forks_and_comparisons(monkeypatch):
    monkeypatch.setattr("mavfi.flight.loop.FlightState", WiderState)
    loop = new_loop(mission(), rewindable=True)
    loop.state.visited.append("start")
    instant = checkpoints.take(loop)
    loop.state.visited.append("door")
    assert not checkpoints.is_at(loop, instant), "a comparison sees it"
    for _ in range(2):  # a fork, and another one: neither changes the checkpoint
        checkpoints.put(loop, instant)
        assert loop.state.visited == ["start"] and checkpoints.is_at(loop, instant)
        loop.state.visited.append("window")
    loop.reset()
    assert loop.state.visited == [], "another flight begins without it"


def test_every_kind_of_event_has_a_handler():
    assert set(HANDLERS) == set(EventKind)


@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_that_differs_is_seen(name):
    _, stops = fly_with_stops(mission(), pitch=100)
    loop, instant = stops[3].loop, stops[3].instant
    saved = loop.kernels[name].save()
    checkpoints.put(loop, instant)
    assert checkpoints.is_at(loop, instant)
    loop.kernels[name].restore(saved)
    assert not checkpoints.is_at(loop, instant)


def test_a_flight_that_is_over_frees_its_maps_at_once():
    gc.collect()
    gc.disable()
    try:
        for injected, detector in ((None, None), (None, Scripted()), (fault("control.command", "vx", 4.0, 3), None)):
            clearance = weakref.ref(fly(mission(), injected, detector).pipeline["planner"].clearance_map)
            assert clearance() is None, "nothing refers back to it"
    finally:
        gc.enable()
