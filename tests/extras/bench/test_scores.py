"""Thresholds, areas and curves against what a naive count gives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import average_precision_score, roc_auc_score

from mavfi.extras.bench.scores import Scores, table

LEVELS = st.sampled_from([0.0, 0.5, 0.9, 1.0, 1.5, 2.0, 1e9])


@st.composite
def made(draw):
    """Scores of few levels, so that there are ties; every golden publication is given, zeros included."""
    golden = np.array(draw(st.lists(LEVELS, min_size=1, max_size=40)))
    corrupted = np.array(draw(st.lists(LEVELS, min_size=1, max_size=20)))
    harmful = np.array(draw(st.lists(st.booleans(), min_size=len(corrupted), max_size=len(corrupted))), bool)
    return golden, Scores(
        np.sort(golden[golden > 0])[::-1],
        len(golden),
        draw(st.sampled_from([0.5, 2.0, 10.0])),
        corrupted,
        harmful,
        np.arange(len(corrupted)),
    )


@given(made(), st.sampled_from([0.1, 1.0, 10.0]))
def test_no_threshold_alarms_more_often_than_asked(flights, rate):
    golden, faulty = flights
    threshold = faulty.threshold_at(rate)
    if threshold is None:
        assert rate * faulty.hours < 1
        return
    assert (golden > threshold).sum() <= rate * faulty.hours
    lower = np.unique(golden[golden < threshold])
    if len(lower):  # the next lower one would alarm too often
        assert (golden > lower[-1]).sum() > int(rate * faulty.hours)


@given(made())
def test_the_area_is_that_of_scikit_learn(flights):
    golden, faulty = flights
    harmful = faulty.corrupted[faulty.harmful]
    if not len(harmful):
        assert faulty.area() is None
        return
    labels = [0] * len(golden) + [1] * len(harmful)
    assert faulty.area() == pytest.approx(roc_auc_score(labels, [*golden, *harmful]), abs=1e-12)


def test_faults_of_one_mission_are_not_independent():
    corrupted = np.repeat([9.0, 0.0], 20)
    alone, together = (
        Scores(np.array([2.0]), 9, 1.0, corrupted, np.ones(40, bool), missions).detected_at(1.0)
        for missions in (np.arange(40), np.arange(40) // 10)
    )
    assert alone.rate == together.rate == 0.5
    assert together.high - together.low > 2 * (alone.high - alone.low)


def test_the_table_says_what_an_exposure_cannot_show():
    scores = Scores(
        np.array([3.0, 2.0]), 100, 1.5, np.array([2.5, 9.0, 0.0]), np.array([True, True, False]), np.arange(3)
    )
    (row,) = table({"one": scores}, ["a"]).entries()
    assert row["harmful"] == 2 and row["at_0.1"] is None
    assert (row["at_1"].successes, row["at_1"].n) == (2, 2)  # threshold 2.0: one alarm in 1.5 h


@given(made())
def test_the_average_precision_is_that_of_scikit_learn(flights):
    golden, faulty = flights
    harmful = faulty.corrupted[faulty.harmful]
    if not len(harmful):
        assert faulty.precision() is None
        return
    labels = [0] * len(golden) + [1] * len(harmful)
    expected = average_precision_score(labels, [*golden, *harmful])
    assert faulty.precision() == pytest.approx(expected, abs=1e-12)
