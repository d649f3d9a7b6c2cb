"""Faults in instructions: who gets how many, and which runs they make."""

from collections import Counter
from types import SimpleNamespace

import pytest

from mavfi.campaign.mission import MissionPlan, fly_mission
from mavfi.campaign.plan import Plan
from mavfi.campaign.resolve import resolve
from mavfi.detectors.registry import Loaded
from mavfi.faults.fault import NO_SITE
from mavfi.flight.host import ArmSetup
from mavfi.flight.targets import InjectionTarget
from mavfi.levels.instruction import drawing
from mavfi.levels.instruction import sampling as instruction_sampling
from mavfi.levels.instruction.drawing import DrawnFaults, InstructionRequest
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.levels.instruction.sampling import InstructionSampling
from mavfi.levels.level import draws_of
from tests.core.unit.campaign import fakes
from tests.core.unit.campaign.fakes import DETECTOR, small

PERCEPTION = ("point_cloud", "octomap", "collision_check")
PLANNERS = ("rrt", "rrt_connect", "rrt_star")


def campaign(share="stage", kernels=(*PERCEPTION, "pid"), **changes):
    sampling = {"level": "instruction", "kernels": kernels, "share": share, **changes.pop("sampling", {})}
    return small(**{"missions": 3, "faults": 9, "sampling": sampling, **changes})


@pytest.fixture(autouse=True)
def requests(monkeypatch):
    """What was asked to be drawn; the faults are numbered, and those of `octomap` beyond the first have no site."""
    asked_for = []

    def draw(scenario, request, *address, seed, detector=None, recovery=None, flights=None, arm=""):
        asked_for.append((scenario.environment.name, seed, scenario.planner.name, address, request))
        faults = {
            kernel: [
                InstructionFault(
                    "f",
                    f"{kernel} {seed} {address}",
                    number,
                    kernel=kernel,
                    entry="f",
                    bits=(3,),
                    call=NO_SITE if kernel == "octomap" and number else number,
                )
                for number in range(count)
            ]
            for kernel, count in request.kernels.items()
        }
        golden = fakes.fly(ArmSetup(scenario), None, None)
        return DrawnFaults(golden, {kernel: {"instructions": 7, "calls": 1, "lines": []} for kernel in faults}, faults)

    monkeypatch.setattr(instruction_sampling, "draw_instruction_faults", draw)
    return asked_for


def flown(c):
    """All runs with a fault, and all records of golden runs, mission by mission."""
    specs, golden = [], {}
    for environment in c.environments:
        for seed in c.seeds:
            planned, *rest = fly_mission(MissionPlan(resolve(c), environment, seed))
            ids = {spec.run_id: spec for spec in planned.specs}
            for item in rest:
                if hasattr(item, "specs"):
                    specs += item.specs
                elif item.run_id in ids:
                    golden[ids[item.run_id]] = item.record
    return specs, golden


def draws_in(campaign, environment):
    """All faults, in the order of the plan."""
    blocks = resolve(campaign).sampler.blocks(environment)
    return [draw for _, draw in draws_of(blocks, range(campaign.missions))]


@pytest.mark.parametrize("share", ["stage", "kernel"])
def test_every_place_is_taken_and_every_arm_flies_every_fault(share):
    c = campaign(share)
    runs, golden = flown(c)
    assert Plan(resolve(c)).count() == len(golden) + len(runs)
    assert sorted(run.position for run in [*golden, *runs]) == list(range(len(golden) + len(runs)))
    faults = {}
    for run in runs:
        faults.setdefault((run.environment, run.target, run.index, run.seed), {})[run.setting] = run.fault
    assert all(
        faults_of_arm.keys() == {"fi", "dr_gaussian"} and faults_of_arm["fi"] == faults_of_arm["dr_gaussian"]
        for faults_of_arm in faults.values()
    )
    assert all(seed == c.first_seed + index % c.missions for _, _, index, seed in faults)
    assert all(target == fault["fi"].kernel for (_, target, _, _), fault in faults.items())
    assert len({run.fault for run in runs}) == len(runs) / 2, "no fault is injected twice"


