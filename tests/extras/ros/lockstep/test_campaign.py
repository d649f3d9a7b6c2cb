"""`host: ros2` and `host: ros1` are keys of a campaign: what nodes fly in lock-step is what one process flies."""

import pytest

from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.extras.ros.ros1 import finder
from mavfi.extras.ros.ros1.host import Ros1Host
from mavfi.faults.fault import RegisterFault
from mavfi.flight.host import SHIPPED, ArmSetup
from tests.campaigns import run_campaign
from tests.core.flights.missions import mission
from tests.extras.ros.lockstep.needs import ANY, any_ros, number


def records(campaign, directory):
    assert run_campaign(campaign, directory).complete
    with Store.open(directory) as store:
        return {run.spec.run_id: run.record for run in store.runs()}


class TestFlights:
    pytestmark = [*any_ros, pytest.mark.slow]

    def test_every_run_has_the_record_that_the_local_host_gives(self, tmp_path, monkeypatch):
        monkeypatch.setitem(SHIPPED, "ros2", "mavfi.extras.ros.ros2.host:Ros2Host")  # also before it is installed
        campaign = load_campaign("ros1_smoke").model_copy(
            update={"arms": {}, "null_runs": 0}
        )  # detectors: test_flights
        there = records(campaign.model_copy(update={"host": f"ros{number(ANY)}"}), tmp_path / "ros")
        here = records(campaign.model_copy(update={"host": "local"}), tmp_path / "local")
        assert len(there) == 1 + 3
        assert {run_id: record.digest for run_id, record in there.items()} == {
            run_id: record.digest for run_id, record in here.items()
        }
        assert there == here


def test_without_ros_the_campaign_is_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(finder, "missing", lambda: ["rospy"])
    with pytest.raises(BadInputError, match="ROS is not installed"):
        run_campaign(load_campaign("ros1_smoke"), tmp_path)


def test_faults_of_other_levels_end_their_flight_alone():
    flights = Ros1Host().mission({"": ArmSetup(mission())})
    ((place, error),) = flights.injected([("", RegisterFault())])
    assert place == 0 and "faults of level 'register': allowed: sensor, state" in str(error)


def test_operations_on_several_publications_are_refused():
    content = {"name": "c", "host": "ros2", "environments": ["sparse"]}
    with pytest.raises(ValueError, match="sampling.operations: 'freeze': allowed on ROS: in one publication"):
        Campaign.model_validate({**content, "sampling": {"level": "state", "operations": ["freeze"]}})
