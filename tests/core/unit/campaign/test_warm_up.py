"""Compilation ahead of several campaigns."""

import pytest

from mavfi.campaign import warm_up
from mavfi.campaign.config import load_campaign
from mavfi.campaign.executors.executor import Done
from mavfi.extras.paper.study import load_study
from mavfi.flight.compiling import STAGES
from mavfi.flight.compose import resolve
from mavfi.mission import MissionSpec


class Inline:
    """An executor in this process."""

    forks, workers = True, 1

    def map(self, function, missions):
        for mission in missions:
            yield mission, [*function(mission), Done()]


@pytest.fixture
def compiled(monkeypatch, tmp_path):
    """What was compiled, in order; the cache is empty at first."""
    found = []
    monkeypatch.setattr(warm_up, "code_folder", lambda: tmp_path / "code")
    monkeypatch.setattr(warm_up, "_compile", found.append)
    return found


def missions(compiled):
    """Campaigns among them, with the kernels in whose instructions they inject."""
    own = [task.campaign for task in compiled if isinstance(task, warm_up._Mission)]
    return [(campaign.name, getattr(campaign.sampling, "kernels", ())) for campaign in own]


def test_stages_come_first_then_each_kernel_then_each_mission(compiled):
    warm_up.compile_ahead([load_campaign("table1"), load_campaign("table1_instructions")], Inline())
    assert [task.name for task in compiled[:4]] == list(STAGES)
    kernels = ("rrt_connect", "point_cloud", "octomap", "collision_check", "pid")
    whole = (*kernels[1:4], kernels[0], kernels[4])
    assert missions(compiled) == [
        *(("table1_instructions", (kernel,)) for kernel in kernels),
        ("table1", ()),
        ("table1_instructions", whole),
    ]
    detectors = [(task.arm.detector, task.arm.profile) for task in compiled if isinstance(task, warm_up._Detector)]
    assert detectors == [("gaussian", "paper"), ("autoencoder", "paper")]


def test_nothing_is_compiled_twice(compiled):
    campaigns = list(load_study("paper").campaigns_at("quick").values())
    told = []
    warm_up.compile_ahead(campaigns, Inline(), lambda *counts: told.append(counts))
    assert told == [(done, len(compiled)) for done in range(1, 1 + len(compiled))]
    assert len(compiled) == len({str(task) for task in compiled}) > 10
    stages = [task for task in compiled if isinstance(task, warm_up._Stage)]
    planners = ["rrt", "rrt_connect", "rrt_star"]
    assert sorted(one.scenario.planner.name for one in stages if one.name == "plan_path") == planners
    assert len(stages) == len(planners) + 3, "the other stages do not depend on the planner"
    known = len(compiled)
    warm_up.compile_ahead(campaigns, Inline())
    assert len(compiled) == known, "found in the cache"


def test_what_failed_is_compiled_again(compiled, monkeypatch):
    def fail(_):
        raise OSError("no space left")

    with monkeypatch.context() as patch, pytest.raises(OSError, match="no space"):
        patch.setattr(warm_up, "_compile", fail)
        warm_up.compile_ahead([load_campaign("smoke")], Inline())
    warm_up.compile_ahead([load_campaign("smoke")], Inline())
    assert missions(compiled) == [("smoke", ())]


def test_a_detector_with_faults_is_compiled_with_its_shipped_model(compiled, monkeypatch):
    flown = []
    monkeypatch.setattr(warm_up, "warm_up", flown.append)
    warm_up.compile_ahead([load_campaign("failure_rate")], Inline())
    for task in compiled:
        task.compile()
    arms = [(plan.campaign.config.sampling.kernels, *plan.campaign.models) for plan in flown if plan.campaign.models]
    detectors = {("acceptance",): ["recommended"], ("gaussian",): ["gaussian"], ("autoencoder",): ["autoencoder"]}
    assert arms == [(kernels, *own) for kernels, own in detectors.items()]
    assert warm_up.is_compiled(load_campaign("failure_rate"))


def test_a_flight_is_compiled_by_stages(compiled):
    scenario = resolve(MissionSpec(environment="sparse", seed=7))
    warm_up.compile_flight(scenario, Inline())
    assert [(task.name, task.scenario) for task in compiled] == [(stage, scenario) for stage in STAGES]
