"""A detector that never returns, or ends its process, blocks no flight: it is disabled, and flies no further."""

import itertools
import os
import signal
from functools import cache

import numpy as np
import pytest

import mavfi
from mavfi.campaign import scores
from mavfi.campaign.config import Campaign
from mavfi.campaign.plan import Arm
from mavfi.campaign.replay import explain, replay
from mavfi.campaign.samplers.instruction import draw_instruction_faults
from mavfi.campaign.store import Store
from mavfi.detectors import bounded
from mavfi.detectors.replicas import INJECTED, replicated
from mavfi.errors import BadInputError, MavfiError
from mavfi.faults.spec import InstructionRequest
from mavfi.flight_record import CRASHED, STUCK, End
from mavfi.hosts.host import ArmSetup
from mavfi.hosts.isolated import IsolatedFlights, in_child
from mavfi.hosts.local import fly
from mavfi.hosts.local.fast_forward import FastForward
from mavfi.hosts.local.mission_flights import LocalHost
from mavfi.hosts.loop.assemble import new_loop, watch
from mavfi.hosts.loop.policy import Recovery
from mavfi.hosts.loop.restarts import Restarts
from mavfi.mission import MissionSpec
from mavfi.plugins import allow_typed
from mavfi.reports.explain import alarm_lines
from tests.hosts.missions import Scripted, fault, golden, mission
from tests.hosts.test_checkpoints import content
from tests.unit.detectors.test_bounded import lock_twice, sleep


def spin():
    """Computes for ever in compiled code."""
    sum(itertools.repeat(0))


def crash():
    os.kill(os.getpid(), signal.SIGSEGV)


def leave():
    os._exit(3)


class Endless(Scripted):
    """Raises no alarm; from the n-th call of a method on, that does not return."""

    n = 400

    def __init__(self, method, end=sleep, n=400):
        super().__init__(n=n)
        self.method, self.end, self.calls = method, end, 0

    def start(self):
        super().start()
        self.calls = 0

    def _count(self, method):
        self.calls += method == self.method
        if method == self.method and self.calls >= self.n:
            self.end()

    def check(self, state, time_us):
        self._count("check")
        return super().check(state, time_us)

    def accept(self, state, time_us):
        self._count("accept")


class Sealing(Endless):
    seals = True

    def seal(self, state, time_us):
        self._count("seal")


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(bounded, "LIMIT_S", 0.1)


@pytest.fixture
def soon(monkeypatch):
    monkeypatch.setattr(bounded, "LONGEST_S", 0.5)


@pytest.mark.parametrize("method", ["check", "accept", "seal"])
def test_the_flight_goes_on_without_it(short, method):
    detector = (Sealing if method == "seal" else Endless)(method)
    log = fly(mission(), detector=detector).log
    assert log.digest() == golden().log.digest() and log.alarms == []
    (event,) = (event for event in log.events if event.kind == STUCK)
    assert 0 < event.time_us < 1e6 * 5
    assert detector.calls == detector.n, "it is called no more"
    assert ("alarms", "0 in all") in alarm_lines(log, None)
    sentence = f"is disabled from {event.time_us / 1e6:.2f} s on, a call of it did not return within 60 s"
    assert any(sentence in text for _, text in alarm_lines(log, None))


class Starting(Endless):
    def start(self):
        super().start()
        self.end()


def test_it_may_be_its_start(short):
    expected = None
    for fast in (False, True):
        setup = ArmSetup(mission(), lambda: Starting("start"))
        log = LocalHost().mission({"own": setup}, fast_forward=fast).golden("own").log
        (event,) = (event for event in log.events if event.kind == STUCK)
        assert event.time_us == 0
        assert log.digest() == golden().log.digest()
        expected = expected or content(log)
        assert content(log) == expected


@pytest.mark.parametrize(("start", "kind"), [(sleep, STUCK), (lambda: 1 / 0, CRASHED)])
def test_nor_is_a_flight_blocked_by_its_restart(short, start, kind):
    """Recovery died, and with it the detector, which does not come back."""
    loop, detector = new_loop(mission()), Scripted()
    watch(loop, detector)
    tap, restarts = loop.taps.detector, Restarts(loop, "fresh")
    assert restarts.detector_dies(detector, 1_000, 500_000, recovery=True)
    detector.start, loop.forked = start, True
    loop.actions["detector back"](501_000)
    assert loop.taps.detector is tap and tap.memory.silenced
    assert [(event.time_us, event.kind) for event in loop.record.events] == [(501_000, kind)]


def test_nor_by_the_restart_of_a_copy(short):
    loop, voting = new_loop(mission()), replicated(Scripted(), 3)
    watch(loop, voting)
    assert Restarts(loop, "fresh").detector_dies(voting, 1_000, 500_000)
    voting.parts[INJECTED].start = sleep
    loop.actions["detector back"](501_000)
    assert voting.dead == {INJECTED}


