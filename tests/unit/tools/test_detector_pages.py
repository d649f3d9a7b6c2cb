"""Each detector of the bench has a section, whose figures are those published for it."""

import re

import pytest

from mavfi.campaign.bench import load_bench
from mavfi.campaign.config import ArmConfig
from mavfi.detectors.registry import _SHIPPED
from tools import detector_pages
from tools.build_leaderboard import NAME
from tools.detector_pages import descriptions, page
from tools.markers import GENERATED


@pytest.fixture
def bench():
    return load_bench(NAME)


def sections(text):
    return {one.partition("\n")[0]: one for one in text.split("\n## ")[1:]}


def test_every_scheme_that_watches_and_every_other_detector_has_a_section(bench):
    schemes = [name for name, arm in bench.arms.items() if arm.detector]
    others = ["checksum large"]
    assert list(sections(page(bench))) == schemes + others
    covered = {arm.detector for arm in bench.arms.values() if arm.detector} | {
        name.replace(" ", "_") for name in others
    }
    assert covered == set(_SHIPPED) - {"none"}


def test_a_detector_outside_of_the_bench_has_no_row(bench):
    assert "No row in the bench." in sections(page(bench))["checksum large"]


def test_figures_are_those_of_the_scheme_alone(bench, monkeypatch):
    state = {"lost": "7", "brought back": "5/7", "late, in time": "1/2", "only it lost": "3", "p": "0.04"}
    dead = {**state, "of these, only it lost": "0"}
    del dead["only it lost"]
    golden = {"environment": "all", "setting": "golden_pca", "per hour": "0.5 [0.0, 1.1]", "exposure": "10.56 h"}
    rows = {
        "state": [{"scheme": "limits", **state, "lost": "8"}, {"scheme": "pca", **state}],
        "instruction": [{"scheme": "pca", **dead}],
        "golden": [{**golden, "setting": "golden_limits"}, {**golden, "environment": "dense"}, golden],
    }
    monkeypatch.setattr(detector_pages, "published_rows", lambda _, part, scale: rows.get(part, []))
    found = sections(page(bench))
    table = [line.split(" | ") for line in found["pca"].splitlines() if line.startswith("| [")]
    assert [row[1:] for row in table] == [["7", "5/7", "1/2", "3", "0.04 |"], ["7", "5/7", "1/2", "0", "0.04 |"]]
    assert table[0][0].startswith(f"| [{bench.parts['state'].title}](leaderboard-paper.md#state-level-the-papers")
    assert "False alarms per flight hour: 0.5 [0.0, 1.1] in 10.56 h (Golden flights).\n" in found["pca"]
    assert "| 8 |" in found["limits"]
    assert "| [" not in found["oracle"], "not flown"


def test_links_lead_to_sections_of_the_leaderboard(bench):
    listed = re.findall(r"^- \[.+\]\(#(.+)\)$", (GENERATED / "leaderboard-paper.md").read_text(encoding="utf-8"), re.M)
    assert set(re.findall(r"leaderboard-paper\.md#([^)]+)\)", page(bench))) <= set(listed)


def test_a_section_says_what_its_models_were_fitted_to(bench):
    found = sections(page(bench))
    assert "`published`, i9-9940x: 100 flights in training." in found["gaussian tuned"]
    assert "`published`, i9-9940x: 200 flights in training, factory." in found["limits"]
    assert "`mavfi train --baselines` fits it" in found["half-space trees"]
    assert "Model" not in found["acceptance"]


def test_cost_is_that_of_the_detector_and_profile(bench):
    costs = {name: re.findall(r"([0-9.]+) µs", section) for name, section in sections(page(bench)).items()}
    assert len(costs["gaussian"]) == len(costs["gaussian tuned"]) >= 4, "two processors, two autopilot profiles"
    assert set(costs["gaussian"]).isdisjoint(costs["gaussian tuned"])
    assert not costs["oracle"], "a bound"


def test_recovery_is_that_which_goes_with_the_detector(bench):
    found = sections(page(bench))
    assert "`grain: message`, `same_twice: escalate`" in found["recommended"]
    assert "Recovery" not in found["acceptance"]


def test_a_detector_that_is_not_described_is_an_error(bench):
    unknown = bench.model_copy(update={"arms": {"mine": ArmConfig(detector="mine")}})
    assert "mine" not in descriptions()
    with pytest.raises(KeyError, match="mine"):
        page(unknown)
