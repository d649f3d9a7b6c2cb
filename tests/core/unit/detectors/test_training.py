import numpy as np
import pytest

from mavfi.campaign.training import fit
from mavfi.detectors import training
from mavfi.detectors.autoencoder import AutoencoderDetector, representative
from mavfi.detectors.gaussian import GaussianDetector, fit_frozen
from mavfi.detectors.preprocess import Preprocessor
from mavfi.detectors.registry import figures_of
from mavfi.detectors.training import MONITORED_FIELDS, Sample
from mavfi.errors import BadInputError
from tests.core.unit.detectors.streams import PROVENANCE, command, flight, fly, record, status, waypoint


def test_both_detectors_are_fitted_in_both_profiles(models):
    assert set(models) == {"gaussian-paper", "gaussian-tuned", "autoencoder-paper", "autoencoder-tuned"}
    assert models["autoencoder-tuned"].name == "published-i9-9940x-autoencoder-tuned"
    assert {"numpy", "scikit-learn"} <= set(models["gaussian-paper"].provenance["versions"])


@pytest.mark.slow
def test_the_same_flights_give_the_same_models(recordings):
    first, second = (fit(MONITORED_FIELDS, recordings[:3], PROVENANCE) for _ in range(2))
    assert {name: model.sha256 for name, model in first.items()} == {
        name: model.sha256 for name, model in second.items()
    }


def test_the_prediction_is_the_one_that_fits(models):
    assert models["gaussian-tuned"].prediction == "interval"
    sampled = [(waypoint([(0.5 * k) ** 2, 0, 0], [2 * 0.5 * k, 0, 0], index=k), 500_000 * k) for k in range(20)]
    name, errors = training.best_prediction([record(sampled)])
    assert name == "trapezoid"
    assert errors["trapezoid"]["max"] < 1e-12


def test_no_training_flight_raises_a_tuned_alarm(models):
    detectors = GaussianDetector(models["gaussian-tuned"]), AutoencoderDetector(models["autoencoder-tuned"])
    for seed in (0, 13, 29):
        assert [fly(detector, flight(seed)) for detector in detectors] == [[], []]


def test_the_paper_threshold_is_the_upper_bound_on_error_free_flights(models):
    detector = AutoencoderDetector(models["autoencoder-paper"])
    assert all(alarm.score < 1.0 + 1e-9 for seed in range(5) for _, alarm in fly(detector, flight(seed)))


def test_every_rare_publication_is_trained_on():
    slots = np.repeat([0, 1, 2], [50, 30_000, 20_000])
    regimes = np.zeros_like(slots)
    regimes[100:110] = 2
    sample = Sample(np.zeros((len(slots), 13), np.int16), slots, regimes, np.zeros(len(slots), bool))
    rows = representative(sample, 20_000)
    assert np.bincount(slots[rows]).tolist() == [50, 20_010, 20_000]
    assert set(range(100, 110)) <= set(rows.tolist())


def test_a_regime_with_few_samples_takes_the_largest_limit_of_its_field():
    preprocessor = Preprocessor("paper-13", "tuned")
    slots = np.repeat([0, 1, 2], 200)
    vectors = np.zeros((600, 13), np.int16)
    vectors[400:, 9] = np.tile([4, -4], 100)
    sample = Sample(vectors, slots, np.zeros(600, np.int64), np.zeros(600, bool))
    parameters = fit_frozen(sample, preprocessor, margin=1.25, smallest_regime=50)
    assert parameters["limit"][9] == [5.0, 5.0, 5.0]
    assert parameters["limit"][10] == [1.25, 1.25, 1.25]


@pytest.mark.parametrize(
    ("events", "message"),
    [
        ([], "no trajectory of two way-points"),
        ([waypoint([0, 0, 0], [0, 0, 0])] * 3, "perception.collision_status was published less than twice"),
        (
            [s for k in range(3) for s in (waypoint([0, 0, 0], [0, 0, 0]), status(30, 0), command([np.nan, 0, 0]))],
            "not finite",
        ),
    ],
)
def test_recordings_that_cannot_serve_are_refused(events, message):
    recordings = [record([(state, 20_000 * number) for number, state in enumerate(events)])]
    with pytest.raises(BadInputError, match=message):
        fit(MONITORED_FIELDS, recordings, PROVENANCE)


def test_a_model_needs_its_origin(recordings):
    with pytest.raises(BadInputError, match="lacks v_max, planner"):
        fit(MONITORED_FIELDS, recordings[:1], {"stack": "published", "platform": "i9-9940x"})


@pytest.mark.slow
def test_nineteen_fields_can_be_fitted(recordings):
    kinds = {"gaussian": GaussianDetector, "autoencoder": AutoencoderDetector}
    figures = {name: figures_of(name, "tuned") for name in kinds}
    nineteen = training.MonitoredFields("published-19")
    for model in nineteen.fit(kinds, "tuned", recordings[:3], PROVENANCE, figures):
        assert fly(kinds[model.kind](model), flight(0)) == []
