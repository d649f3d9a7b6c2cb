import numpy as np
import pytest

from mavfi.campaign.training import fit
from mavfi.detectors import training
from mavfi.detectors.autoencoder import AutoencoderDetector, representative
from mavfi.detectors.training import MONITORED_FIELDS, WATCHED, Sample
from mavfi.errors import BadInputError
from tests.core.unit.detectors.streams import PROVENANCE, command, flight, fly, record, status, waypoint


def test_both_detectors_are_fitted_in_both_profiles(models):
    assert set(models) == {"gaussian-paper", "gaussian-tuned", "autoencoder-paper", "autoencoder-tuned"}
    assert models["autoencoder-tuned"].name == "published-i9-9940x-autoencoder-tuned"
    assert {"numpy", "scikit-learn"} <= set(models["gaussian-paper"].provenance["versions"])


def test_the_prediction_is_the_one_that_fits(models):
    assert models["gaussian-tuned"].prediction == "interval"
    sampled = [(waypoint([(0.5 * k) ** 2, 0, 0], [2 * 0.5 * k, 0, 0], index=k), 500_000 * k) for k in range(20)]
    name, errors = training.best_prediction([record(sampled)])
    assert name == "trapezoid"
    assert errors["trapezoid"]["max"] < 1e-12


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


def test_headers_come_back_as_they_were_published():
    events = flight(1)
    recording = record(events)
    for name in WATCHED:
        published = [(state.header, time_us) for state, time_us in events if state.spec.name == name]
        times_us, headers = recording.headers(name)
        assert times_us.tolist() == [time_us for _, time_us in published]
        assert headers.tobytes() == np.concatenate([header for header, _ in published]).tobytes()
