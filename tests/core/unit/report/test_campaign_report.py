import json

import pytest

from mavfi.report.campaign_report import report_of, write_report

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def written(flown):
    return write_report(flown)


def read(written, name):
    return next(path for path in written.files if path.name == name).read_text(encoding="utf-8")


def test_all_files_are_there_and_pictures_are_pictures(written):
    names = {path.name for path in written.files}
    assert {"report.md", "readme_block.md", "summary.json", "success.png", "flight_time.png"} <= names
    for path in written.files:
        content = path.read_bytes()
        assert len(content) > 500
        assert not path.name.endswith(".png") or content.startswith(PNG)


def test_report_shows_every_table_and_figure(written):
    text = read(written, "report.md")
    for title in (
        "Success of missions",
        "Success by inter-kernel state",
        "Effects of faults",
        "False alarms",
    ):
        assert f"## {title}" in text
    assert "![success.png](success.png)" in text and "## Findings" in text
    assert "have the digest of their golden runs" in text


def test_readme_block_is_the_success_table_with_its_origin(written):
    text = read(written, "readme_block.md")
    assert text.startswith("**State level: success rates, one fault per mission**\n\nGenerated on ")
    paragraphs = (
        "campaign tiny",
        "autopilot profile published",
        "numba",
        "seeds 10000 to 10001",
        "| Golden run | here |",
    )
    for part in paragraphs:
        assert part in text
    assert "## " not in text


def test_summary_holds_every_table_in_numbers(written):
    summary = json.loads(read(written, "summary.json"))
    assert summary["campaign"]["digest"] == written.runs.campaign["digest"]
    assert summary["null_runs"] == {"n": 2, "differing": []} and summary["unknown"] == []
    assert {table.name for table in written.tables} <= set(summary["tables"])
    [fi] = [row for row in summary["tables"]["success"]["rows"] if row["setting"] == "fi"]
    assert fi["success"]["n"] == 3 and fi["paper"] == 0.883


def test_an_idle_detector_changes_nothing(runs):
    rows = {
        row["setting"]: row for table in report_of(runs).tables if table.name == "success" for row in table.entries()
    }
    assert list(rows) == ["golden", "golden_idle", "fi", "dr_idle"]
    for key in ("success", "success_whole_word", "success_mantissa"):
        assert rows["fi"][key] == rows["dr_idle"][key]