def test_kernels_of_a_stage_share_its_faults_equally_and_are_not_tied_to_missions():
    c = campaign()
    draws = {environment: draws_in(c, environment) for environment in c.environments}
    for order in draws.values():
        assert Counter(draw.target for draw in order) == {**dict.fromkeys(PERCEPTION, 3), "pid": 9}
        assert [draw.index for draw in order] == [*range(9), *range(9)]
    missions = {name: {draw.seed for draw in draws["sparse"] if draw.target == name} for name in PERCEPTION}
    assert any(len(faults_of_arm) > 1 for faults_of_arm in missions.values())
    assert draws["sparse"] != draws["dense"]


def test_planners_that_are_not_flown_have_missions_of_their_own(requests):
    c = campaign("kernel", kernels=[*PLANNERS, "pid"], arms={}, environments=["sparse"], faults=3)
    runs, golden = flown(c)
    assert [arm.name for arm in resolve(c).arms] == ["", "rrt", "rrt_star"]
    assert {(run.arm, run.target) for run in runs} == {
        ("", "rrt_connect"),
        ("", "pid"),
        ("rrt", "rrt"),
        ("rrt_star", "rrt_star"),
    }
    assert {run.setting for run in runs} == {"fi"}
    assert Counter(run.setting for run in golden) == {"golden": 3, "golden_rrt": 3, "golden_rrt_star": 3}
    assert {(planner, tuple(request.kernels)) for _, _, planner, _, request in requests} == {
        ("rrt_connect", ("rrt_connect", "pid")),
        ("rrt", ("rrt",)),
        ("rrt_star", ("rrt_star",)),
    }


# ---- faults in detectors -----------------------------------------------------------------------------------------
def with_detectors(monkeypatch, **changes):
    """Arms whose detector can be injected; the detector itself is made up."""
    monkeypatch.setattr("mavfi.flight.compose.detector_for", lambda *_: Loaded(fakes.FakeDetector(), ""))
    arms = {"watched": {"detector": "gaussian"}, "other": {"detector": DETECTOR}}
    kernels = changes.pop("kernels", ("pid", "gaussian"))
    return campaign("kernel", kernels, **{"arms": arms, "environments": ["sparse"], **changes})


def test_a_fault_in_a_detector_is_flown_in_its_arm_alone(monkeypatch, requests):
    c = with_detectors(monkeypatch)
    runs, golden = flown(c)
    by_target = Counter((run.target, run.setting) for run in runs)
    assert by_target == {
        ("pid", "fi"): 9,
        ("pid", "dr_watched"): 9,
        ("pid", "dr_other"): 9,
        ("gaussian", "dr_watched"): 9,
    }
    assert Plan(resolve(c)).count() == len(golden) + len(runs)
    positions = [run.position for run in [*golden, *runs]]
    assert len(set(positions)) == len(positions)


def test_a_detector_that_no_arm_or_several_arms_have_is_refused():
    for arms, number in (
        ({}, 0),
        ({"a": {"detector": "gaussian"}, "b": {"detector": "gaussian", "profile": "tuned"}}, 2),
    ):
        with pytest.raises(ValueError, match=f"'gaussian': is in {number} arms; allowed: what is in one arm"):
            campaign("kernel", ("pid", "gaussian"), arms=arms)


def test_the_calls_of_draws_are_stored_only_if_they_are_limited():
    sampling = {"level": "instruction", "kernels": ("pid",)}
    assert "when" not in InstructionSampling(**sampling).identity()
    assert InstructionSampling(**sampling, when="second_plan").identity()["when"] == "second_plan"
    with pytest.raises(ValueError, match="'uniform' or 'second_plan'"):
        InstructionSampling(**sampling, when="published")


def test_draws_begin_at_the_given_calls_and_are_else_those_of_stored_campaigns():
    counter = SimpleNamespace(counts=[5, 100, 7, 50])
    request = InstructionRequest({"pid": 200})

    def positions(first):
        target = InjectionTarget("pid", {}, "pid")
        return drawing._KernelDraw(target, 200, request, {"track": counter}, {"track": first}, 3, ()).positions()

    assert [(position.call, position.index) for position in positions(0)[:4]] == [(3, 34), (1, 86), (3, 5), (1, 8)]
    later = positions(2)
    assert {position.call for position in later} == {2, 3}
    assert abs(sum(position.call == 3 for position in later) - 200 * 50 / 57) < 25
    assert all(position.index < counter.counts[position.call] for position in later)
    assert positions(4) == []
