"""Copies of a detector that vote: against a naive count, and against copies that are silent, dead or always alarm."""

from itertools import permutations, product

import numpy as np
import pytest

from mavfi.detectors import load_detector
from mavfi.detectors.acceptance import AcceptanceTest
from mavfi.detectors.detector import Alarm, Chain, Detector, part_of
from mavfi.detectors.replicas import Replicated, replicated, voted
from mavfi.detectors.sealed import Checksum
from mavfi.errors import BadInputError
from mavfi.states import new_state
from tests.unit.detectors.streams import LIMITS, command, flight, fly, later, strike
from tests.unit.detectors.test_registry import FITS

STATE = new_state("control.command")
NAMES = ("acceptance", "gaussian", "autoencoder")


class Says(Detector):
    """A detector with a fixed answer, which counts what it accepts."""

    def __init__(self, alarm=None, value=None):
        self.alarm, self.value, self.seen = alarm, value, 0

    def start(self):
        self.seen = 0

    def check(self, state, time_us):
        return self.alarm

    def score(self, state, time_us):
        return self.value

    def accept(self, state, time_us):
        self.seen += 1

    def memory(self):
        return self.seen

    def restore(self, memory):
        self.seen = memory


def alarm(stage="control", **more):
    return Alarm("says", stage, **more)


def counted(votes, dead):
    """Whether there is an alarm, counted by hand: at least one vote, and no majority of the live copies against it."""
    alive = [vote for place, vote in enumerate(votes) if place not in dead]
    return True in alive and not alive.count(False) > alive.count(True)


@pytest.mark.parametrize("copies", [1, 2, 3])
def test_an_alarm_needs_half_of_the_live_copies(copies):
    cases = 0
    for votes in product((False, True), repeat=copies):
        for gone in product((False, True), repeat=copies):
            dead = {place for place, away in enumerate(gone) if away}
            voting = Replicated(*(Says(alarm() if vote else None, 2.0 if vote else 0.5) for vote in votes))
            voting.dead = dead
            found, score = voting.check(STATE, 0), voting.score(STATE, 0)
            assert (found is not None) == counted(votes, dead), (votes, dead)
            assert (score is not None and score > 1.0) == counted(votes, dead), "the score says what the vote says"
            cases += 1
    assert cases == 4**copies


def test_what_is_requested_does_not_depend_on_the_order_of_the_copies():
    stop, abandon, plain = alarm(stop=True), alarm(abandon_waypoint=True), alarm()
    late, score = alarm("planning"), alarm(score=7.0)
    for given, wanted in (
        ((stop, plain, plain), plain), ((stop, plain), stop), ((abandon, plain), abandon), ((late, plain), late),
        ((plain, late, abandon), abandon), ((score, plain, plain), plain), ((late, score, plain), score),
    ):  # fmt: skip
        for order in permutations(given):
            found = voted(order)
            assert (found.stage, found.stop, found.abandon_waypoint) == (
                wanted.stage, wanted.stop, wanted.abandon_waypoint
            )  # fmt: skip
    assert {voted(order) for order in permutations((score, plain, plain))} == {plain}, "a report of two outvotes one"


def with_anomalies(seed=3):
    """A stream with values that every detector finds wrong, and some that are not finite."""
    events = flight(seed)
    for place, value in ((40, 9.0), (300, np.nan), (700, -40.0)):
        events = strike(events, later(events, "control.command", place), "vx", value)
    return strike(events, later(events, "planning.waypoint", 12), "vy", 1e9)


def detector(name, profile, model_folder):
    return load_detector(name, profile, model_folder, {**FITS, "limits": LIMITS["published"]})[0]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("profile", ["paper", "tuned"])
def test_copies_without_a_fault_raise_the_alarms_of_one(name, profile, model_folder):
    events = with_anomalies()
    alone = fly(detector(name, profile, model_folder), events)
    assert len(alone) >= 3
    for copies in (2, 3):
        assert str(fly(replicated(detector(name, profile, model_folder), copies), events)) == str(alone)


def bent(events, detector, at, bend):
    """As `fly`; the memory of the first copy is changed before an event."""
    detector.start()
    alarms = []
    for number, (state, time_us) in enumerate(events):
        if number == at:
            bend(detector.parts[0])
        found = detector.check(state, time_us)
        alarms += [] if found is None else [(number, found)]
        detector.accept(state, time_us)
    return alarms


def blind(copy):
    copy.arrays()["statistics"][:, 2] = 1e30  # the running sum of squares: every deviation is small


