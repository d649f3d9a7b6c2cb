"""Adapters of libraries: their common part with a model of our own, each library where it is installed."""

import numpy as np
import pytest

from mavfi.detectors import load_detector
from mavfi.detectors.autoencoder import INPUT_LIMIT
from mavfi.detectors.model import Model
from mavfi.detectors.training import join
from mavfi.errors import NotInstalledError
from mavfi.extras.bench import library, trees
from mavfi.extras.bench.field_codes import MONITORED, FieldCodes, sample_of
from mavfi.extras.bench.library import (
    Components,
    Ellipsoid,
    Inputs,
    LibraryDetector,
    MahalanobisDetector,
    PcaDetector,
    rates,
    scaled,
)
from mavfi.extras.bench.matrix_profile import (
    BLOCK,
    LENGTH,
    MatrixProfileDetector,
    nearest,
    subsequences,
)
from mavfi.extras.bench.trees import (
    GradientBoostingDetector,
    HalfSpaceTreesDetector,
    IsolationForestDetector,
    Regressor,
    Split,
    StateTrees,
    forest_of,
    half_spaces,
    limit_of,
    regressor,
    regressors,
    single_limit,
    tables_of,
)
from tests.core.unit.detectors.streams import PROVENANCE, fly, later, strike
from tests.core.unit.detectors.test_registry import FITS
from tests.extras.bench.test_all_fields import flight, with_codes

FIGURES = {"largest_class": 60, "calibrated": 100_000, "margin": 1.25, "smallest_regime": 50}
LIBRARIES = [
    IsolationForestDetector,
    PcaDetector,
    MahalanobisDetector,
    HalfSpaceTreesDetector,
    GradientBoostingDetector,
    MatrixProfileDetector,
]


class EllipsoidDetector(LibraryDetector):
    """A library that is always installed: mean and covariance."""

    model_kind, package = "ellipsoid", "numpy"

    @classmethod
    def tables(cls, rows, slots, field_codes, inputs):
        assert rows.shape == (len(slots), (field_codes.quanta > 0).sum()) and (rows.std(axis=0) > 0).all()
        covariance = np.cov(rows.T) + 1e-3 * np.eye(rows.shape[1])
        return Ellipsoid(inputs, rows.mean(axis=0), np.linalg.inv(covariance), np.zeros(rows.shape[1]))


@pytest.fixture(scope="module")
def sample():
    field_codes = FieldCodes("published")
    flown = [with_codes(flight(seed, ticks=500)) for seed in range(6)]
    return join([sample_of(one, field_codes) for one in flown])


def fitted(kind, sample, figures):
    parameters = kind.fit(sample, FieldCodes("published"), figures)
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
        kind.model_kind,
        "control",
        ("control.command",),
    )
    detector.start()
    for event in events[:200]:
        detector.check(*event), detector.accept(*event)
    memory = detector.memory()
    rest = [(detector.score(*event), detector.accept(*event)) for event in events[200:]]
    other.restore(memory)
    assert other.memory() == memory != detector.memory()
    assert [(other.score(*event), other.accept(*event)) for event in events[200:]] == rest


def test_a_fitted_model_judges_publications_and_remembers_normal_ones(sample):
    check(EllipsoidDetector, sample, FIGURES)


def test_a_library_that_is_not_installed_is_named_before_its_model_is_looked_for(monkeypatch):
    monkeypatch.setattr(library, "find_spec", lambda name: None)
    packages = {"pca": "pyod", "half_space_trees": "river", "gradient_boosting": "lightgbm", "matrix_profile": "stumpy"}
    for name, package in packages.items():
        message = rf"'{name}': needs {package}; install it with: pip install 'mavfi\[bench\]'"
        with pytest.raises(NotInstalledError, match=message):
            load_detector(name, "paper", None, FITS)


def correlated(seed):
    """Rows of two states: codes 0 and 1 of the first are equal up to noise, codes 2 and 3 of the second independent."""
    random = np.random.default_rng(seed)
    rows = random.uniform(-1.0, 1.0, (600, 4))
    rows[:, 1] = rows[:, 0] + random.normal(0.0, 0.01, 600)
    return rows, np.arange(600) % 2


COLUMNS, UNIT = [np.array([0, 1]), np.array([2, 3])], 1000.0
INPUTS = Inputs(np.arange(4), np.full(4, UNIT))


def coded(rows):
    """Codes, and the inputs that they are."""
    codes = np.round(UNIT * rows).astype(np.int16)
    return codes, scaled(codes, UNIT)


