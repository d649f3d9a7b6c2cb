import pytest

from mavfi.campaign.training import fit
from mavfi.detectors.training import MONITORED_FIELDS
from tests.core.unit.detectors.streams import PROVENANCE, flight, record


@pytest.fixture(scope="session")
def recordings():
    return [record(flight(seed)) for seed in range(30)]


@pytest.fixture(scope="session")
def models(recordings):
    return fit(MONITORED_FIELDS, recordings, PROVENANCE)


@pytest.fixture(scope="session")
def model_folder(models, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    for model in models.values():
        model.save(folder)
    return folder
