"""Copies of a detector in flight: none blocks it, and without a fault they are as one."""

import pytest

import mavfi
from mavfi.detectors import Alarm, Detector
from mavfi.detectors.acceptance import AcceptanceTest
from mavfi.detectors.replicas import Replicated, replicated
from mavfi.errors import BadInputError
from mavfi.hosts.local import fly
from mavfi.hosts.local.fast_forward import FastForward
from mavfi.hosts.loop.assemble import new_loop, watch
from mavfi.hosts.loop.compose import resolve
from mavfi.hosts.loop.policy import Recovery
from mavfi.hosts.loop.restarts import Restarts
from mavfi.hosts.ros1.plan import check_supported
from mavfi.hosts.watching import detector_for
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.states import new_state
from tests.hosts.missions import fault, mission
from tests.hosts.test_checkpoints import content, detector_of
from tests.unit.detectors.streams import LIMITS

STRUCK = fault("control.command", "vx", 1.0, 62)


class Stuck(Detector):
    """A copy that gives one answer for ever."""

    def __init__(self, alarm=None):
        self.alarm = alarm

    def start(self):
        pass

    def check(self, state, time_us):
        return self.alarm

    def accept(self, state, time_us):
        pass


def short():
    return resolve(MissionSpec(environment="sparse", seed=7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0)))


SILENT, ALARMING = Stuck(), Stuck(Alarm("stuck", "control", score=2.0, stop=True))


def copies(number, name="gaussian"):
    return [detector_for(short(), name, "paper")[0] for _ in range(number)]


@pytest.mark.parametrize("broken", [SILENT, ALARMING], ids=["silent", "alarming"])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_broken_copy_of_three_is_outvoted(broken, place):
    alone = fly(short(), STRUCK, copies(1)[0]).log
    assert alone.alarms and alone.status is MissionStatus.SUCCESS
    parts = copies(2)
    parts.insert(place, broken)
    assert content(fly(short(), STRUCK, Replicated(*parts)).log) == content(alone)


@pytest.mark.parametrize("policy", [Recovery(), Recovery("observer"), Recovery(same_twice="escalate", answer_s=0.6)])
@pytest.mark.parametrize("hard", [False, True])
def test_no_copy_of_two_blocks_a_flight(policy, hard):
    alone = fly(short(), STRUCK, copies(1)[0], recovery=policy).log
    for broken in (SILENT, Stuck(Alarm("stuck", "control", score=2.0, hard=hard))):
        log = fly(short(), STRUCK, Replicated(broken, *copies(1)), recovery=policy).log
        assert log.status is MissionStatus.SUCCESS
        if broken is SILENT:
            assert content(log) == content(alone) and log.alarms, "the other alarms"
        else:
            assert len(log.alarms) > len(alone.alarms)


@pytest.mark.parametrize("policy", ["end", "fresh", "latched", "readback", "recompute", "checkpoint", "standby"])
def test_a_dead_copy_is_silent_alone_and_comes_back_with_the_last_publications(policy):
    loop = new_loop(resolve(MissionSpec(environment="sparse", seed=7)))
    voting = replicated(AcceptanceTest(LIMITS["published"]), 3)
    watch(loop, voting)
    tap, restarts = loop.taps.detector, Restarts(loop, policy)
    last = new_state("perception.collision_status")
    last.header["future_collision_seq"] = 3
    loop.taps.recorders[-1](last, 0)
    restarts.detector_dies(voting, 1_000, 500_000)
    assert loop.taps.detector is tap, "the others go on voting"
    assert voting.dead == (set() if policy in ("recompute", "standby") else {0})
    silent = policy in ("end", "recompute", "standby")
    assert [entry[:1] + entry[2:3] for entry in loop.queue] == ([] if silent else [(501_000, "detector back")])
    if not silent:
        loop.actions["detector back"](501_000)
        assert voting.dead == set() and loop.taps.detector is tap
        assert [int(part.record["counters"][0, 1]) for part in voting.parts] == [3, 0, 0], "only it began again"


@pytest.mark.parametrize("detector", ["gaussian", pytest.param("recommended", marks=pytest.mark.slow)])
def test_flights_with_copies_are_those_with_one(detector):
    options = {"environment": "sparse", "seed": 7, "start": (2.0, 0.0, 3.0), "goal": (9.0, 0.0, 3.0)}
    for wrong in (None, STRUCK):
        alone = mavfi.fly(fault=wrong, detector=detector, **options).log
        assert wrong is None or alone.alarms
        for number in (2, 3):
            log = mavfi.fly(fault=wrong, detector=detector, copies=number, **options).log
            assert content(log) == content(alone)
    assert mavfi.fly(detector=detector, copies=1, **options).log.digest() == (
        mavfi.fly(detector=detector, **options).log.digest()
    )


def test_flights_with_copies_are_fast_forwarded():
    forward = FastForward(mission())
    for injected in (None, STRUCK, fault("planning.waypoint", "y", 6.0, 62), fault("control.command", "vy", 6.0, 3)):
        voting = replicated(detector_of("gaussian", "paper", mission()), 3)
        assert content(forward.fly(injected, voting, "x3").log) == content(fly(mission(), injected, voting).log)
    assert forward.share.flown < forward.share.ticks


def test_ros_refuses_copies_in_one_line():
    with pytest.raises(BadInputError, match="^copies: 3: on ROS, the detector is one node; allowed: 1$"):
        check_supported(MissionSpec(copies=3))
