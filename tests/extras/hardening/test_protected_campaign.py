"""A campaign with an arm that combines a protection plan, a detector and a restart policy."""

import pytest

from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.replay import replay
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import Store
from mavfi.extras.hardening.plan import ProtectionPlan, load_plan, save_plan
from mavfi.extras.hardening.protected import SOURCE

pytestmark = pytest.mark.slow  # flies a campaign


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """The ledger, and its runs by setting.

    The plan is the shipped one of the tracker; its time is not charged, so that golden flights can be compared.
    """
    folder = tmp_path_factory.mktemp("combined")
    functions = tuple(
        one.model_copy(update={"time": 1.0}) for one in load_plan("full").functions if one.kernel == "pid"
    )
    save_plan(ProtectionPlan(functions=functions), folder / "plan.yaml")
    config = Campaign.model_validate(
        {
            "name": "combined",
            "environments": ["sparse"],
            "first_seed": 7,
            "missions": 1,
            "faults": 5,
            "sampling": {"level": "instruction", "kernels": ["pid"], "which": "data"},
            "mission": {"v_max": 6.0},
            "arms": {
                "combined": {"protection": str(folder / "plan.yaml"), "detector": "acceptance", "dead_node": "readback"}
            },
        }
    )
    assert run_campaign(config, folder / "out", executor=LocalExecutor(1)).complete
    with Store.open(folder / "out") as store:
        runs = list(store.runs(done=True))
    return folder / "out", {
        setting: [one for one in runs if one.spec.setting == setting] for setting in {one.spec.setting for one in runs}
    }


def test_golden_flights_of_the_arm_are_the_plain_ones(flown):
    _, runs = flown
    golden = [one.record for own in runs.values() for one in own if one.spec.kind == "golden"]
    assert len(golden) == 2 and len({one.digest for one in golden}) == 1
    assert not any(one.alarms for one in golden)


def test_what_changes_the_flight_without_protection_is_detected(flown):
    directory, runs = flown
    (digest,) = {one.record.digest for own in runs.values() for one in own if one.spec.kind == "golden"}
    pairs = list(zip(runs["fi"], runs["dr_combined"], strict=True))
    assert all(before.spec.fault == after.spec.fault for before, after in pairs)
    found = [after for before, after in pairs if before.record.digest != digest]
    assert found and {one.record.kernel.effect for one in found} == {"detected"}
    assert all(SOURCE in {alarm.source for alarm in one.record.alarms} for one in found)
    assert replay(directory, found[0].spec.run_id).same
