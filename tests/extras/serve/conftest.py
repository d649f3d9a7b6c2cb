from concurrent.futures import Future

import pytest
from starlette.testclient import TestClient

from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.extras.serve.app import application
from mavfi.extras.serve.flights import RequestedFlights, flown_page
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import HOST
from tests.core.unit.report.html.conftest import browser, driver  # noqa: F401

TOKEN = "the-token"
CAMPAIGN = {
    "name": "tiny",
    "environments": ["sparse"],
    "missions": 1,
    "faults": 1,
    "sampling": {"strata": {"sign_exponent": 1}},
    "null_runs": 1,
}


class WaitingFlights(RequestedFlights):
    """Does not fly; what was asked for is in `asked`."""

    def __init__(self):
        super().__init__()
        self.asked = []

    def _fly(self, run):
        self.asked.append(run)
        return Future()


class FlightsHere(RequestedFlights):
    """Flies in this process."""

    def _fly(self, run):
        flown = Future()
        flown.set_result(flown_page(run))
        return flown


@pytest.fixture(scope="session")
def study(tmp_path_factory):
    """A folder with two ledgers, whose flights are those of a fake."""
    folder = tmp_path_factory.mktemp("study")
    for name, missions in (("first", 1), ("more/second", 2)):
        campaign = Campaign.model_validate({**CAMPAIGN, "missions": missions, "host": HOST})
        run_campaign(campaign, folder / name, executor=LocalExecutor(1))
    return folder


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    """A ledger of real flights."""
    folder = tmp_path_factory.mktemp("flown")
    run_campaign(Campaign.model_validate(CAMPAIGN), folder, executor=LocalExecutor(1))
    return folder


@pytest.fixture
def stranger(study):
    """A client without the token."""
    return client_of(study, RequestedFlights())


@pytest.fixture
def client(stranger):
    """A client with the token's cookie."""
    assert stranger.get("/", params={"token": TOKEN}).status_code == 200
    return stranger


def client_of(folder, flights):
    return TestClient(application(folder, TOKEN, flights), base_url="http://127.0.0.1:8321")
