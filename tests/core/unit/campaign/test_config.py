import json

import pytest
import yaml

from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.plan import Plan
from mavfi.campaign.resolve import resolve
from mavfi.config import config_root, parse
from mavfi.errors import BadInputError
from mavfi.mission import MissionSpec
from mavfi.states import KERNEL_STAGES, PPC_STAGES
from tests.core.unit.campaign.fakes import small
from tests.core.unit.cli.test_options import VALUES

BASE = {"name": "c", "environments": ["sparse"]}
GROUP = {"name": "g", "sites": ["planning.waypoint.x"]}
GAUSSIAN = {"gaussian": {"detector": "gaussian"}}
NO_FOLDERS = ("../../x", "", "x\n")
SHIPPED = sorted(path.stem for path in (config_root() / "campaigns").glob("*.yaml"))


def groups(*members, **changes):
    return {"sampling": {"scheme": "groups", "groups": list(members), **changes}}


def instructions(*kernels, **changes):
    return {"sampling": {"level": "instruction", "kernels": list(kernels), **changes}}


def count(campaign) -> int:
    return Plan(resolve(campaign)).count()


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_campaigns_are_valid_and_survive_the_ledger(name):
    campaign = load_campaign(name)
    assert campaign.name == name
    assert campaign.on_design_seeds == (name == "fault_map")
    again = Campaign.model_validate(campaign.to_json())
    assert again == campaign
    assert count(campaign) > 0


def test_table1_has_the_size_of_the_paper():
    quick = load_campaign("table1")
    assert count(quick) - 4 * quick.nulls == 4 * (3 * 30 + 3 * 90) == 1440
    large = quick.at_scale("paper")
    assert (large.missions, large.faults) == (100, 100)
    assert quick.at_scale("quick") == quick
    assert large != quick


def test_the_instruction_level_has_the_size_of_the_papers_table():
    quick, paper = (load_campaign("table1_instructions").at_scale(scale) for scale in ("quick", "paper"))
    assert count(paper) == 4 * (3 * 100 + 3 * 300), "golden with and without each detector, and three settings"
    assert {KERNEL_STAGES[name] for name in quick.sampling.kernels} == set(PPC_STAGES)
    assert quick.environments == load_campaign("table1").environments
    assert quick.arms == load_campaign("table1").arms
    assert quick.nulls == 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        *(({"name": name}, f"key 'name': {name!r}: allowed: a plain folder name") for name in NO_FOLDERS),
        ({"enviroments": []}, "unknown key 'enviroments' (did you mean 'environments'?); allowed: name, host"),
        ({"environments": ["sparse", "sparse"]}, "campaign.yaml: environments: 'sparse': named 2 times; allowed: once"),
        ({"first_seed": 999_990}, "seeds from 1000000 on are for training"),
        ({"monitored_set": "all"}, "monitored_set: 'all': not known; allowed: paper-13"),
        # sampling: states
        (
            {"sampling": {"scheme": "groups"}},
            "campaign.yaml: sampling.groups: is required with scheme 'groups'; allowed",
        ),
        ({"sampling": {"groups": [GROUP]}}, "sampling.scheme: 'stage_balanced': allowed with the key groups: groups"),
        (groups(GROUP, GROUP), "groups: 'g': named 2 times; allowed: once"),
        (
            groups(GROUP, {"name": "h", "sites": ["planning.waypont.x"]}),
            "sampling.groups.1.sites: state 'planning.waypont': not known (did you mean 'planning.waypoint'?)",
        ),
        (groups({"name": "g", "sites": ["perception.odometry.x"]}), "only flights with localization estimator"),
        (groups({**GROUP, "strata": {"high": 1}}), "strata: 'high': not known; allowed: sign_exponent"),
        ({"sampling": {"strata": {"mantissa": 0}}}, "shares above 0"),
        (
            groups({"name": "flag", "sites": ["perception.collision_status.collision"]}),
            "flag: no field has bits of the stratum 'mantissa'",
        ),
        # sampling: instructions and registers
        (
            {**instructions("pid", "rrt"), "arms": GAUSSIAN},
            "kernels: 'rrt': detectors are trained with one planner; allowed with arms: kernels of missions with "
            "planner 'rrt_connect'",
        ),
        (
            {**instructions("rrt_connect"), "arms": {"x": {"planner": "rrt_star"}}},
            "arms: 'x': planner: 'rrt_star': does not call what faults in rrt_connect are drawn from",
        ),
        (
            {**instructions("pid", "octomap"), "arms": {"x": {"map": "octree"}}},
            "arms: 'x': map: 'octree': does not call what faults in octomap are drawn from; allowed: 'dense'",
        ),
        ({**instructions("pid"), "null_runs": 3}, "null_runs: 3; allowed: 0 with faults in instructions"),
        # missions and arms
        ({"mission": {"seed": 3}}, "mission.seed: belongs to the campaign (environments, first_seed)"),
        ({"arms": {"x": {"environment": "dense"}}}, "arms.environment: belongs to the campaign"),
        ({"arms": {"x": {"planer": "rrt"}}}, "unknown key 'arms.x.planer' (did you mean 'planner'?)"),
        ({"arms": {"rrt": {}}}, "arms: 'rrt': is the name of a planner"),
        *(
            ({"arms": {name: {}}}, f"arms: {name!r}: allowed: any name but golden, fi, dr, null")
            for name in ("golden", "a/b")
        ),
        # hosts
        ({"stack": {"nodes": [["x"]]}}, "the key stack goes with host ros2_stack"),
    ],
)
def test_mistakes_are_named_when_the_file_is_read(changes, message):
    with pytest.raises(BadInputError, match="campaign.yaml: .*") as caught:
        parse(Campaign, {**BASE, **changes}, "campaign.yaml")
    assert message in str(caught.value)
    shown = str(caught.value).replace("{'mantissa'", "").replace("strata: {}", "")
    assert "{" not in shown, "nobody wants to see the whole file again"
    assert "Value error" not in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value", "right_part"), [("strata", {"mantissa": 1}, "sampling"), ("v_max", 3.0, "mission")]
)
def test_a_key_in_the_wrong_part_of_the_file_is_refused_with_the_right_one(key, value, right_part):
    with pytest.raises(BadInputError, match=f"^campaign.yaml: key '{key}': allowed as {right_part}.{key}$"):
        parse(Campaign, {**BASE, key: value}, "campaign.yaml")