def nervous(copy):
    copy.arrays()["statistics"][:, 2] = 1e-30  # every deviation is large


def test_a_fault_in_the_memory_of_one_of_three_copies_changes_no_alarm(model_folder):
    events = with_anomalies()
    alone = fly(detector("gaussian", "paper", model_folder), events)
    places = {number for number, _ in alone}
    for bend in (blind, nervous):
        hit = [
            bent(events, replicated(detector("gaussian", "paper", model_folder), copies), 20, bend) for copies in (2, 3)
        ]
        assert str(hit[1]) == str(alone)
        assert {number for number, _ in hit[0]} >= places, "of two copies the alarm of either counts"
        if bend is nervous:
            assert len(hit[0]) > len(alone), "the first copy does raise false alarms"
    single = Chain(detector("gaussian", "paper", model_folder))
    assert {number for number, _ in bent(events, single, 20, blind)} < places, "alone it is blind"


@pytest.mark.parametrize("name", NAMES)
def test_the_memory_of_copies_is_separate_and_restored_bit_for_bit(name, model_folder):
    events = with_anomalies()
    half = len(events) // 2
    voting = replicated(detector(name, "paper", model_folder), 3)
    before = fly(voting, events[:half])
    assert before
    voting.lose()
    kept = voting.memory()
    fresh = voting.parts[1].memory()
    voting.parts[0].start()
    assert voting.parts[0].memory() != fresh and voting.parts[1].memory() == fresh
    other = replicated(detector(name, "paper", model_folder), 3)
    other.start()
    assert other.memory() != kept
    other.restore(kept)
    assert other.memory() == kept and other.dead == {0}
    voting.restore(kept)

    def rest(watching):
        found = []
        for state, time_us in events[half:]:
            found.append(str(watching.check(state, time_us)))
            watching.accept(state, time_us)
        return found

    assert rest(other) == rest(voting)
    assert other.memory() == voting.memory() != kept


def test_a_lost_copy_sees_nothing_until_it_is_back():
    voting = Replicated(Says(alarm()), Says(), Says())
    voting.start()
    voting.accept(STATE, 0)
    voting.lose()
    voting.accept(STATE, 0)
    assert [copy.seen for copy in voting.parts] == [1, 2, 2]
    voting.rejoin()
    voting.accept(STATE, 0)
    assert [copy.seen for copy in voting.parts] == [2, 3, 3]
    voting.lose()
    voting.start()
    assert voting.dead == set()


def test_a_copy_that_dies_while_it_is_asked_has_no_vote():
    class Dies(Says):
        def check(self, state, time_us):
            voting.lose()
            return alarm(stop=True)

    voting = Replicated(Dies(), Says())
    assert voting.check(STATE, 0) is None
    voting = Replicated(Dies(), Says(alarm()))
    assert voting.check(STATE, 0) == alarm()


def test_the_instrumented_part_is_that_of_the_first_copy(model_folder):
    for copies in (1, 2, 3):
        voting = replicated(detector("gaussian", "tuned", model_folder), copies)  # behind a gate
        first = voting if copies == 1 else voting.parts[0]
        assert part_of(voting, "gaussian") is first.parts[1]
        assert part_of(voting, "acceptance") is None


def test_one_copy_is_the_detector_itself_and_others_have_its_states():
    own = AcceptanceTest(LIMITS["published"])
    assert replicated(own, 1) is own
    voting = replicated(own, 3)
    assert voting.parts[0] is own and len({id(part.record) for part in voting.parts}) == 3
    assert voting.states == own.states


def test_detectors_that_cannot_be_copied_are_refused_in_one_line():
    class Locked(Says):
        def __deepcopy__(self, memo):
            raise TypeError("a lock")

    for own, message in (
        (Checksum(), "copies: 2: detector Checksum takes part in what is not published; allowed: 1"),
        (Locked(), r"copies: 2: detector Locked cannot be copied \(TypeError: a lock\); allowed: 1"),
    ):
        assert replicated(own, 1) is own
        with pytest.raises(BadInputError, match=f"^{message}$"):
            replicated(own, 2)


def test_copies_of_a_user_without_memory_are_copied_whole():
    class Plain(Detector):
        def start(self):
            pass

        def check(self, state, time_us):
            return None

        accept = check

    assert Replicated(Plain(), Plain()).restore is None
    assert replicated(Plain(), 3).check(command([0, 0, 0]), 0) is None
