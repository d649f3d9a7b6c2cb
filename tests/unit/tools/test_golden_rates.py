import json
from dataclasses import asdict, replace

import pytest

from tools import golden_rates
from tools.build_fault_map import FAULT_MAP, key_lines
from tools.golden import GoldenFlight, Row, Setting

GOOD = GoldenFlight(10_000, "success", 30.0, 150.0, 0.5, 0.3, 1.05, 2, 0, 1, 0, (1.0, 2.0, 3.0), "", "")
LOST = replace(GOOD, seed=10_001, status="timeout", cause="flew 5 m", events="1.0 s plan")
SETTING = Setting.of("dense", "hardened", least=100, quality=True)


def entry(setting=SETTING, flights=(GOOD, LOST)):
    plain = golden_rates.plain(setting)
    return {"setting": plain, "flights": json.loads(json.dumps([asdict(flight) for flight in flights])),
            "date": "2026-11-20", "versions": golden_rates.versions()}  # fmt: skip


def test_the_page_tells_bars_failures_and_faults():
    page = golden_rates.page([entry()], "| way-point |")
    assert "3 of 4 bars are met." in page and "1/2 (≥ 100 %): **not met**" in page and "0.50 m (≥ 0.15 m): met" in page
    assert "seed 10001: **timeout**" in page and "flew 5 m" in page and f"`{SETTING.command(10_001)}`" in page
    assert "<!-- faults:begin -->\n| way-point |\n<!-- faults:end -->" in page
    assert "The scanned corridor was not there" in page
    assert "The scanned corridor was not there" not in golden_rates.page([entry(golden_rates.CORRIDOR[0])], "")


def test_a_stored_row_is_the_row_again():
    row = golden_rates.as_row(entry(golden_rates.CORRIDOR[0]))
    assert row == Row(golden_rates.CORRIDOR[0], (GOOD, LOST))


def test_every_setting_of_the_bars_is_a_row_once():
    rows = [setting for setting, _ in golden_rates.settings(scan=True)]
    assert len(set(rows)) == len(rows)
    quality = {(s.mission.environment, s.mission.planner) for s in rows if s.quality}
    assert quality == {(w, p) for w in ("factory", "farm", "sparse", "dense") for p in ("rrt_connect", "rrt_star")}
    assert {s.mission.planner for s in rows if s.mission.autopilot == "published"} == {"rrt", "rrt_connect", "rrt_star"}
    assert not any(s.mission.start for s, _ in golden_rates.settings(scan=False))


@pytest.mark.parametrize(("resume", "flown"), [(True, 0), (False, 1)])
def test_a_row_that_is_complete_is_kept_where_that_is_asked_for(monkeypatch, tmp_path, resume, flown):
    record = tmp_path / "out" / "golden.json"
    record.parent.mkdir()
    record.write_text(json.dumps([entry()]), encoding="utf-8")
    calls = []
    monkeypatch.setattr(golden_rates, "RECORD", record)
    monkeypatch.setattr(golden_rates, "settings", lambda scan: [(SETTING, "N")])
    monkeypatch.setattr(golden_rates, "fly_one", lambda *call: calls.append(call) or entry(flights=(GOOD,)))
    monkeypatch.setenv("N", "2")
    stored = golden_rates.fly_all("", resume, 1, scan=False)
    assert len(calls) == flown and len(stored) == 1
    assert len(json.loads(record.read_text(encoding="utf-8"))[0]["flights"]) == 2 - flown


def test_key_lines_are_those_of_the_fault_map():
    page = FAULT_MAP.read_text(encoding="utf-8")
    lines = key_lines(page).splitlines()
    assert lines[0].startswith("Autopilot profile `published`") and all(line in page for line in lines)
    assert sum(line.startswith("| way-point position") for line in lines) == 3
    assert not any("cloud" in line or "voxel" in line for line in lines)