def test_regressors_predict_what_the_library_predicts():
    pytest.importorskip("lightgbm", exc_type=ImportError)
    (rows, slots), (others, _) = correlated(3), correlated(5)
    others[::5] *= 10.0
    codes, others = coded(others)
    found, wanted = rates(codes, slots, regressors(rows, slots, COLUMNS, INPUTS)), np.zeros(len(slots))
    for slot, columns in enumerate(COLUMNS):
        own, trained = slots == slot, rows[slots == slot]
        for column in columns:
            trees = regressor(trained[::2], int(column))

            def residuals(given, trees=trees, column=column):
                return np.abs(given[:, column] - trees.predict(np.delete(given, column, axis=1)))

            wanted[own] = np.maximum(wanted[own], residuals(others[own]) / np.quantile(residuals(trained[1::2]), 0.99))
    assert found.tolist() == wanted.tolist()


def test_half_spaces_score_what_the_library_scores():
    pytest.importorskip("river", exc_type=ImportError)
    (rows, slots), (others, _) = correlated(5), correlated(6)
    codes, others = coded(others[:200])
    found = rates(codes, slots[:200], half_spaces(rows, slots, COLUMNS, INPUTS))
    forests = [trees.fitted(rows[slots == slot][:, own]) for slot, own in enumerate(COLUMNS)]
    wanted = [
        forests[slot].score_one(dict(enumerate(row[COLUMNS[slot]].tolist())))
        for row, slot in zip(others, slots[:200], strict=True)
    ]
    assert found.tolist() == wanted and np.ptp(found) > 0.1


@pytest.mark.parametrize("kind", LIBRARIES[:3], ids=lambda kind: kind.model_kind)
def test_outliers_score_what_the_library_scores(kind):
    pytest.importorskip("pyod", exc_type=ImportError)
    (rows, slots), (others, _) = correlated(7), correlated(8)
    others[::5] *= 10.0
    codes, others = coded(others)
    library = kind.make().fit(rows)
    found, wanted = rates(codes, slots, kind.tables_of(library, INPUTS, 2)), library.decision_function(others)
    assert found == pytest.approx(wanted, rel=1e-9, abs=1e-9)


def random_tree(random, depth, width=3):
    """A tree of any form; thresholds are inputs, or between them."""
    if depth == 0 or random.random() < 0.2:
        return float(random.normal())
    threshold = random.integers(-9, 9) / 4.0 if random.random() < 0.5 else random.normal()
    below, above = random_tree(random, depth - 1, width), random_tree(random, depth - 1, width)
    return Split(int(random.integers(width)), float(threshold), below, above)


def leaf_of(tree, row):
    while isinstance(tree, Split):
        tree = tree.low if row[tree.column] <= tree.threshold else tree.high
    return tree


FIELDS = Inputs(np.array([1, 2, 4]), np.array([4.0, 40.0, 1.0]))
"""Inputs: three of five fields."""


def some_codes(random, count):
    codes = np.round(random.normal(size=(count, 5)) * [1.0, 4.0, 40.0, 1.0, 1.0]).astype(np.int16)
    codes[::7] = random.integers(-(1 << 15), 1 << 15, codes[::7].shape)
    codes[1], codes[2] = -(1 << 15), (1 << 15) - 1
    return codes, scaled(codes[:, FIELDS.columns], FIELDS.scale)


@pytest.mark.parametrize("seed", range(5))
def test_a_forest_sums_the_leaves_that_a_naive_walk_reaches(seed):
    random = np.random.default_rng(seed)
    states = [
        StateTrees([random_tree(random, 6) for _ in range(count)], random.uniform(0.1, 2.0)) for count in (5, 0, 9)
    ]
    (codes, rows), slots = some_codes(random, 60), np.arange(60) % 3
    sums = [sum(leaf_of(tree, row) for tree in states[slot].trees) for row, slot in zip(rows, slots, strict=True)]
    wanted = np.array(sums) / [states[slot].unit for slot in slots]
    assert rates(codes, slots, forest_of(states, FIELDS)).tolist() == wanted.tolist()
    decayed = np.where(slots == 1, 0.0, -0.5 - np.exp(-wanted))
    assert rates(codes, slots, forest_of(states, FIELDS, decays=True, sign=-1.0, shift=-0.5)) == pytest.approx(
        decayed, rel=1e-12
    )


