"""Compilation ahead of several campaigns."""

import pytest

from mavfi.campaign import warm_up
from mavfi.campaign.config import load_campaign
from mavfi.campaign.executors.executor import Done
from mavfi.campaign.mission import plan_of
from mavfi.campaign.study import load_study


class Inline:
    """An executor in this process."""

    forks, workers = True, 1

    def map(self, function, missions):
        for mission in missions:
            yield mission, [*function(mission), Done()]


@pytest.fixture
def compiled(monkeypatch, tmp_path):
    """Campaigns whose code was compiled, in order; the cache is empty at first."""
    found = []
    monkeypatch.setattr(warm_up, "code_folder", lambda: tmp_path / "code")
    monkeypatch.setattr(
        warm_up, "warm_up", lambda mission: found.append((mission.campaign.name, mission.campaign.arms))
    )
    return found


def test_each_campaign_is_compiled_once_and_those_of_instructions_first(compiled):
    campaigns = [load_campaign(name) for name in ("table1", "table1_instructions", "smoke")]
    warm_up.compile_ahead(campaigns, Inline())
    assert compiled == [("table1_instructions", {}), ("table1", {}), ("smoke", {})]
    warm_up.compile_ahead(campaigns, Inline())
    assert len(compiled) == 3, "found in the cache"


def test_campaigns_of_the_paper_need_no_models(compiled):
    campaigns = load_study("paper").campaigns_at("quick").values()
    warm_up.compile_ahead(campaigns, Inline())
    assert len(compiled) == len(campaigns) and not any(arms for _, arms in compiled)
    for campaign in campaigns:
        assert plan_of(warm_up._without_detectors(campaign), {}, {}).count()


def test_what_failed_is_compiled_again(compiled, monkeypatch):
    def fail(_):
        raise OSError("no space left")

    with monkeypatch.context() as patch, pytest.raises(OSError, match="no space"):
        patch.setattr(warm_up, "warm_up", fail)
        warm_up.compile_ahead([load_campaign("smoke")], Inline())
    warm_up.compile_ahead([load_campaign("smoke")], Inline())
    assert compiled == [("smoke", {})]


def test_nodes_of_other_programs_have_no_code(compiled):
    warm_up.compile_ahead([load_campaign("ros1_smoke")], Inline())
    assert compiled == []
