"""An admission does what `check` and `accept` do, one after the other."""

import copy
import pickle

import numpy as np
import pytest

from mavfi.detectors.acceptance import AcceptanceTest
from mavfi.detectors.chain import Chain
from mavfi.detectors.detector import Alarm, admission
from mavfi.detectors.gate import PhysicsGate
from mavfi.detectors.registry import load_detector
from mavfi.states import floats, new_state
from tests.unit.detectors.streams import LIMITS, PROVENANCE, flight, later, strike

DETECTORS = [
    ("acceptance", "paper"), ("gaussian", "paper"), ("gaussian", "tuned"), ("autoencoder", "paper"),
    ("autoencoder", "tuned"), ("limits", "paper"), ("autoencoder_all", "paper"), ("cusum", "paper"),
    ("conformal", "paper"), ("none", "paper"), ("rule_2", "paper"),
]  # fmt: skip
STRIKES = [
    ("control.command", 30, "vx", 1e200), ("control.command", 300, "yaw_rate", np.nan),
    ("control.command", 700, "duration", -0.1), ("planning.waypoint", 20, "x", 1e9),
    ("planning.waypoint", 30, "vy", np.inf), ("planning.waypoint", 31, "trajectory_seq", 77),
    ("perception.collision_status", 40, "future_collision_seq", 9), ("sensor.odometry", 800, "vx", np.nan),
]  # fmt: skip


def load(name, profile):
    return load_detector(name, profile, None, {**PROVENANCE, "limits": LIMITS["published"], "seed": 0})[0]


def events():
    found, before = flight(6), 0
    for state, _ in found:
        if state.spec.name == "control.command":
            state.header["duration"] = LIMITS["published"].control_period
        if state.spec.name == "perception.collision_status":
            counter = int(state.header["future_collision_seq"][0])
            state.header["collision"], before = counter > before, counter
    for state, count, field, value in STRIKES:
        found = strike(found, later(found, state, count), field, value)
    for tick in range(len(found) // 7):  # tracking reports, among the others
        report = new_state("control.tracking")
        report.header["remaining"] = 0.5 - 0.02 * (tick % 25)
        found.insert(8 * tick, (report, found[8 * tick][1]))
    return found


def one_after_the_other(detector):
    def admit(state, time_us):
        alarm = detector.check(state, time_us)
        if alarm is None:
            detector.accept(state, time_us)
        return alarm

    return admit


def fly(detector, made, published, every=0, copied=None):
    """Alarms, and memories in flight and at the end; every second publication with an alarm is published all the same.

    `copied`: in the middle of the flight, a copy goes on, and the detector is fed with nonsense.
    """
    admit, alarms, memories = made(detector), [], []
    for number, (state, time_us) in enumerate(published):
        if copied is not None and number == len(published) // 2:
            detector, other = copied(detector), detector
            admit, disturb = made(detector), made(other)
            for _ in range(3):
                disturb(published[5][0], time_us)
                disturb(published[-1][0], time_us)
        alarm = admit(state, time_us)
        if alarm is not None:
            alarms.append((number, alarm))
            if len(alarms) % 2:
                detector.accept(state, time_us)
        if every and number % every == 0:
            memories.append(detector.memory())
    return alarms, [*memories, detector.memory()]


@pytest.mark.parametrize(("name", "profile"), DETECTORS)
@pytest.mark.parametrize("every", [0, 3])
def test_alarms_and_memory_are_those_of_check_and_accept(name, profile, every):
    published = events()
    at_once, stepwise = load(name, profile), load(name, profile)
    for detector in (at_once, stepwise):
        detector.start()
    found = fly(at_once, admission, published, every)
    assert found == fly(stepwise, one_after_the_other, published, every)
    assert found[0] or name in ("none", "rule_2")


@pytest.mark.parametrize(("name", "profile"), [("acceptance", "paper"), ("gaussian", "tuned"), ("limits", "paper")])
def test_estimated_odometry_is_read_like_the_true_one(name, profile):
    """Its header is longer, and begins alike."""
    published = []
    for state, time_us in events():
        if state.spec.name == "sensor.odometry":
            estimated = new_state("perception.odometry")
            floats(estimated.header, 7)[:] = floats(state.header, 7)
            state = estimated
        published.append((state, time_us))
    at_once, stepwise, true = (load(name, profile) for _ in range(3))
    for detector in (at_once, stepwise, true):
        detector.start()
    found = fly(at_once, admission, published)
    assert found == fly(stepwise, one_after_the_other, published)
    assert found == fly(true, admission, events())


@pytest.mark.parametrize(("name", "profile"), DETECTORS)
@pytest.mark.parametrize("state", ["control.command", "planning.waypoint"])
def test_a_publication_that_is_resent_after_others_is_recorded(name, profile, state):
    """It was checked before the others: only the last one is known to compiled code."""
    published = events()
    memories = {admission: [], one_after_the_other: []}
    for made, found in memories.items():
        detector = load(name, profile)
        detector.start()
        for count in (20, 30, 40):
            first, second = later(published, state, count), later(published, state, count + 1)
            detector.check(*published[first])
            fly(detector, made, published[first + 1 : second + 1])
            sent, time_us = published[first]
            detector.accept(sent.copy(), time_us)  # a host passes it as a copy
            found.append(detector.memory())
    assert memories[admission] == memories[one_after_the_other]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda detector: pickle.loads(pickle.dumps(detector))])
