"""Compilation ahead of several campaigns."""

import pytest

from mavfi.campaign import warm_up
from mavfi.campaign.config import load_campaign
from mavfi.campaign.executors.executor import Done
from mavfi.extras.paper.study import load_study


class Inline:
    """An executor in this process."""

    forks, workers = True, 1

    def map(self, function, missions):
        for mission in missions:
            yield mission, [*function(mission), Done()]


@pytest.fixture
def compiled(monkeypatch, tmp_path):
    """What was compiled, in order; the cache is empty at first."""
    tasks = []
    monkeypatch.setattr(warm_up, "code_folder", lambda: tmp_path / "code")
    monkeypatch.setattr(warm_up, "_compile", tasks.append)
    return tasks


def missions(compiled):
    """Campaigns among them, with the kernels in whose instructions they inject."""
    campaigns = [task.campaign for task in compiled if isinstance(task, warm_up._Mission)]
    return [(campaign.name, getattr(campaign.sampling, "kernels", ())) for campaign in campaigns]


def test_nothing_is_compiled_twice(compiled):
    campaigns = list(load_study("paper").campaigns_at("quick").values())
    told = []
    warm_up.compile_ahead(campaigns, Inline(), lambda *counts: told.append(counts))
    assert told == [(done, len(compiled)) for done in range(1, 1 + len(compiled))]
    assert len(compiled) == len({str(task) for task in compiled}) > 10
    stages = [task for task in compiled if isinstance(task, warm_up._Stage)]
    planners = ["rrt", "rrt_connect", "rrt_star"]
    assert sorted(stage.scenario.planner.name for stage in stages if stage.name == "plan_path") == planners
    assert len(stages) == len(planners) + 3, "the other stages do not depend on the planner"
    compiled_before = len(compiled)
    warm_up.compile_ahead(campaigns, Inline())
    assert len(compiled) == compiled_before, "found in the cache"


def test_what_failed_is_compiled_again(compiled, monkeypatch):
    def fail(_):
        raise OSError("no space left")

    with monkeypatch.context() as patch, pytest.raises(OSError, match="no space"):
        patch.setattr(warm_up, "_compile", fail)
        warm_up.compile_ahead([load_campaign("smoke")], Inline())
    warm_up.compile_ahead([load_campaign("smoke")], Inline())
    assert missions(compiled) == [("smoke", ())]
