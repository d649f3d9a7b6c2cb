"""Adapters of libraries: their common part with a model of our own, each library where it is installed."""

from dataclasses import replace

import numpy as np
import pytest

from mavfi.detectors import load_detector
from mavfi.detectors.baselines import library, matrix_profile
from mavfi.detectors.baselines.gradient_boosting import GradientBoostingDetector, Regressors
from mavfi.detectors.baselines.half_space_trees import Forests, HalfSpaceTreesDetector
from mavfi.detectors.baselines.library import LibraryDetector, columns_of, score_once
from mavfi.detectors.baselines.matrix_profile import LENGTH, MatrixProfileDetector, StretchScorer, nearest
from mavfi.detectors.baselines.outliers import IsolationForestDetector, MahalanobisDetector, PcaDetector
from mavfi.detectors.everything import MONITORED, Codes, Everything, sample_of
from mavfi.detectors.model import Model
from mavfi.detectors.parts import Verdict
from mavfi.detectors.registry import settings_of
from mavfi.detectors.samples import join
from mavfi.errors import BadInputError
from mavfi.states import AUTOPILOTS
from tests.unit.detectors.streams import PROVENANCE, fly, later, strike
from tests.unit.detectors.test_all_fields import flight, with_codes
from tests.unit.detectors.test_registry import FITS

FIGURES = {"largest_class": 60, "calibrated": 100_000, "margin": 1.25, "smallest_regime": 50}


class Nearest:
    """Distance from the nearest row."""

    def __init__(self, inputs):
        self.inputs = inputs

    def scores(self, inputs, slots):
        return np.array([np.sqrt(((self.inputs - row) ** 2).sum(axis=1)).min() - 5.0 for row in inputs])


class NearestDetector(LibraryDetector):
    model_kind, package = "nearest", "numpy"

    @classmethod
    def judge(cls, inputs, slots, everything):
        assert inputs.shape == (len(slots), (everything.quanta > 0).sum()) and (inputs.std(axis=0) > 0).all()
        return Nearest(inputs)


@pytest.fixture(scope="module")
def sample():
    everything = Everything("published")
    flown = [with_codes(flight(seed, ticks=500)) for seed in range(6)]
    return join([sample_of(Codes(one.slots, one.regimes, one.codes), everything) for one in flown])


def fitted(kind, sample, figures):
    parameters = kind.fit(sample, Everything("published"), figures)
    return Model(kind.model_kind, "tuned", MONITORED, "", parameters, dict(PROVENANCE))


def wild(state, number, events):
    """Several fields of one publication far away."""
    struck = later(events, state, number)
    for field, value in (("vx", -1e3), ("vy", 1e3), ("vz", 1e3)):
        events = strike(events, struck, field, value)
    return struck, events


def check(kind, sample, figures):
    model = Model.from_json(fitted(kind, sample, figures).to_json())
    detector, other = kind(model), kind(model)
    assert fly(detector, flight(2, ticks=500)) == []
    struck, events = wild("control.command", 150, flight(40, ticks=300))
    alarms = dict(fly(detector, events))
    assert struck in alarms
    assert (alarms[struck].source, alarms[struck].stage, alarms[struck].fields) == (
        kind.model_kind, "control", ("control.command",),
    )  # fmt: skip
    detector.start()
    for event in events[:200]:
        detector.check(*event), detector.accept(*event)
    memory = detector.memory()
    rest = [(detector.score(*event), detector.accept(*event)) for event in events[200:]]
    other.restore(memory)
    assert other.memory() == memory != detector.memory()
    assert [(other.score(*event), other.accept(*event)) for event in events[200:]] == rest


def test_a_fitted_model_judges_publications_and_remembers_normal_ones(sample):
    check(NearestDetector, sample, FIGURES)


