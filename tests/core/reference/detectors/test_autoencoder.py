"""Inference equals scikit-learn's."""

import copy

import numpy as np
import pytest

from mavfi.detectors import autoencoder
from mavfi.detectors.scoring import Reading, largest_ratio, mean_square_ratio


@pytest.fixture(scope="module")
def network():
    inputs = np.random.default_rng(3).normal(size=(600, 13)) @ np.random.default_rng(4).normal(size=(13, 13)) / 4
    trained = autoencoder.train_network(inputs, (6, 3, 6), 40, 2e-3)
    for part in (trained.coefs_, trained.intercepts_):
        part[:] = [np.vectorize(lambda weight: float(f"{weight:.7e}"))(layer) for layer in part]
    return trained


def test_weights_do_not_depend_on_the_last_digits_of_training(network):
    exported = autoencoder.export(network, np.ones(13)).weights
    noise = np.random.default_rng(10)
    disturbed = copy.deepcopy(network)
    for part in (disturbed.coefs_, disturbed.intercepts_):
        part[:] = [layer * (1.0 + noise.uniform(-1e-13, 1e-13, layer.shape)) for layer in part]
    assert any(np.any(weights != other) for weights, other in zip(network.coefs_, disturbed.coefs_, strict=True))
    assert np.array_equal(autoencoder.export(disturbed, np.ones(13)).weights, exported)


def test_the_layers_are_those_of_the_paper(network):
    assert [coefficients.shape for coefficients in network.coefs_] == [(13, 6), (6, 3), (3, 6), (6, 13)]
    assert (network.activation, network.out_activation_) == ("tanh", "identity")


def test_outputs_are_those_of_scikit_learn(network):
    exported = autoencoder.export(network, np.ones(13))
    for inputs in np.random.default_rng(5).uniform(-10, 10, (200, 13)):
        autoencoder.reconstruct(inputs, exported)
        assert np.abs(exported.work[0, :13] - network.predict(inputs[None])[0]).max() < 1e-12


def test_residuals_are_those_of_scaled_and_clamped_inputs(network):
    scale = np.random.default_rng(6).uniform(1, 20, 13)
    vectors = np.random.default_rng(7).integers(-1000, 1000, (50, 13)).astype(np.int16)
    inputs = np.clip(vectors / scale, -10, 10)
    expected = np.abs(inputs - network.predict(inputs))
    assert np.abs(autoencoder.all_residuals(vectors, autoencoder.export(network, scale)) - expected).max() < 1e-12


def test_scores_are_mean_square_or_the_largest_ratio():
    errors = np.random.default_rng(8).uniform(0, 2, 13)
    limit = np.random.default_rng(9).uniform(0.1, 1, (13, 3))
    reading, ratios = Reading(errors, np.full(13, 2.0), 2, 9, 1), np.zeros(13)
    assert largest_ratio(reading, limit, ratios) == pytest.approx((errors / limit[:, 1] / 2.0)[2:9].max())
    assert ratios[2:9] == pytest.approx((errors / limit[:, 1] / 2.0)[2:9])
    assert mean_square_ratio(reading, np.array([[0.25]]), ratios) == pytest.approx((errors**2).mean() / 0.25)
