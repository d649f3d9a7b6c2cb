import pytest

from mavfi.campaign.config import load_campaign
from mavfi.campaign.mission import plan_of
from mavfi.config import config_root, parse
from mavfi.errors import BadInputError
from mavfi.extras.paper.report import check_names
from mavfi.extras.paper.study import Study, load_study

SMALL = {"name": "s", "campaigns": {".": "table1", "kernels": "kernels"}}


def study(**more):
    return parse(Study, {**SMALL, **more}, "s.yaml")


def test_shipped_studies_name_campaigns_views_figures_and_claims_that_there_are():
    for path in (config_root() / "studies").glob("*.yaml"):
        found = load_study(path.stem)
        check_names(found, path.stem)
        for scale in ("quick", "paper"):
            assert set(found.campaigns_at(scale)) == set(found.campaigns)
    with pytest.raises(BadInputError, match="study 'table1': not known; allowed: paper, or a path"):
        load_study("table1")


def test_the_paper_at_its_scale_has_the_sizes_that_its_head_names():
    campaigns = load_study("paper").campaigns_at("paper")
    assert {folder: (found.missions, found.faults) for folder, found in campaigns.items()} == {
        ".": (100, 100),
        "instructions": (100, 100),
        "kernels": (25, 100),
        "states": (100, 100),
        "platforms": (100, 100),
        "failure_rate": (25, 50),
    }
    assert 16_500 < sum(plan_of(found, {}, {}).count() for found in campaigns.values()) < 17_500


def test_sizes_of_a_study_come_before_those_of_its_campaigns():
    found = study(scales={"quick": {"kernels": {"missions": 2, "faults": 3}}}).campaigns_at("quick")
    assert (found["kernels"].missions, found["kernels"].faults) == (2, 3)
    assert found["."] == load_campaign("table1")
    with pytest.raises(BadInputError, match="campaign table1: scale 'huge': not known; allowed: quick, paper"):
        study().campaigns_at("huge")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"campaigns": {}}, "campaigns"),
        *(({"campaigns": {name: "table1"}}, "allowed: a plain folder name") for name in ("..", "a/b", "/x", "")),
        ({"name": "../s"}, "key 'name': '../s': allowed: a plain folder name"),
        ({"sections": [{"title": "a", "campaign": "b"}]}, "sections: campaign: 'b': not known; allowed: ., kernels"),
        ({"sections": [{"title": "a", "views": ["success"]}]}, "section 'a': views and figures are of a campaign"),
        ({"scales": {"quick": {"b": {"missions": 1}}}}, "scales: quick: 'b': not known; allowed: ., kernels"),
    ],
)
def test_wrong_studies_are_refused(change, message):
    with pytest.raises(BadInputError, match=message):
        study(**change)


def test_a_campaign_is_in_one_folder_of_a_study():
    with pytest.raises(BadInputError, match="^study .*: campaigns: 'table1': named 2 times; allowed: once$"):
        study(campaigns={"first": "table1", "again": "table1"}).campaigns_at("quick")