def test_detectors_of_one_model_fit_it_once_and_score_each_on_its_own(sample, monkeypatch):
    model, fits, scored = fitted(NearestDetector, sample, {**FIGURES, "largest_class": 50}), [], []
    judge, scores = NearestDetector.judge.__func__, Nearest.scores
    monkeypatch.setattr(NearestDetector, "judge", classmethod(lambda *given: fits.append(1) or judge(*given)))
    monkeypatch.setattr(Nearest, "scores", lambda *given: scored.append(1) or scores(*given))
    flights, counts = flight(2, ticks=50), []
    for detector in (NearestDetector(model), NearestDetector(model)):
        fly(detector, flights), fly(detector, flights)  # the second flight has the same publications
        counts.append(len(scored))
    assert len(fits) == 1 and counts[1] == 2 * counts[0] > 0
    NearestDetector(replace(model, parameters={**model.parameters, "rows": model.parameters["rows"][::-1]}))
    assert len(fits) == 2, "another model"


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(
    "kind",
    [
        IsolationForestDetector,
        PcaDetector,
        MahalanobisDetector,
        HalfSpaceTreesDetector,
        GradientBoostingDetector,
        MatrixProfileDetector,
    ],
    ids=lambda kind: kind.model_kind,
)
def test_libraries_find_a_gross_fault_and_raise_no_alarm_in_a_training_flight(kind, sample):
    package = "stumpy" if kind is MatrixProfileDetector else kind.package
    pytest.importorskip(package, exc_type=ImportError)
    figures = dict(settings_of(kind.model_kind, "tuned").fit)
    figures["calibrated"] = 100_000 if "margin" in figures and kind is not MatrixProfileDetector else 400
    check(kind, sample, figures)


def test_a_library_that_is_not_installed_is_named_before_its_model_is_looked_for(monkeypatch):
    monkeypatch.setattr(library, "find_spec", lambda name: None)
    packages = {"pca": "pyod", "half_space_trees": "river", "gradient_boosting": "lightgbm", "matrix_profile": "stumpy"}
    for name, package in packages.items():
        with pytest.raises(
            BadInputError, match=rf"{package}.*not installed; install it with: pip install 'mavfi\[bench\]'"
        ):
            load_detector(name, "paper", None, FITS)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_the_columns_of_states_are_all_watched_ones_once(autopilot):
    everything = Everything(autopilot)
    columns = np.concatenate(columns_of(everything))
    assert columns.tolist() == list(range((everything.quanta > 0).sum()))


def correlated(seed):
    """Rows of two states: codes 0 and 1 of the first are equal up to noise, codes 2 and 3 of the second independent."""
    random = np.random.default_rng(seed)
    rows = random.uniform(-1.0, 1.0, (600, 4))
    rows[:, 1] = rows[:, 0] + random.normal(0.0, 0.01, 600)
    return rows, np.arange(600) % 2


def test_a_code_that_does_not_agree_with_the_others_scores_high_within_its_own_range():
    pytest.importorskip("lightgbm", exc_type=ImportError)
    columns = [np.array([0, 1]), np.array([2, 3])]
    judge, (rows, slots) = Regressors(*correlated(1), columns), correlated(2)
    normal = judge.scores(rows, slots)
    assert np.mean(normal[slots == 0] > 1.0) < 0.1 and np.mean(normal[slots == 1] > 1.0) < 0.1
    wrong = rows.copy()
    wrong[:, 1] = np.where(rows[:, 0] > 0.0, rows[:, 0] - 1.0, rows[:, 0] + 1.0)
    assert judge.scores(wrong, slots)[slots == 0].min() > 4.0
    wrong[:, :2] = rows[:, :2]
    wrong[:, 2] = 3.0
    struck = judge.scores(wrong, slots)
    assert struck[slots == 1].min() > 1.5 and np.median(struck[slots == 0]) < 1.0


def test_regressors_score_the_same_alone_together_and_fitted_again():
    pytest.importorskip("lightgbm", exc_type=ImportError)
    columns = [np.array([0, 1]), np.array([2, 3])]
    rows, slots = correlated(3)
    judge, again = Regressors(rows, slots, columns), Regressors(rows, slots, columns)
    together = judge.scores(rows[:20], slots[:20])
    assert together.tolist() == again.scores(rows[:20], slots[:20]).tolist()
    assert together.tolist() == [judge.scores(rows[k : k + 1], slots[k : k + 1])[0] for k in range(20)]


