import json
from collections import Counter

import pytest

from mavfi.campaign.plan import RunSpec, arms_of, count_runs, plan_golden, plan_injected
from tests.unit.campaign.fakes import golden_profile, small

KEYS = {"sparse": "key of sparse", "dense": "key of dense"}


def planned(campaign):
    arms = arms_of(campaign, {"gaussian": "abc"})
    profiles = {(env, seed): golden_profile(seed) for env in campaign.environments for seed in campaign.seeds}
    return plan_golden(campaign, KEYS, arms), plan_injected(campaign, KEYS, arms, profiles)


def test_numbers_of_runs():
    campaign = small(null_runs=2)
    golden, injected = planned(campaign)
    settings = Counter((run.environment, run.setting) for run in [*golden, *injected])
    expected = {"golden": 4, "golden_gaussian": 4, "fi": 18, "dr_gaussian": 18, "null": 1, "null_gaussian": 1}
    assert settings == {(env, setting): n for env in KEYS for setting, n in expected.items()}
    assert count_runs(campaign) == len(golden) + len(injected)


def test_settings_of_a_pair_share_world_and_fault():
    _, injected = planned(small())
    faulty, recovered = (
        {(r.environment, r.target, r.index): r for r in injected if r.setting == setting}
        for setting in ("fi", "dr_gaussian")
    )
    assert faulty.keys() == recovered.keys()
    for key, run in faulty.items():
        assert (run.seed, run.fault) == (recovered[key].seed, recovered[key].fault)
        assert (recovered[key].detector, recovered[key].model) == ("fake", "abc")
        assert (run.golden_setting, recovered[key].golden_setting) == ("golden", "golden_gaussian")


def test_faults_are_spread_over_the_missions_and_differ_within_one():
    _, injected = planned(small())
    own = [run for run in injected if (run.setting, run.environment, run.target) == ("fi", "sparse", "planning")]
    assert [run.seed for run in own] == [10_000, 10_001, 10_002, 10_003, 10_000, 10_001]
    assert own[0].fault != own[4].fault


def test_environments_that_share_seeds_do_not_share_faults():
    """Seeds and profiles are the same here, so only the name of the environment tells the draws apart."""
    _, injected = planned(small(faults=40, flights=10))
    drawn = {
        environment: {
            (run.target, run.index): (run.fault.site, run.fault.time_us, run.fault.bit)
            for run in injected
            if (run.setting, run.environment) == ("fi", environment)
        }
        for environment in KEYS
    }
    same = sum(drawn["sparse"][key] == drawn["dense"][key] for key in drawn["sparse"])
    assert same < 0.05 * len(drawn["sparse"])


def test_strata_have_their_shares_in_every_stage_and_environment():
    _, injected = planned(small())
    for environment in KEYS:
        for stage in ("perception", "planning", "control"):
            own = [r for r in injected if (r.setting, r.environment, r.target) == ("fi", environment, stage)]
            assert Counter(run.fault.stratum for run in own) == {"sign_exponent": 4, "mantissa": 2}
            assert {run.fault.stage for run in own} == {stage}


def test_null_runs_have_an_empty_mask_and_take_the_arms_in_turn():
    _, injected = planned(small(null_runs=3))
    null = [run for run in injected if run.target == "null" and run.environment == "dense"]
    assert [run.setting for run in null] == ["null", "null_gaussian", "null"]
    assert all(run.fault.bit is None for run in null)


def test_run_ids_are_unique_readable_and_depend_on_everything():
    golden, injected = planned(small())
    ids = [run.run_id for run in [*golden, *injected]]
    assert len(set(ids)) == len(ids)
    assert ids[0].startswith("sparse-10000-golden-")
    run = injected[0]
    assert run.run_id.startswith(f"sparse-10000-fi-{run.target}-0-")
    data = run.to_json()
    for key, value in {"model": "other", "scenario": "other", "profile": "tuned"}.items():
        assert RunSpec.from_json({**data, key: value}).run_id != run.run_id


def test_specs_survive_json():
    for run in planned(small())[1][:40]:
        again = RunSpec.from_json(json.loads(json.dumps(run.to_json())))
        assert again == run
        assert again.run_id == run.run_id


def test_the_plan_is_the_same_every_time():
    assert planned(small()) == planned(small())


def test_adding_a_group_leaves_the_faults_of_the_others():
    groups = [{"name": name, "sites": [f"planning.waypoint.{name}"]} for name in ("x", "y", "z")]
    _, few = planned(small(law="groups", groups=groups[:2]))
    _, many = planned(small(law="groups", groups=groups))
    assert {run.run_id for run in few} < {run.run_id for run in many}
    assert {str(run.fault.site) for run in few if run.target == "y"} == {"planning.waypoint.y"}


@pytest.mark.parametrize("sites", ["all", "monitored"])
def test_monitored_sites_only(sites):
    _, injected = planned(small(sites=sites, faults=20))
    states = {run.fault.site.state for run in injected if run.setting == "fi"}
    assert ("planning.trajectory" in states) == (sites == "all")