@pytest.mark.parametrize(("name", "profile"), DETECTORS)
def test_a_copy_goes_on_alone(name, profile, copied):
    published = events()
    alone, copied_once = load(name, profile), load(name, profile)
    for detector in (alone, copied_once):
        detector.start()
    assert fly(copied_once, admission, published, copied=copied) == fly(alone, admission, published)


@pytest.mark.parametrize(
    ("name", "profile", "place"),
    [*((*names, -1) for names in DETECTORS[:9]), ("gaussian", "tuned", 0), ("autoencoder", "tuned", 0)],
)
def test_instrumented_code_is_called_for_every_publication(name, profile, place):
    plain, detector = load(name, profile), load(name, profile)
    watched = detector.parts[place] if isinstance(detector, Chain) else detector
    calls = []

    def counted(function):
        def call(*arguments):
            calls.append(function)
            return function(*arguments)

        return call

    watched.instrument({name: counted(function) for name, function in watched.compiled.items()})
    for one in (plain, detector):
        one.start()
    published = events()
    assert fly(detector, admission, published) == fly(plain, admission, published)
    commands = sum(state.spec.name == "control.command" for state, _ in published)
    assert len(calls) >= commands - 3  # the gate in front stops some


class Careless(AcceptanceTest):
    def check(self, state, time_us):
        return None


class Suspicious(AcceptanceTest):
    def check(self, state, time_us):
        return Alarm("suspicious", "control")


class Strict(PhysicsGate):
    def check(self, state, time_us):
        return Alarm("strict", "control")


def test_a_subclass_that_checks_in_another_way_is_asked_its_own_way():
    wrong = new_state("control.command")
    wrong.header["vx"] = np.nan
    assert admission(AcceptanceTest(LIMITS["published"]))(wrong, 0) is not None
    assert admission(Careless(LIMITS["published"]))(wrong, 0) is None
    normal = new_state("control.command")
    normal.header["duration"] = LIMITS["published"].control_period
    for right in (normal, new_state("sensor.odometry")):
        assert admission(AcceptanceTest(LIMITS["published"]))(right, 0) is None
        assert admission(Suspicious(LIMITS["published"]))(right, 0).source == "suspicious"
    assert admission(Strict(3.0))(wrong, 0).source == "strict"
    assert admission(Chain(Strict(3.0), Careless(LIMITS["published"])))(wrong, 0).source == "strict"
    changed = AcceptanceTest(LIMITS["published"])
    changed.check = lambda state, time_us: None
    assert admission(changed)(wrong, 0) is None


@pytest.mark.parametrize(("name", "profile"), [("autoencoder", "paper"), ("autoencoder_all", "paper")])
def test_scores_are_those_of_check_where_publications_repeat_their_codes(name, profile):
    """The network runs only for codes that differ from the last ones."""
    published, scores = flight(6), {admission: [], one_after_the_other: []}
    steady = next(state for state, _ in published if state.spec.name == "control.command")
    for number, (state, _) in enumerate(published):
        if state.spec.name == "control.command" and number % 50 > 3:
            state.header[:] = steady.header
    for made, found in scores.items():
        detector = load(name, profile)
        detector.start()
        admit = made(detector)
        for state, time_us in published:
            admit(state, time_us)
            found.append(detector.scorer.judged()[1].score)
    assert scores[admission] == scores[one_after_the_other]
    assert len(set(scores[admission])) > 5