@pytest.mark.parametrize("make", [lambda: Endless("check"), lambda: Endless("accept"), lambda: Sealing("seal")])
def test_fast_forwarded_flights_are_those_from_take_off(short, make):
    injected, recovery = fault("control.command", "vx", 4.0, 62), Recovery(same_twice="limit")
    forward = FastForward(mission())
    for one in (None, injected):
        mine = forward.fly(one, make(), "endless", recovery)
        assert content(mine.log) == content(fly(mission(), one, make(), recovery=recovery).log)


def stops(died=""):
    """Ends a call as if an earlier attempt had ended in it so."""

    def stop():
        raise bounded.StuckError(died)

    return stop


@pytest.mark.parametrize("method", ["check", "accept", "seal"])
@pytest.mark.parametrize(("end", "how"), [(lock_twice, ""), (crash, "SIGSEGV"), (leave, "status 3")])
def test_nor_can_compiled_code_that_does_not_return_or_a_crash_block_it(soon, method, end, how):
    injected, make = fault("control.command", "vx", 8.0, 62), Sealing if method == "seal" else Endless
    log = in_child(make(method), lambda: fly(mission(), injected, make(method, end))).log
    assert content(log) == content(fly(mission(), injected, make(method, stops(how))).log)
    (event,) = (event for event in log.events if event.kind in (STUCK, CRASHED))
    assert event.kind == (CRASHED if how else STUCK)
    sentence = f"a call of it crashed: {how}" if how else "did not return within 60 s"
    assert any(sentence in text for _, text in alarm_lines(log, None))


def test_an_error_of_the_flight_is_raised_and_a_crash_of_it_reported():
    def bad():
        raise BadInputError("start: in an obstacle")

    with pytest.raises(BadInputError, match="start: in an obstacle"):
        in_child(Endless("check"), bad)
    with pytest.raises(MavfiError, match="crash: SIGSEGV"):
        in_child(Endless("check"), crash)


def test_detectors_of_mavfi_fly_in_this_process():
    assert in_child(None, os.getpid) == os.getpid() != in_child(Endless("check"), os.getpid)


def test_a_flight_has_its_kernels_but_for_those_that_cannot_be_sent():
    def fly_all():
        flight = fly(mission())
        flight.pipeline = {**flight.pipeline, "own": lambda: None}
        return flight

    flight = in_child(Endless("check"), fly_all)
    assert content(flight.log) == content(golden().log)
    assert flight.pipeline.keys() == golden().pipeline.keys()
    assert (flight.pipeline["planner"].clearance_map is None) == (golden().pipeline["planner"].clearance_map is None)
    assert np.array_equal(flight.world.lower, golden().world.lower)


@pytest.mark.slow
def test_isolated_flights_are_those_of_the_host(soon):
    flights = IsolatedFlights(LocalHost(), {"own": ArmSetup(mission(), lambda: Endless("check", crash))})
    assert [event.kind for event in flights.golden("own").log.events].count(CRASHED) == 1
    faults = [fault("control.command", "vx", 8.0, bit) for bit in (1, 62)]
    flown = dict(flights.injected([("own", one) for one in faults]))
    for place, one in enumerate(faults):
        assert content(flown[place].log) == content(fly(mission(), one, Endless("check", stops("SIGSEGV"))).log)


@pytest.mark.slow
@pytest.mark.parametrize(("fast", "n"), [(False, 2000), (True, 400)])
def test_faults_in_instructions_are_flown_with_it(soon, fast, n):
    """It ends its process before the faults, and after them, in a child of its own."""
    faults = draw_instruction_faults(mission(), InstructionRequest({"pid": 4}), seed=3).faults["pid"]

    def flown(end):
        arms = {"": ArmSetup(mission()), "own": ArmSetup(mission(), lambda: Endless("check", end, n))}
        flights = LocalHost().mission(arms, fast_forward=fast)
        for arm in arms:
            flights.know(arm, flights.golden(arm))
        runs = [(arm, one) for arm in arms for one in faults]
        return {place: content(flight.log) for place, flight in flights.injected(runs)}

    mine = in_child(Endless("check"), lambda: flown(crash))
    assert mine == flown(stops("SIGSEGV"))


@cache
def commands():
    """Those of the golden flight."""
    found = set()

    def note(state, time_us):
        if state.spec.name == "control.command":
            found.add(state.header.tobytes())

    fly(mission(), recorders=[note])
    return found


def test_it_is_not_asked_again_at_each_checkpoint(short):
    ends = []

    def end():
        ends.append(1)
        sleep()

    FastForward(mission()).fly(None, Endless("check", end), "own")
    assert len(ends) == 2, "on known publications, and in the flight"


