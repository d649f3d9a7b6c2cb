import json
from dataclasses import replace
from types import MappingProxyType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.campaign.plan import Plan, RunSpec, Shard
from mavfi.campaign.resolve import resolve
from mavfi.extras.registers.fault import RegisterFault
from mavfi.faults.fault import FaultSite
from mavfi.flight.host import Flight
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.levels.level import NULL, Sampled
from mavfi.levels.message.fault import MessageFault
from mavfi.levels.state.fault import StateFault
from mavfi.record import Profile
from mavfi.states import STATES
from tests.core.unit.campaign.fakes import DETECTOR, golden_profile, small

KEYS = MappingProxyType({"sparse": "key of sparse", "dense": "key of dense"})
FAULTS = (
    None,
    StateFault(FaultSite("planning.path", "x", 2), 4_000_000, 62, "sign_exponent", 0.25, 7),
    StateFault(FaultSite("planning.waypoint", "x")),
    InstructionFault("m.f", "ab" * 32, 5, 3, (7,), kernel="pid", entry="track", stratum="mantissa", weight=2.0),
    InstructionFault("m.f", "ab" * 32, 5, value=1 << 90, model="random"),
    MessageFault("/joint_states", "position[0]", rate=0.5, seed=3),
    RegisterFault("fp", "read", symbol="f", node="pid", time_us=5),
)


def plan_for(campaign) -> Plan:
    arms = resolve(campaign).arms
    scenarios = {(name, arm.name): f"{KEYS[name]} {arm.name}" for name in campaign.environments for arm in arms}
    return Plan(resolve(campaign, models={"gaussian": "abc"}, scenario_keys=scenarios))


def golden_of(seed):
    return {"": Sampled(Flight(None, golden_profile(seed)))}


def planned(campaign, lost=()):
    """All runs of a campaign as its missions plan them, golden runs first; nothing is drawn in lost missions."""
    plan = plan_for(campaign)
    golden, injected = [], []
    for environment in campaign.environments:
        for seed in campaign.seeds:
            golden += plan.golden(environment, seed)
            if seed not in lost:
                injected += mission_runs(plan, environment, seed, golden_of(seed))
    return golden, injected


def mission_runs(plan, environment, seed, golden):
    places = list(plan.positioned_draws(environment, seed))
    draws = [draw for _, draw in places if draw.target != NULL]
    drawn = iter(plan.campaign.sampler.draw(draws, environment, golden))
    planned_runs = []
    for position, draw in places:
        null = draw.target == NULL
        fault = plan.campaign.sampler.null(draw.index, draw.seed, environment, golden) if null else next(drawn)
        planned_runs += plan.injected(environment, draw, position, fault)
    return planned_runs


campaigns = st.builds(
    lambda missions, faults, nulls, environments, arms: small(
        missions=missions,
        faults=faults,
        null_runs=nulls,
        environments=environments,
        arms={name: arm for name, arm in arms.items()},
    ),
    st.integers(1, 5),
    st.integers(1, 7),
    st.integers(0, 5),
    st.sampled_from([["sparse"], ["sparse", "dense"]]),
    st.dictionaries(
        st.sampled_from(["a", "b", "c"]),
        st.sampled_from([{"detector": DETECTOR}, {"planner": "rrt"}, {"wind": 2.0, "detector": DETECTOR}]),
    ),
)


@given(campaigns)
def test_places_in_the_ledger_are_unique_and_without_a_gap(campaign):
    golden, injected = planned(campaign)
    assert [run.position for run in golden] == list(range(len(golden)))
    assert sorted(run.position for run in injected) == list(range(len(golden), len(golden) + len(injected)))
    assert plan_for(campaign).count() == len(golden) + len(injected)
    assert len({run.run_id for run in [*golden, *injected]}) == plan_for(campaign).count()


@given(campaigns, st.data())
def test_runs_are_those_of_their_mission_whatever_becomes_of_others(campaign, data):
    lost = data.draw(st.sets(st.sampled_from(list(campaign.seeds))))
    _, injected = planned(campaign)
    _, some = planned(campaign, lost)
    assert some == [run for run in injected if run.seed not in lost]
    assert [run.position for run in some] == [run.position for run in injected if run.seed not in lost]


@given(campaigns)
def test_every_arm_flies_every_fault_in_the_same_world(campaign):
    _, injected = planned(campaign)
    pairs = {}
    for run in injected:
        if run.kind == "injected":
            pairs.setdefault((run.world, run.target, run.index), {})[run.arm] = run.fault
    assert len(pairs) == 3 * campaign.faults * len(campaign.environments)
    for faults_of_pair in pairs.values():
        assert set(faults_of_pair) == {"", *campaign.arms}
        assert len(set(faults_of_pair.values())) == 1


@given(campaigns)
def test_draws_do_not_depend_on_arms_and_null_runs(campaign):
    alone = campaign.model_copy(update={"arms": {}, "null_runs": 0})

    def drawn(c):
        return [(run.world, run.target, run.index, run.fault) for run in planned(c)[1] if run.setting == "fi"]

    assert drawn(campaign) == drawn(alone)


