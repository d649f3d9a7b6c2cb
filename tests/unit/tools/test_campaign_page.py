"""Pages of campaigns: the header, findings and tables of a ledger, under a command that there is."""

import pytest

from mavfi.campaign.config import load_campaign
from mavfi.hosts.loop.recovery import BACK_OFF, MOST_RESTARTS, RESTART_US
from tests.unit.campaign.analysis.test_scheme_views import lasting_scenario
from tools import campaign_page, lasting_faults, sensor_faults
from tools.markers import ROOT


def test_the_page_of_lasting_faults_has_a_row_for_each_duration_and_scheme(monkeypatch, tmp_path):
    monkeypatch.setattr(campaign_page, "load", lambda ledger: lasting_scenario())
    page = campaign_page.page(tmp_path, "make lasting", "Faults that last", lasting_faults.TEXT, lasting_faults.VIEWS)
    assert page.startswith("<!-- Written by `make lasting`; do not edit. -->\n\n# Faults that last\n\nOne bit")
    assert "- one brings back 1 of 2 lost missions and newly loses 1." in page
    assert "| once | one | 1 | 1 | 100.0 [20.7, 100.0] 1/1 | 100.0 [20.7, 100.0] 1/1 | 0 | 0 | — |" in page
    assert "| for ever | one | 2 | 1 | 0.0 [0.0, 79.3] 0/1 | 0.0 [0.0, 79.3] 0/1 | 2 | 1 | — |" in page
    assert page.endswith("\n") and not page.endswith("\n\n")


@pytest.mark.parametrize(("tool", "target"), [(lasting_faults, "lasting"), (sensor_faults, "sensors")])
def test_each_page_has_a_target_and_a_link(tool, target):
    lines = (ROOT / "Makefile").read_text(encoding="utf-8").split(f"\n{target}: setup")[1].split("\n\n")[0]
    assert f"python -m {tool.__name__} out/{target}" in lines and f"campaign run {target} --scale paper" in lines
    assert f"](generated/{target}.md)" in (ROOT / "docs" / "fault-model.md").read_text(encoding="utf-8")


def test_every_duration_is_flown_with_every_group_of_fields():
    fields, durations = zip(
        *(group.name.split(", ") for group in load_campaign("lasting").sampling.groups), strict=True
    )
    assert len(fields) == len(set(fields)) * len(set(durations))
    assert {"once", "twice", "1 s", "10 s", "for ever", "intermittent", "burst of 4"} == set(durations)
    assert all(f"*{name}*" in lasting_faults.TEXT for name in ("twice", "for ever", "intermittent"))


def test_the_text_tells_how_long_restarts_last():
    away_us = sum(RESTART_US * BACK_OFF**number for number in range(MOST_RESTARTS))
    assert f"{1e-6 * away_us:.1f} s" in lasting_faults.TEXT
