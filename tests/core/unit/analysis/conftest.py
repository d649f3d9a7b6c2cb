import pytest

from mavfi.analysis.runs import Runs
from mavfi.campaign.executors.local import LocalExecutor
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import small


@pytest.fixture(scope="session")
def fake(tmp_path_factory):
    """Runs of a campaign on made-up flights: two environments, one arm with a detector."""
    directory = tmp_path_factory.mktemp("fake")
    run_campaign(small(missions=10, faults=20), directory, executor=LocalExecutor(1))
    return Runs.read(directory)
