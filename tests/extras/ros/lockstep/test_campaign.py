"""`host: ros2` is a key of a campaign: what nodes fly in lock-step is what one process flies."""

import pytest

from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.extras.registers.fault import RegisterFault
from mavfi.extras.ros.lockstep.host import LockstepHost
from mavfi.extras.ros.ros2 import environment
from mavfi.flight.host import ArmSetup, find_host
from tests.campaigns import run_campaign
from tests.core.flights.missions import mission
from tests.extras.ros.lockstep.needs import any_ros

CAMPAIGN = Campaign(
    name="on_ros",
    host="ros2",
    environments=("sparse",),
    first_seed=10000,
    missions=1,
    faults=1,
    null_runs=0,
    mission={"goal": (16, 0, 3)},
)


def records(campaign, directory):
    assert run_campaign(campaign, directory).complete
    with Store.open(directory) as store:
        return {run.spec.run_id: run.record for run in store.runs()}


class TestFlights:
    pytestmark = [*any_ros, pytest.mark.slow]

    def test_every_run_has_the_record_that_the_local_host_gives(self, tmp_path):
        there = records(CAMPAIGN, tmp_path / "ros")  # detectors: test_flights
        here = records(CAMPAIGN.model_copy(update={"host": "local"}), tmp_path / "local")
        assert len(there) == 1 + 3
        assert {run_id: record.digest for run_id, record in there.items()} == {
            run_id: record.digest for run_id, record in here.items()
        }
        assert there == here


def test_without_ros_the_campaign_is_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(environment, "installations", lambda: iter(()))
    with pytest.raises(BadInputError, match="ROS 2 is not installed"):
        run_campaign(CAMPAIGN, tmp_path)


def test_ros_1_is_refused_with_what_replaces_it():
    with pytest.raises(BadInputError, match="host 'ros1': dropped; use ros2"):
        find_host("ros1")
    with pytest.raises(BadInputError, match="campaign 'ros1_smoke': dropped; use mavfi ros fly"):
        load_campaign("ros1_smoke")


def test_faults_of_other_levels_end_their_flight_alone():
    flights = LockstepHost().mission({"": ArmSetup(mission())})
    ((place, error),) = flights.injected([("", RegisterFault())])
    assert place == 0 and "faults of level 'register': allowed: sensor, state" in str(error)


def test_operations_on_several_publications_are_refused():
    content = {"name": "c", "host": "ros2", "environments": ["sparse"]}
    with pytest.raises(ValueError, match="sampling.operations: 'freeze': allowed on ROS: in one publication"):
        Campaign.model_validate({**content, "sampling": {"level": "state", "operations": ["freeze"]}})
