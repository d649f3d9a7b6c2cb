"""Pages of campaigns: the header, findings and tables of a ledger, under a command that there is."""

from dataclasses import replace
from pathlib import Path

import pytest

from mavfi.campaign.config import load_campaign
from mavfi.hosts.loop.decide import BACK_OFF, MAX_RESTARTS, RESTART_US
from mavfi.states import BASELINES, WATCHING
from tests.unit.campaign.analysis.test_failure_views import campaign as failures
from tests.unit.campaign.analysis.test_scheme_views import lasting_scenario
from tools import campaign_page, campaign_pages, detector_faults, detector_payoff
from tools.campaign_pages import PAGES, content, main
from tools.markers import ROOT


def test_the_page_of_lasting_faults_has_a_row_for_each_duration_and_scheme(monkeypatch, tmp_path):
    monkeypatch.setattr(campaign_page, "load", lambda ledger: lasting_scenario())
    page = content("lasting", tmp_path)
    assert page.startswith("<!-- Written by `make lasting`; do not edit. -->\n\n# Faults that last\n\nOne bit")
    assert "- one brings back 1 of 2 lost missions and newly loses 1." in page
    assert "| once | one | 1 | 1 | 100.0 [20.7, 100.0] 1/1 | 100.0 [20.7, 100.0] 1/1 | 0 | 0 | — |" in page
    assert "| for ever | one | 2 | 1 | 0.0 [0.0, 79.3] 0/1 | 0.0 [0.0, 79.3] 0/1 | 2 | 1 | — |" in page
    assert page.endswith("\n") and not page.endswith("\n\n")


def test_a_page_is_written_under_its_name_and_bad_input_has_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(campaign_pages, "GENERATED", tmp_path)
    assert main(["lasting", str(tmp_path / "nowhere")]) == 2 and main(["other", str(tmp_path)]) == 2
    no_ledger, usage = capsys.readouterr().err.splitlines()
    assert no_ledger.startswith("bad input: ") and "nowhere" in no_ledger and "lasting|protected|sensors" in usage
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(campaign_page, "load", lambda ledger: lasting_scenario())
    assert main(["lasting", str(tmp_path)]) == 0
    assert (tmp_path / "lasting.md").read_text(encoding="utf-8") == content("lasting", tmp_path)


@pytest.mark.parametrize("target", PAGES)
def test_each_page_has_a_target_and_a_link(target):
    lines = (ROOT / "Makefile").read_text(encoding="utf-8").split(f"\n{target}: setup")[1].split("\n\n")[0]
    assert (
        f"python -m tools.campaign_pages {target} out/{target}" in lines
        and f"campaign run {target} --scale paper" in lines
    )
    assert f"](generated/{target}.md)" in (ROOT / "docs" / "fault-model.md").read_text(encoding="utf-8")


def test_the_page_of_faults_in_detectors_has_a_section_for_each_of_its_campaigns(monkeypatch):
    memory, instructions = [Path(name) for name in ("memory", "others")], Path("instructions")
    flown = {**dict.fromkeys(memory, lasting_scenario()), instructions: failures()}
    monkeypatch.setattr(campaign_page, "load", flown.__getitem__)
    monkeypatch.setattr(detector_faults, "VIEWS", ("schemes_by_duration",))
    page = detector_faults.content(*memory, instructions)
    titles = [line for line in page.splitlines() if line.startswith("#")]
    tables = ["## Failures per flight hour by setting and kernel"]
    assert titles[0] == "# Faults in detectors"
    assert titles[2:] == [
        "## Memory of other detectors", titles[1], "## Instructions of every detector", *tables,
    ]  # fmt: skip
    assert page.count("| sparse | fi | pid |") == 1 and detector_payoff.TITLE not in page
    named = {**failures().campaign, "arms": {"gaussian": {"detector": "gaussian", "profile": "paper", "mission": {}}}}
    monkeypatch.setattr(detector_faults, "load", lambda ledger: replace(failures(), campaign=named))
    assert detector_payoff.TITLE in detector_faults.content(*memory, instructions, Path("kernels"))


def test_the_campaigns_of_faults_in_detectors_are_those_of_its_target():
    lines = (ROOT / "Makefile").read_text(encoding="utf-8").split("\ndetector-faults: setup")[1].split("\n\n")[0]
    flown = [line.split()[3] for line in lines.splitlines() if "campaign run" in line]
    assert flown == [
        "detector_memory", "detector_memory_others", "detector_instructions", "failure_rate",
    ]  # fmt: skip
    outs = [line.split("--out ")[1] for line in lines.splitlines() if "campaign run" in line]
    assert "bench detectors --part instruction --scale paper --out out/bench-paper " in lines
    assert "bench detectors --part instruction --out out/bench-quick " in lines
    outs += ["out/bench-paper/instruction", "out/bench-quick/instruction"]
    assert f"python -m tools.detector_faults {' '.join(outs)}" in lines
    assert load_campaign("detector_instructions").sampling.level == "instruction"


def test_whatever_remembers_something_is_a_target_of_one_of_these_campaigns():
    memory = [load_campaign(name) for name in ("detector_memory", "detector_memory_others")]
    assert {campaign.sampling.level for campaign in memory} == {"memory"}
    targets = {name for campaign in memory for name in campaign.sampling.kernels}
    assert targets == {*WATCHING} - {*BASELINES}, "models of baselines are not shipped"


def test_every_duration_is_flown_with_every_group_of_fields():
    fields, durations = zip(
        *(group.name.split(", ") for group in load_campaign("lasting").sampling.groups), strict=True
    )
    assert len(fields) == len(set(fields)) * len(set(durations))
    assert {"once", "twice", "1 s", "10 s", "for ever", "intermittent", "burst of 4"} == set(durations)
    assert all(f"*{name}*" in PAGES["lasting"].text for name in ("twice", "for ever", "intermittent"))


def test_the_text_tells_how_long_restarts_last():
    away_us = sum(RESTART_US * BACK_OFF**number for number in range(MAX_RESTARTS))
    assert f"{1e-6 * away_us:.1f} s" in PAGES["lasting"].text
