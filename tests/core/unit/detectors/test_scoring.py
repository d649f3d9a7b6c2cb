import pickle

import numpy as np
import pytest

from mavfi.detectors import Alarm, load_detector
from mavfi.detectors.scoring import NOT_FINITE, Reading, Threshold, find_policy, score_of
from mavfi.errors import BadInputError
from tests.core.unit.detectors.streams import LIMITS, command, flight, later, strike
from tests.core.unit.detectors.streams import waypoint as point
from tests.core.unit.detectors.test_registry import FITS

DETECTORS = [(name, profile) for name in ("gaussian", "autoencoder") for profile in ("paper", "tuned")]


def reading(distance, regime=0, unit=1.0):
    return Reading(np.array(distance, float), np.full(len(distance), unit), 1, 3, regime)


def judge(threshold, found):
    return score_of(found, threshold.limit, threshold.ratios)


def test_only_renewed_fields_are_held_against_their_limits():
    threshold = Threshold(np.array([[1.0, 9.0], [2.0, 9.0], [4.0, 9.0]]), 3)
    score = judge(threshold, reading([50.0, 1.0, 6.0]))
    assert score == 1.5
    assert threshold.standing_out(reading([50.0, 1.0, 6.0]), np.zeros(0, int)).tolist() == [2]
    assert judge(threshold, reading([0.0, 1.0, 6.0], regime=1)) == pytest.approx(6 / 9)
    assert judge(threshold, reading([0.0, 1.0, 6.0], unit=3.0)) == 0.5
    assert judge(threshold, reading([0.0, 1.0, 6.0], unit=0.0)) == 0.0


def test_a_mean_square_is_of_all_fields_and_the_field_farthest_beyond_its_usual_stands_out():
    threshold = Threshold(np.array([[2.0]]), 3, usual=np.array([10.0, 0.1, 1.0]))
    found = reading([3.0, 1.0, 2.0])
    score = judge(threshold, found)
    assert score == pytest.approx(14.0 / 3.0 / 2.0)
    assert threshold.standing_out(found, np.zeros(0, int)).tolist() == [1]
    assert threshold.standing_out(found, np.array([2, 0])).tolist() == [2]


def test_what_is_not_finite_has_its_own_score():
    assert judge(Threshold(np.ones((3, 3)), 3), reading([0.0] * 3, regime=-1)) == NOT_FINITE


def test_policies_ask_for_what_they_are_named_after():
    alarm = Alarm("a", "planning", score=2.0)
    for state, waypoint in ((point([0, 0, 0], [0, 0, 0]), True), (command([0, 0, 0]), False)):
        assert find_policy("keyed")(alarm, state, True) == alarm
        for persists in (False, True):
            asked = find_policy("paper")(alarm, state, persists)
            assert (asked.stage, asked.abandon_waypoint, asked.stop) == ("control", waypoint, waypoint and persists)
    with pytest.raises(BadInputError, match="recovery policy 'both': not known; allowed: paper, keyed"):
        find_policy("both")


@pytest.mark.parametrize(("name", "profile"), DETECTORS)
def test_every_watched_publication_has_a_score_that_agrees_with_the_alarm(model_folder, name, profile):
    detector, _ = load_detector(name, profile, model_folder, FITS)
    events = flight(77, ticks=300)
    events = strike(events, later(events, "control.command", 200), "vx", 1e9)
    detector.start()
    scores = []
    for state, time_us in events:
        score, alarm = detector.score(state, time_us), detector.check(state, time_us)
        assert (alarm is not None) == (score is not None and score > 1.0)
        assert alarm is None or alarm.score <= score  # of a chain, the first alarm counts
        assert (score is None) == (state.spec.name == "sensor.odometry")
        scores += [score] if score is not None else []
        detector.accept(state, time_us)
    assert max(scores) > 1.0 and sum(0.0 < score <= 1.0 for score in scores) > 10


@pytest.mark.parametrize(("name", "profile"), DETECTORS)
def test_a_detector_continues_from_what_it_remembered(model_folder, name, profile):
    detector, other = (load_detector(name, profile, model_folder, FITS)[0] for _ in range(2))
    events = flight(5, ticks=400)
    detector.start()
    for state, time_us in events[:400]:
        detector.accept(state, time_us)
    memory = detector.memory()
    assert other.memory() != memory
    wild = strike(events, 600, events[600][0].spec.header[0].name, 1e3)
    first = [(detector.check(*event), detector.accept(*event)) for event in wild[400:]]
    assert detector.memory() != memory
    for again in (detector, other):
        again.restore(memory)
        assert again.memory() == memory
        assert [(again.check(*event), again.accept(*event)) for event in wild[400:]] == first


@pytest.mark.parametrize(("name", "profile"), [*DETECTORS, ("acceptance", "paper")])
def test_a_pickled_detector_continues_from_what_it_remembered(model_folder, name, profile):
    detector, _ = load_detector(name, profile, model_folder, {**FITS, "limits": LIMITS["published"]})
    events = flight(6, ticks=200)
    detector.start()
    for state, time_us in events[:300]:
        detector.check(state, time_us)
        detector.accept(state, time_us)
    other = pickle.loads(pickle.dumps(detector))
    for event in events[300:]:
        assert other.check(*event) == detector.check(*event)
        assert detector.accept(*event) is other.accept(*event) is None
        assert other.memory() == detector.memory()


def test_a_publication_that_is_checked_again_after_another_one_is_measured_again():
    detector, _ = load_detector("gaussian", "tuned", None, FITS)
    state, other = command([1, 0, 0]), command([2, 0, 0])
    detector.accept(state, 0)
    before = detector.score(other, 1)
    assert detector.score(state, 2) != before
    assert detector.score(other, 3) == before
