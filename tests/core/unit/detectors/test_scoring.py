import numpy as np
import pytest

from mavfi.detectors.registry import load_detector
from mavfi.detectors.scoring import Reading, Threshold, score_of
from tests.core.unit.detectors.streams import command
from tests.core.unit.detectors.test_registry import FITS


def reading(distance, regime=0, unit=1.0):
    return Reading(np.array(distance, float), np.full(len(distance), unit), 1, 3, regime)


def judge(threshold, reading_of):
    return score_of(reading_of, threshold.limit, threshold.ratios)


def test_only_renewed_fields_are_held_against_their_limits():
    threshold = Threshold(np.array([[1.0, 9.0], [2.0, 9.0], [4.0, 9.0]]), 3)
    score = judge(threshold, reading([50.0, 1.0, 6.0]))
    assert score == 1.5
    assert threshold.fields_of_alarm(reading([50.0, 1.0, 6.0]), np.zeros(0, int)).tolist() == [2]
    assert judge(threshold, reading([0.0, 1.0, 6.0], regime=1)) == pytest.approx(6 / 9)
    assert judge(threshold, reading([0.0, 1.0, 6.0], unit=3.0)) == 0.5
    assert judge(threshold, reading([0.0, 1.0, 6.0], unit=0.0)) == 0.0


def test_a_mean_square_is_of_all_fields_and_the_field_farthest_beyond_its_usual_stands_out():
    threshold = Threshold(np.array([[2.0]]), 3, usual=np.array([10.0, 0.1, 1.0]))
    measured = reading([3.0, 1.0, 2.0])
    score = judge(threshold, measured)
    assert score == pytest.approx(14.0 / 3.0 / 2.0)
    assert threshold.fields_of_alarm(measured, np.zeros(0, int)).tolist() == [1]
    assert threshold.fields_of_alarm(measured, np.array([2, 0])).tolist() == [2]


def test_a_publication_that_is_checked_again_after_another_one_is_measured_again():
    detector, _ = load_detector("gaussian", "tuned", None, FITS)
    state, other = command([1, 0, 0]), command([2, 0, 0])
    detector.accept(state, 0)
    before = detector.score(other, 1)
    assert detector.score(state, 2) != before
    assert detector.score(other, 3) == before
