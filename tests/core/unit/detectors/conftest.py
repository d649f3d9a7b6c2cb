import pytest

from mavfi.detectors import training
from tests.core.unit.detectors.streams import PROVENANCE, flight, record


@pytest.fixture(scope="session")
def recordings():
    return [record(flight(seed)) for seed in range(30)]


@pytest.fixture(scope="session")
def models(recordings):
    return training.fit(recordings, PROVENANCE)


@pytest.fixture(scope="session")
def model_folder(models, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    training.save(models, folder)
    return folder
