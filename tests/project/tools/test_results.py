"""Pages of results: all rows are in files, the page shows those that matter, and a mistake is one line."""

import csv

import pytest

from mavfi.analysis.statistics import wilson
from mavfi.analysis.table import RATE, Column, Table
from mavfi.campaign.config import load_campaign
from tools import results
from tools.markers import ROOT
from tools.results import CAMPAIGNS, Excerpt, main, write

COLUMNS = (Column("scheme", "scheme"), Column("back", "brought back", RATE), Column("late", "late"))
TABLE = Table(
    "t",
    "A title",
    COLUMNS,
    [("a", wilson(1, 2), "x"), ("b", wilson(2, 2), "y")],
    notes=("late: of them", "brought back: of the lost"),
)


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setattr(results, "RESULTS", tmp_path)
    monkeypatch.setattr(results, "TABLES", tmp_path / "tables")
    return tmp_path


def test_all_rows_are_in_the_file_and_the_page_shows_some(folder):
    (folder / "tables" / "name").mkdir(parents=True)
    for file in ("old", "kept"):
        (folder / "tables" / "name" / f"{file}.csv").touch()
    shown = Excerpt("all", lambda row: row["scheme"] == "b", ("scheme", "brought back"))
    page = write("name", "Title", "What.", {"all": TABLE}, [shown], ["flown"], keep=["kept"]).read_text(
        encoding="utf-8"
    )
    assert page.startswith("<!-- Written by `make results NAME=name`; do not edit. -->\n\n# Title\n\nWhat.\n\n")
    assert "| scheme | brought back |\n| --- | --- |\n| b | 100.0 [34.2, 100.0] 2/2 |\n\n" in page
    assert "- [A title](tables/name/all.csv): 2 rows\n" in page
    assert page.endswith("- flown\n- brought back: of the lost\n"), "notes of hidden columns are left out"
    with (folder / "tables" / "name" / "all.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["scheme"], row["back"], row["back_n"]) for row in rows] == [("a", "0.5", "2"), ("b", "1.0", "2")]
    assert {path.stem for path in (folder / "tables" / "name").iterdir()} == {"all", "kept"}


@pytest.mark.parametrize("arguments", [[], ["other"]])
def test_an_unknown_page_is_one_line(arguments, capsys):
    assert main(arguments) == 2
    stderr = capsys.readouterr().err
    assert stderr.startswith("bad input: NAME: ") and "sensors" in stderr and stderr.count("\n") == 1


def test_campaigns_and_modules_of_all_pages_exist():
    for page in CAMPAIGNS.values():
        for campaign in page.campaigns:
            load_campaign(campaign)
    for module in results.MODULES.values():
        assert (ROOT / f"{module.replace('.', '/')}.py").is_file()
