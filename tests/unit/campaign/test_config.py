import pytest

from mavfi.campaign.config import KERNELS, Campaign, load_campaign
from mavfi.campaign.plan import count_runs
from mavfi.config import parse
from mavfi.errors import BadInputError
from mavfi.pipeline.functions import STRUCK
from mavfi.states import KERNEL_STAGES, PPC_STAGES

BASE = {"name": "c", "environments": ["sparse"]}
GROUP = {"name": "g", "sites": ["planning.waypoint.x"]}


@pytest.mark.parametrize("name", ["table1", "states", "bits", "smoke", "kernels", "table1_instructions"])
def test_shipped_campaigns_are_valid_and_fly_evaluation_seeds(name):
    campaign = load_campaign(name)
    assert campaign.name == name
    assert not campaign.on_design_seeds


def test_table1_has_the_size_of_the_paper():
    quick = load_campaign("table1")
    assert count_runs(quick) - 4 * quick.null_runs == 4 * (3 * 30 + 3 * 90) == 1440
    large = quick.at_scale("paper")
    assert (large.flights, large.faults) == (100, 100)
    assert quick.at_scale("quick") == quick
    assert large.key() != quick.key()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"colour": "red"}, "unknown key 'colour'; allowed: name"),
        ({"environments": []}, "key 'environments'"),
        ({"law": "groups"}, "groups are given where, and only where"),
        ({"groups": [GROUP]}, "groups are given where, and only where"),
        ({"law": "groups", "groups": [GROUP, GROUP]}, "groups: 'g': named 2 times; allowed: once"),
        ({"environments": ["sparse", "sparse"]}, "campaign.yaml: environments: 'sparse': named 2 times; allowed: once"),
        ({"law": "groups", "groups": [{"name": "g", "sites": ["planning.waypoint.roll"]}]}, "no field 'roll'"),
        (
            {"law": "groups", "groups": [{**GROUP, "strata": {"high": 1}}]},
            "strata: 'high': not known; allowed: sign_exponent",
        ),
        ({"strata": {"mantissa": 0}}, "shares above 0"),
        ({"monitored_set": "all"}, "monitored_set: 'all': not known; allowed: paper-13"),
        ({"law": "kernels"}, "kernels are given where, and only where, law is 'kernels'"),
        ({"kernels": {"names": ["pid"]}}, "kernels are given where, and only where, law is 'kernels'"),
        ({"law": "kernels", "kernels": {"names": ["lidar"]}}, "kernels: 'lidar': not known; allowed: point_cloud"),
        ({"law": "kernels", "kernels": {"names": ["pid", "pid"]}}, "kernels: 'pid': named 2 times; allowed: once"),
        (
            {
                "law": "kernels",
                "null_runs": 0,
                "kernels": {"names": ["pid", "rrt"]},
                "detectors": {"gaussian": {"detector": "gaussian"}},
            },
            "kernels: 'rrt': detectors are trained with one planner; allowed with detectors: kernels of missions with "
            "planner 'rrt_connect'",
        ),
        ({"law": "kernels", "kernels": {"names": ["pid"]}}, "null_runs: 3; allowed: 0 where law is 'kernels'"),
        ({"first_seed": 999_990}, "seeds from 1000000 on are for training"),
        (
            {
                "law": "groups",
                "groups": [{"name": "flag", "sites": ["perception.collision_status.collision"]}],
            },
            "flag: no field has bits of the stratum 'mantissa'",
        ),
    ],
)
def test_mistakes_are_named_when_the_file_is_read(changes, message):
    with pytest.raises(BadInputError, match="campaign.yaml: .*") as caught:
        parse(Campaign, {**BASE, **changes}, "campaign.yaml")
    assert message in str(caught.value)
    assert "{" not in str(caught.value).replace("{'mantissa'", ""), "nobody wants to see the whole file again"
    assert "Value error" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_names_tell_what_is_known():
    with pytest.raises(BadInputError, match="allowed: .*bits.*smoke.*states.*table1"):
        load_campaign("table2")
    with pytest.raises(BadInputError, match="allowed: quick, paper"):
        load_campaign("table1").at_scale("huge")


def test_the_kernels_campaign_has_the_size_of_the_papers_study():
    campaign = load_campaign("kernels").at_scale("paper")
    assert count_runs(campaign) == 7 * 100 + 3 * 100, "100 per kernel, and a golden flight for each planner"
    assert set(campaign.kernels.names) == set(STRUCK) == set(KERNELS)


def test_the_instruction_level_has_the_size_of_the_papers_table():
    quick, paper = (load_campaign("table1_instructions").at_scale(scale) for scale in ("quick", "paper"))
    assert count_runs(paper) == 4 * (3 * 100 + 3 * 300), "golden with and without each detector, and three settings"
    assert {stage for name in quick.kernels.names for stage in [KERNEL_STAGES[name]]} == set(PPC_STAGES)
    assert quick.environments == load_campaign("table1").environments
    assert quick.detectors == load_campaign("table1").detectors


def test_campaigns_without_kernels_keep_their_keys():
    assert "kernels" not in load_campaign("table1").to_json()
