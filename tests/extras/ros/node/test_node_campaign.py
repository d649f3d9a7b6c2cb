"""A campaign on Debian's robot_state_publisher, and flights as bags that Debian's rosbag reads."""

import pytest

from mavfi.campaign.config import load_campaign
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import Store
from mavfi.extras.ros.node.bench import run_trial
from mavfi.faults.fault import RegisterFault
from mavfi.outcomes import effect_of

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def campaign():
    shipped = load_campaign("ros_robot_state_publisher")
    return shipped.model_copy(
        update={
            "faults": 2,
            "null_runs": 1,
            "node": shipped.under_test.model_copy(update={"golden_runs": 1}),
            "sampling": shipped.sampling.model_copy(update={"walk": 500}),
        }
    )


@pytest.mark.slow
def test_a_campaign_is_resumable_and_every_run_has_an_effect(ros, campaign, tmp_path):
    def stop(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(campaign, tmp_path, progress=stop)
    assert run_campaign(campaign, tmp_path).complete
    with Store.open(tmp_path) as store:
        runs = list(store.runs())
    assert [run.spec.setting for run in runs] == ["golden"] * 2 + ["fi"] * 4 + ["null"], "two missions"
    golden, *_, null = (run.record for run in runs)
    effects = [effect_of(golden, run.record).label for run in runs]
    assert set(effects) <= {"masked", "sdc", "crash", "hang", "unknown"}
    assert effects[0] == effects[1] == effects[-1] == "masked" and null.injections[0].activated
    assert effects.count("unknown") <= 1


def node(campaign, **changes):
    return campaign.under_test.model_copy(update={"patience_s": 1.0, "cycles": 1, **changes})


def fault(**changes):
    plain = {"registers": "general", "access": "read", "symbol": "4TimeERSB_", "walk": 1, "timeout": 10.0}
    return RegisterFault(**{**plain, **changes})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "effect", "reason"),
    [
        ({"seed": 0}, "masked", ""),  # rbp, which the function does not use before it loads it
        ({"seed": 3}, "crash", "SIGSEGV"),  # rsp, before a push
        ({"seed": 0, "registers": "fp", "access": "write", "walk": 900}, "sdc", ""),  # a product in KDL::Rotation::Rot2
        ({"symbol": "KDL4Tree10addSegment", "timeout": 1.0}, "unknown", "did not call"),
    ],
)
def test_masked_corrupted_crashed_and_never_injected_are_distinguished(ros, campaign, changes, effect, reason):
    for _ in range(12 if effect == "sdc" else 1):  # the instant is the machine's, and half of the products are with 0
        found = run_trial(node(campaign), fault=fault(**changes))
        if found.effect == effect:
            break
    assert found.effect == effect and reason in found.reason
    assert (found.injection is None) == (effect == "unknown")
    assert bool(found.differing) == bool(found.differences) == (effect == "sdc")