def test_unknown_names_say_what_is_known():
    with pytest.raises(BadInputError, match="did you mean 'table1'.*allowed: table1, .* more, or a path"):
        load_campaign("table2")
    with pytest.raises(BadInputError, match="allowed: quick, paper"):
        load_campaign("table1").at_scale("huge")


def test_a_campaign_is_read_from_a_file_of_the_users_own(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        yaml.safe_dump({**BASE, "mission": {"autopilot": "hardened"}, "arms": {"x": {"autopilot": "published"}}})
    )
    campaign = load_campaign(path)
    assert campaign.mission == {"autopilot": "hardened"}
    assert campaign.arms["x"].mission == {"autopilot": "published"}
    with pytest.raises(BadInputError, match="absent.yaml: cannot be read"):
        load_campaign(tmp_path / "absent.yaml")


def test_every_key_of_a_mission_is_one_of_campaigns_and_arms():
    values = {key: value for key, value in VALUES.items() if key not in ("environment", "seed")}
    assert set(values) == set(MissionSpec.model_fields) - {"environment", "seed"}
    for key, value in values.items():
        campaign = small(mission={key: value}, arms={"x": {key: value}})
        again = Campaign.model_validate(campaign.to_json())
        for held in (campaign, again):
            assert getattr(held.spec("sparse", 1), key) == value
            assert getattr(held.spec("sparse", 1, held.arms["x"].mission), key) == value


def test_null_runs_are_for_levels_that_have_them():
    assert small().nulls == 3
    assert small(null_runs=0).nulls == 0
    assert small(**instructions("pid")).nulls == 0


def test_the_plain_data_of_a_campaign_depend_on_what_is_flown():
    changes = [{}, {"faults": 7}, {"mission": {"wind": 1}}, {"arms": {}}, groups(GROUP), {"first_seed": 5}]
    assert len({json.dumps(small(**change).to_json()) for change in changes}) == len(changes)
    stored = {**BASE, "mission": {"stack": "hardened"}, "arms": {"x": {"mission": {"stack": "published"}}}}
    newer = {**BASE, "mission": {"autopilot": "hardened"}, "arms": {"x": {"mission": {"autopilot": "published"}}}}
    assert parse(Campaign, stored, "ledger", stored=True).to_json() == parse(Campaign, newer, "file").to_json()
    assert [arm.name for arm in resolve(small()).arms] == ["", "gaussian"]


# ---- parts -------------------------------------------------------------------------------------------------------
PARTS = {
    "fast": {"environment": "dense", "platform": "i9-9940x"},
    "slow": {"environment": "dense", "platform": "cortex-a57"},
}


def test_parts_are_environments_with_keys_of_their_own():
    campaign = small(environments=["fast", "slow", "sparse"], parts=PARTS)
    specs = [campaign.spec(name, 10_000) for name in campaign.environments]
    assert [(spec.environment, spec.platform) for spec in specs] == [
        ("dense", "i9-9940x"),
        ("dense", "cortex-a57"),
        ("sparse", "i9-9940x"),
    ]
    assert Campaign.model_validate(campaign.to_json()) == campaign
    assert "parts" not in small().to_json(), "campaigns without parts keep their identity"


def test_a_part_that_is_not_flown_is_refused():
    with pytest.raises(ValueError, match="parts: 'slow': not known; allowed: fast"):
        small(environments=["fast"], parts=PARTS)