def test_a_state_with_too_few_rows_has_no_regressors():
    pytest.importorskip("lightgbm", exc_type=ImportError)
    rows, slots = correlated(4)
    rare = np.where(np.arange(600) < 7, 1, 0)
    scores = Regressors(rows, rare, [np.array([0, 1]), np.array([2, 3])]).scores(rows, slots)
    assert (scores[slots == 1] == 0.0).all() and (scores[slots == 0] > 0.0).any()


def test_a_state_without_codes_has_no_scores_in_half_space_trees():
    pytest.importorskip("river", exc_type=ImportError)
    rows, slots = correlated(5)
    scores = Forests(rows, slots, [np.arange(4), np.arange(0)]).scores(rows[:200], slots[:200])
    assert (scores[slots[:200] == 1] == 0.0).all() and (scores[slots[:200] == 0] > 0.0).any()


def test_the_nearest_stretch_is_that_of_a_naive_search():
    pytest.importorskip("stumpy", exc_type=ImportError)
    random = np.random.default_rng(1)
    history, stretch = random.normal(size=200), random.normal(size=LENGTH)
    naive = min(np.sqrt(((history[k : k + LENGTH] - stretch) ** 2).sum()) for k in range(200 - LENGTH + 1))
    assert nearest(stretch, history) == pytest.approx(naive, abs=1e-9)
    assert nearest(stretch, history[: LENGTH - 1]) == 0.0


def test_the_value_is_that_of_an_incremental_matrix_profile():
    stumpy = pytest.importorskip("stumpy", exc_type=ImportError)
    random = np.random.default_rng(2)
    history, stretch = random.normal(size=60), random.normal(size=LENGTH)
    profile = stumpy.stumpi(history, LENGTH, egress=False, normalize=False)
    for value in stretch:
        profile.update(value)
    # stumpi also compares with stretches that reach into the new values
    assert profile.P_[-1] <= nearest(stretch, history) + 1e-9


def test_after_an_anomaly_normal_values_are_normal_again(monkeypatch):
    """If anomalies were left out of the subsequence, what follows one would not fit what came before it."""
    history = np.array([0.0] * 20 + [0.5] + [1.0] * 20)

    def naive(last, own):
        return min(float(np.linalg.norm(own[k : k + LENGTH] - last)) for k in range(len(own) - LENGTH + 1))

    monkeypatch.setattr(matrix_profile, "nearest", naive)
    everything = Everything("published")
    scorer = StretchScorer(everything, [history] * len(everything.slots), np.ones(len(everything.fields)))
    scores = []
    for value in [0.0] * LENGTH + [9.0] + [1.0] * (2 * LENGTH):
        monkeypatch.setattr(scorer, "value", lambda slot, value=value: value)
        scores.append(scorer.score_of(0, 0))
        scorer.learn(0, Verdict(4.0 * scores[-1], np.array([4.0 * scores[-1]])))
    assert scores[:LENGTH] == [0.0] * LENGTH and scores[LENGTH] > 8.0
    assert scores[-LENGTH - 1 :] == [0.0] * (LENGTH + 1), "a subsequence after the anomaly"


def test_a_score_is_computed_once_for_each_model_state_and_input():
    class Counting:
        def __init__(self, unit):
            self.unit, self.computed = unit, 0

        def scores(self, inputs, slots):
            assert inputs.shape == (1, 2)
            self.computed += 1
            return self.unit * (inputs.sum(axis=1) + 100 * slots)

    one, other = Counting(1.0), Counting(2.0)
    rows = [np.array(row).tobytes() for row in ([0.0, 1.0], [2.0, 3.0])]
    for _ in range(2):
        assert [score_once(one, slot, row) for slot in (0, 1) for row in rows] == [1.0, 5.0, 101.0, 105.0]
        assert score_once(other, 0, rows[0]) == 2.0
    assert (one.computed, other.computed) == (4, 1)