class Brittle(Scripted):
    """Cannot cope with commands other than those of the golden flight."""

    known = None

    def check(self, state, time_us):
        known = commands() if self.known is None else self.known
        if state.spec.name == "control.command" and state.header.tobytes() not in known:
            raise ValueError("no such command")


class Broken(Brittle):
    known = frozenset()


WRONG = fault("control.command", "vx", 8.0, 62)


@pytest.mark.parametrize("make", [FastForward, None])
def test_an_exception_after_the_injection_disables_it(make):
    flight = fly(mission(), WRONG, Brittle()) if make is None else make(mission()).fly(WRONG, Brittle(), "own")
    (event,) = (event for event in flight.log.events if event.kind == CRASHED)
    assert event.data == {"how": "ValueError: no such command"}
    assert event.time_us / 1e6 == pytest.approx(flight.log.injections[0].time_s)
    assert content(flight.log)[0] == content(fly(mission(), WRONG).log)[0]


def test_an_exception_before_it_is_raised():
    for injected in (None, WRONG):
        with pytest.raises(ValueError, match="no such command"):
            fly(mission(), injected, Broken())


@pytest.mark.slow
@pytest.mark.parametrize("fast", [False, True])
def test_nor_does_it_look_as_if_the_injected_kernel_had_died(fast):
    faults = draw_instruction_faults(mission(), InstructionRequest({"pid": 6}), seed=3).faults["pid"]
    arms = {"": ArmSetup(mission()), "own": ArmSetup(mission(), Brittle)}
    flights = LocalHost().mission(arms, fast_forward=fast)
    for arm in arms:
        flights.know(arm, flights.golden(arm))
    runs = [(arm, one) for arm in arms for one in faults]
    flown = {runs[place]: flight.log for place, flight in flights.injected(runs)}
    crashed = [one for one in faults if flown["own", one].count(CRASHED)]
    assert crashed
    for one in crashed:
        assert flown["own", one].kernel == flown["", one].kernel
        assert flown["own", one].digest() == flown["", one].digest()


class Named(Endless):
    def __init__(self):
        super().__init__("accept", type(self).end_of)


class Spinning(Named):
    end_of = staticmethod(spin)


class Crashing(Named):
    end_of = staticmethod(crash)


class StoppedSpinning(Named):
    end_of = staticmethod(stops())


class StoppedCrashing(Named):
    end_of = staticmethod(stops("SIGSEGV"))


def campaign(detector):
    """Faults in two missions, one of which is flown without a fault and with this detector as well."""
    content = {
        "name": "stuck", "environments": ["sparse"], "missions": 2, "faults": 1, "null_runs": 0,
        "arms": {"own": {"detector": f"{__name__}:{detector}"}},
    }  # fmt: skip
    allow_typed([f"{__name__}:{detector}"])
    return Campaign.model_validate(content)


def flown(directory, detector, workers=1):
    """All runs, in plan order."""
    mavfi.run(campaign(detector), directory, workers=workers)
    with Store.open(directory) as store:
        return [(run.spec.kind, run.spec.arm, run.spec.seed, run.spec.fault, run.record) for run in store.runs()]


@pytest.mark.slow
def test_a_campaign_flies_all_missions(soon, tmp_path):
    runs = flown(tmp_path / "runs", "Spinning", workers=2)
    assert {record.end for *_, record in runs} == {End.FLOWN}
    assert sum(arm == "own" for _, arm, *_ in runs) == len(runs) / 2 == 2 + 3
    assert runs == flown(tmp_path / "stopped", "StoppedSpinning")
    with Store.open(tmp_path / "runs") as store:
        *_, last = (run.spec.run_id for run in store.runs() if run.spec.arm == "own")
    assert replay(tmp_path / "runs", last).same and explain(tmp_path / "runs", last).same


class Scoring(Crashing):
    def score(self, state, time_us):
        return 0.5


def test_it_is_scored_up_to_the_crash(soon):
    name = f"{__name__}:Scoring"
    allow_typed([name])
    spec = MissionSpec(environment="sparse", seed=7)
    found = scores._score(scores._Task(spec, (Arm("own", {}, name, "paper"),), (), ()))
    assert sum(found["own"].exposure.judged) == Scoring.n


def test_a_name_is_called_in_a_child_and_an_object_here(soon):
    options = {"environment": "sparse", "seed": 7}
    named = mavfi.fly(detector=f"{__name__}:Crashing", **options)
    assert named.log.count(CRASHED) == 1
    detector = StoppedCrashing()
    here = mavfi.fly(detector=detector, **options)
    assert here.log.digest() == named.log.digest()
    assert detector.calls == detector.n
