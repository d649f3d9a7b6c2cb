import json

import pytest
from rich.console import Console

from mavfi.errors import BadInputError
from mavfi.reports.campaign_report import write_report
from mavfi.reports.terminal import show

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def written(flown):
    return write_report(flown)


def test_all_files_are_there_and_pictures_are_pictures(written):
    names = {path.name for path in written.files}
    assert {"report.md", "readme_block.md", "summary.json", "success.png", "flight_time.png", "states.png"} <= names
    for path in written.files:
        content = path.read_bytes()
        assert len(content) > 500
        assert not path.name.endswith(".png") or content.startswith(PNG)


def test_report_shows_every_table_and_figure(written):
    text = next(path for path in written.files if path.name == "report.md").read_text(encoding="utf-8")
    titles = ("Success of missions", "Success by inter-kernel state", "Outcomes of faults, by stage", "False alarms")
    for title in titles:
        assert f"## {title}" in text
    assert "![success.png](success.png)" in text
    assert "have the digest of their golden twins" in text


def test_markdown_tables_are_rectangular(written):
    text = next(path for path in written.files if path.name == "report.md").read_text(encoding="utf-8")
    blocks = [block.splitlines() for block in text.split("\n\n") if block.startswith("| ")]
    assert len(blocks) > 8
    for block in blocks:
        assert len({line.count("|") for line in block}) == 1


def test_readme_block_is_the_success_table_with_its_origin(written):
    text = next(path for path in written.files if path.name == "readme_block.md").read_text(encoding="utf-8")
    assert text.startswith("**State level: success rates, one fault per mission**\n\nGenerated on ")
    for part in (
        "campaign `tiny`",
        "stack `published`",
        "numba",
        "seeds 10000 to 10001",
        "| Golden run | here |",
        "sparse",
    ):
        assert part in text
    assert "## " not in text


def test_summary_is_the_analysis(written):
    summary = json.loads(
        next(path for path in written.files if path.name == "summary.json").read_text(encoding="utf-8")
    )
    assert summary["campaign"]["digest"] == written.analysis["campaign"]["digest"]
    assert summary["success"] == json.loads(json.dumps(written.analysis["success"]))


def test_terminal_shows_tables_without_details(analysis):
    console = Console(width=140, record=True, quiet=False, file=open("/dev/null", "w"))  # noqa: SIM115
    show(analysis, console)
    console.file.close()
    text = console.export_text()
    assert "Success of missions" in text
    assert "Null runs: all 2" in text
    assert "Success by field" not in text


def test_no_campaign_no_report(tmp_path):
    with pytest.raises(BadInputError, match="holds no campaign"):
        write_report(tmp_path)
    assert not list(tmp_path.iterdir())
