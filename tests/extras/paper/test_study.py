import pytest

from mavfi.campaign.config import load_campaign
from mavfi.campaign.plan import Plan
from mavfi.campaign.resolve import resolve
from mavfi.config import config_root, parse
from mavfi.errors import BadInputError
from mavfi.extras.paper.claims import claims_table
from mavfi.extras.paper.report import check_names
from mavfi.extras.paper.study import Study, load_study

SMALL = {"name": "s", "campaigns": {".": "table1", "kernels": "kernels"}}


def study(**more):
    return parse(Study, {**SMALL, **more}, "s.yaml")


def test_shipped_studies_name_campaigns_views_figures_and_claims_that_there_are():
    names = {path.stem for path in (config_root() / "studies").glob("*.yaml")}
    for name in names:
        whole = load_study(name)
        check_names(whole, name)
        for scale in ("quick", "paper"):
            at_scale = whole.at_scale(scale)
            assert set(at_scale.campaigns_at(scale)) == set(at_scale.campaigns)
    with pytest.raises(BadInputError, match="study 'table1': not known; allowed: as_published, paper, or"):
        load_study("table1")
    with pytest.raises(BadInputError, match=r"^study 'assumptions': dropped; use python -m studies\.assumptions"):
        load_study("assumptions")


def test_a_scale_flies_tests_and_shows_what_it_has_the_flights_for():
    sections = [
        {"title": "a", "campaign": "kernels", "views": ["success"]},
        {"title": "b", "claims": ["dense_hardest"], "claims_at": {"paper": ["platforms_alike"]}},
    ]
    whole = study(scales={"quick": {"kernels": None}}, sections=sections)
    quick = whole.at_scale("quick")
    assert set(quick.campaigns_at("quick")) == {"."}
    assert [section.title for section in quick.sections] == ["b"]
    assert quick.sections[0].claims == ("dense_hardest",)
    assert quick.sections[0].untested == {"paper": ("platforms_alike",)}
    paper = whole.at_scale("paper")
    assert set(paper.campaigns) == {".", "kernels"}
    assert paper.sections[1].claims == ("dense_hardest", "platforms_alike")
    assert not paper.sections[1].untested
    notes = claims_table(("dense_hardest",), [], quick.sections[0].untested).notes
    assert notes[-1].endswith("tested at scale paper: Faults harm alike on both platforms")


def test_quick_has_100_flights_in_each_cell_of_the_first_table():
    first = load_study("paper").at_scale("quick").sections[0].campaign
    campaign = load_study("paper").campaigns_at("quick")[first]
    assert campaign.missions >= 100
    assert 3 * campaign.faults >= 100


def test_the_paper_at_its_scale_has_the_sizes_that_its_head_names():
    campaigns = load_study("paper").campaigns_at("paper")
    assert {folder: (campaign.missions, campaign.faults) for folder, campaign in campaigns.items()} == {
        ".": (100, 100),
        "state_level": (100, 100),
        "instructions": (100, 100),
        "kernels": (25, 100),
        "states": (100, 100),
        "platforms": (100, 100),
        "failure_rate": (25, 50),
    }
    assert 21_000 < sum(Plan(resolve(campaign)).count() for campaign in campaigns.values()) < 22_000


def test_sizes_of_a_study_come_before_those_of_its_campaigns():
    campaign = study(scales={"quick": {"kernels": {"missions": 2, "faults": 3}}}).campaigns_at("quick")
    assert (campaign["kernels"].missions, campaign["kernels"].faults) == (2, 3)
    assert campaign["."] == load_campaign("table1")
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