def test_faults_are_spread_over_the_missions_and_differ_within_one():
    _, injected = planned(small())
    spread_runs = [
        run for run in injected if (run.setting, run.environment, run.target) == ("fi", "sparse", "planning")
    ]
    spread_runs.sort(key=lambda run: run.index)
    assert [run.seed for run in spread_runs] == [10_000, 10_001, 10_002, 10_003, 10_000, 10_001]
    assert spread_runs[0].fault != spread_runs[4].fault


def test_environments_that_share_seeds_do_not_share_faults():
    """Seeds and profiles are the same here, so only the name of the environment tells the draws apart."""
    _, injected = planned(small(faults=40, missions=10))
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


def test_null_runs_have_an_empty_mask_and_take_arms_and_stages_in_turn():
    _, injected = planned(small(null_runs=3))
    null = [run for run in injected if run.kind == "null" and run.environment == "dense"]
    null.sort(key=lambda run: run.index)
    assert [run.setting for run in null] == ["null", "null_gaussian", "null"]
    assert [STATES[run.fault.where.state].stage for run in null] == ["perception", "planning", "control"]
    assert all((run.target, run.fault.bit, run.fault.stratum) == (NULL, None, "") for run in null)


def test_run_ids_are_readable_and_depend_on_all_that_decides_a_run():
    golden, injected = planned(small())
    assert golden[0].run_id.startswith("sparse-10000-golden-")
    run = injected[0]
    assert run.run_id.startswith(f"sparse-10000-fi-{run.target}-0-")
    changes = {
        "environment": "farm",
        "seed": 3,
        "scenario": "other",
        "detector": "other",
        "detector_profile": "tuned",
        "model": "other",
        "index": 99,
        "fault": None,
        "arm": "other",
        "target": "other",
        "setting": "other",
    }
    ids = {replace(run, **{key: value}).run_id for key, value in changes.items()} | {run.run_id}
    assert len(ids) == len(changes) + 1
    assert replace(run, position=7).run_id == run.run_id, "its place does not decide a run"


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault and fault.level)
def test_specs_survive_json_with_faults_of_every_level(fault):
    run = RunSpec("injected", "dr_g", "sparse", 10_000, "key", "g", "d", "paper", "sha", "pid", 3, fault, 17)
    again = RunSpec.from_json(json.loads(json.dumps(run.to_json())))
    assert again == run
    assert (again.run_id, again.position, again.fault) == (run.run_id, 17, fault)


def test_missions_whose_golden_runs_left_nothing_have_faults_without_a_site():
    campaign = small(environments=["sparse"], arms={})
    plan = plan_for(campaign)
    for golden in ({}, {"": Sampled(Flight(None))}, {"": Sampled(Flight(None, Profile()))}):
        runs = mission_runs(plan, "sparse", 10_001, golden)
        assert len(runs) == 7 and not any(run.fault.has_site for run in runs)
    sites = [run.fault.site for run in mission_runs(plan, "sparse", 10_001, golden_of(10_001))]
    assert [run.fault.site.split("[")[0] for run in runs] == [site.split("[")[0] for site in sites]


def test_adding_a_group_leaves_the_faults_of_the_others():
    groups = [{"name": name, "sites": [f"planning.waypoint.{name}"]} for name in ("x", "y", "z")]
    _, few = planned(small(sampling={"scheme": "groups", "groups": groups[:2]}))
    _, many = planned(small(sampling={"scheme": "groups", "groups": groups}))
    assert {run.run_id for run in few} < {run.run_id for run in many}
    assert {run.fault.site for run in few if run.target == "y"} == {"planning.waypoint.y"}


@given(missions=st.integers(1, 9), faults=st.integers(1, 20), nulls=st.integers(0, 7), shards=st.integers(1, 12))
def test_shards_share_the_runs(missions, faults, nulls, shards):
    campaign = small(missions=missions, faults=faults, null_runs=nulls)
    plan = plan_for(campaign)
    worlds = [(environment, seed) for environment in campaign.environments for seed in campaign.seeds]
    for number in range(1, shards + 1):
        shard, worlds_of_shard = Shard(number, shards), worlds[number - 1 :: shards]
        assert list(shard.worlds(campaign)) == worlds_of_shard and shard.missions(campaign) == len(worlds_of_shard)
        runs = [
            run
            for world in worlds_of_shard
            for run in [*plan.golden(*world), *mission_runs(plan, *world, golden_of(1))]
        ]
        assert plan.count(shard) == len(runs)
    assert sum(plan.count(Shard(number, shards)) for number in range(1, shards + 1)) == plan.count()


def test_the_model_of_an_arm_may_depend_on_the_part():
    campaign = resolve(small(), models={"sparse/gaussian": "of sparse", "other": "of all"})
    assert campaign.model("sparse", "gaussian") == "of sparse"
    assert campaign.model("dense", "other") == "of all" and campaign.model("dense", "gaussian") == ""
