from pathlib import Path

import pytest

from mavfi.analysis.runs import Runs
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalExecutor
from tests.campaigns import run_campaign


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    """A flown campaign of two missions, with an arm whose detector never alarms: `dr` must equal `fi` in it."""
    directory: Path = tmp_path_factory.mktemp("campaign")
    campaign = Campaign.model_validate(
        {
            "name": "tiny",
            "environments": ["sparse"],
            "missions": 2,
            "faults": 2,
            "null_runs": 2,
            "sampling": {"strata": {"sign_exponent": 1, "mantissa": 1}},
            "arms": {"idle": {"detector": "none"}},
        }
    )
    run_campaign(campaign, directory, executor=LocalExecutor(1))
    return directory


@pytest.fixture(scope="session")
def runs(flown):
    return Runs.read(flown)