@pytest.mark.parametrize("seed", range(5))
def test_regressors_predict_what_a_naive_walk_predicts(seed):
    """By bits, each tree of at most 16 leaves."""
    random = np.random.default_rng(seed)
    states = [
        [
            Regressor([random_tree(random, 4) for _ in range(trees)], int(random.integers(3)), random.uniform(0.1, 2.0))
            for trees in counts
        ]
        for counts in ((5, 3), (), (9, 1, 0))
    ]
    (codes, rows), slots = some_codes(random, 60), np.arange(60) % 3
    wanted = [
        max(
            (abs(row[one.column] - sum(leaf_of(tree, row) for tree in one.trees)) / one.unit for one in states[slot]),
            default=0.0,
        )
        for row, slot in zip(rows, slots, strict=True)
    ]
    assert rates(codes, slots, tables_of(states, FIELDS)).tolist() == wanted


@pytest.mark.parametrize("seed", range(10))
def test_limits_in_codes_are_thresholds_of_inputs(seed):
    random = np.random.default_rng(seed)
    scale = float(random.choice([1.0, 7.0, 1000.0, 30000.0]))
    inputs = Inputs(np.zeros(1, np.int64), np.array([scale]))
    every = np.arange(-(1 << 15), 1 << 15)
    bounds = (-INPUT_LIMIT, INPUT_LIMIT, np.nextafter(INPUT_LIMIT, 0.0), np.nextafter(-INPUT_LIMIT, -20.0))
    threshold = float(
        random.choice([random.normal(), 8.0 * random.normal(), *bounds, random.integers(-99, 99) / scale])
    )
    lower = every[scaled(every, np.array([scale])) <= threshold]
    assert limit_of(Split(0, threshold, 0.0, 0.0), inputs) == (lower[-1] if len(lower) else -(1 << 15) - 1)


@pytest.mark.parametrize("seed", range(20))
def test_the_limit_of_an_input_is_that_of_its_single_precision(seed):
    random = np.random.default_rng(seed)
    threshold = float(random.normal() * 10.0 ** random.integers(-6, 3))
    if seed % 2:
        threshold = float(np.float32(threshold))
    limit = single_limit(threshold)
    assert np.float32(limit) <= threshold < np.float32(np.nextafter(limit, np.inf))


def test_the_score_of_components_is_that_of_a_naive_sum():
    random = np.random.default_rng(3)
    mean, deviation, weights = random.normal(size=5), random.uniform(0.5, 2.0, 5), random.uniform(0.1, 1.0, 3)
    components, rows = random.normal(size=(5, 3)), random.normal(size=(20, 5))
    codes, rows = coded(rows)
    model = Components(Inputs(np.arange(5), np.full(5, UNIT)), mean, deviation, components, weights, np.zeros(3))
    wanted = [
        sum(np.linalg.norm((row - mean) / deviation - components[:, k]) / weights[k] for k in range(3)) for row in rows
    ]
    assert rates(codes, np.zeros(20, np.int64), model) == pytest.approx(wanted, rel=1e-12)


def test_the_score_of_an_ellipsoid_is_that_of_a_naive_product():
    random = np.random.default_rng(4)
    centre, half, rows = random.normal(size=5), random.normal(size=(5, 5)), random.normal(size=(20, 5))
    codes, rows = coded(rows)
    wanted = [(row - centre) @ (half @ half.T) @ (row - centre) for row in rows]
    model = Ellipsoid(Inputs(np.arange(5), np.full(5, UNIT)), centre, half @ half.T, np.zeros(5))
    assert rates(codes, np.zeros(20, np.int64), model) == pytest.approx(wanted, rel=1e-12)


def distance(stretch, series):
    columns = subsequences(series)
    return nearest(stretch, columns, columns.sum(axis=0), np.zeros(BLOCK))


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_stretch_is_that_of_a_naive_search(seed):
    random = np.random.default_rng(seed)
    count = int(random.choice([LENGTH, 20, 200, 700]))
    walk = random.normal(size=count) if seed % 2 else np.cumsum(random.integers(-1, 2, count)) / 7.0
    for stretch in (random.normal(size=LENGTH), walk[-LENGTH:] + 0.3 * random.normal(size=LENGTH), walk[:LENGTH]):
        naive = min(np.sqrt(((walk[k : k + LENGTH] - stretch) ** 2).sum()) for k in range(count - LENGTH + 1))
        assert distance(stretch, walk) == pytest.approx(naive, rel=1e-12, abs=1e-15)
