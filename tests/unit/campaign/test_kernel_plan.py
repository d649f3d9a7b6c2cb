"""The law `kernels`: who gets how many faults, and which runs they make."""

from collections import Counter

import pytest

from mavfi.campaign.config import Campaign
from mavfi.campaign.kernel_plan import DRAWN, kernels_of, plan_kernel_world, strikes
from mavfi.campaign.plan import arms_of, count_runs, plan_golden
from mavfi.faults.fault import Fault, FaultSite

PERCEPTION = ("point_cloud", "octomap", "collision_check")


def campaign(share="stage", **changes):
    return Campaign.model_validate({
        "name": "c", "environments": ["sparse", "dense"], "flights": 3, "faults": 9, "null_runs": 0, "law": "kernels",
        "kernels": {"names": [*PERCEPTION, "pid"], "share": share}, "detectors": {"idle": {"detector": "none"}},
        **changes,
    })  # fmt: skip


def drawn(number, kernel):
    fault = Fault("instruction", FaultSite(kernel, "f"), bit=number, instruction={"call": number})
    return fault.to_json()


def planned(c):
    """All runs of both phases, from golden records as the host would leave them."""
    keys = {environment: environment for environment in c.environments}
    arms = arms_of(c, {})
    golden = plan_golden(c, keys, arms)
    runs = {}
    for spec in golden:
        if spec.detector:
            assert kernels_of(spec, c) == {}, "only flights without a detector draw"
            continue
        record = {DRAWN: {k: [drawn(i, k) for i in range(n)] for k, n in kernels_of(spec, c).items()}}
        world = plan_kernel_world(c, keys, arms, (spec.environment, spec.seed), [record])
        assert not world.keys() & runs.keys()
        runs.update(world)
    return golden, [runs[place] for place in sorted(runs)]


@pytest.mark.parametrize("share", ["stage", "kernel"])
def test_every_place_is_taken_and_every_arm_flies_every_fault(share):
    c = campaign(share)
    golden, runs = planned(c)
    assert len(golden) + len(runs) == count_runs(c)
    faults = {}
    for run in runs:
        faults.setdefault((run.environment, run.target, run.index, run.seed), {})[run.setting] = run.fault
    assert all(own.keys() == {"fi", "dr_idle"} and own["fi"] == own["dr_idle"] for own in faults.values())
    assert all(seed == c.first_seed + index % c.flights for _, _, index, seed in faults)


def test_kernels_of_a_stage_share_its_faults_equally_and_are_not_tied_to_missions():
    c = campaign()
    for environment in c.environments:
        order = strikes(c, environment)
        assert Counter(kernel for kernel, _ in order) == {**dict.fromkeys(PERCEPTION, 3), "pid": 9}
        assert [index for _, index in order] == [*range(9), *range(9)]
    kernels = {k: {i % c.flights for name, i in strikes(c, "sparse") if name == k} for k in PERCEPTION}
    assert any(len(missions) > 1 for missions in kernels.values())
    assert strikes(c, "sparse") != strikes(c, "dense")


def test_each_kernel_has_its_own_number_where_kernels_are_compared():
    order = strikes(campaign("kernel"), "sparse")
    assert Counter(kernel for kernel, _ in order) == dict.fromkeys((*PERCEPTION, "pid"), 9)


def test_a_golden_run_that_ended_badly_gives_no_faults():
    c = campaign()
    keys = {environment: environment for environment in c.environments}
    assert plan_kernel_world(c, keys, arms_of(c, {}), ("sparse", c.first_seed), [{"end": "unknown"}]) == {}
