"""`mavfi report` and `mavfi runs` on a campaign of made-up flights."""

import csv
import io
import json

import polars as pl
import pytest

from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.store import Store
from mavfi.cli import run
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import small


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    directory = tmp_path_factory.mktemp("flown")
    run_campaign(small(missions=5, faults=10), directory, executor=LocalExecutor(1))
    return directory


def printed(capsys, *arguments):
    assert run([str(argument) for argument in arguments]) == 0
    return capsys.readouterr().out


@pytest.mark.slow
def test_the_report_ends_with_the_headline(capsys, flown):
    text = printed(capsys, "report", flown)
    assert "State level: success rates" in text and "How missions ended" not in text
    assert "· Without a fault" in text and "report.md" in text
    assert {"report.md", "readme_block.md", "summary.json", "success.png"} <= {path.name for path in flown.iterdir()}
    assert "How missions ended" in printed(capsys, "report", flown, "--all")
    data = json.loads(printed(capsys, "report", flown, "--json"))
    assert data["campaign"]["name"] == "small" and data["tables"]["endings"]["rows"]


@pytest.mark.parametrize(
    "name",
    ["instructions_as_in_the_paper", "platforms"],
)
def test_a_table_of_other_faults_is_refused(capsys, flown, name):
    assert run(["report", str(flown), "--view", name]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"view '{name}': these runs have nothing to show in it; allowed: " in line


def test_one_table_by_name(capsys, flown):
    assert "How missions ended" in printed(capsys, "report", flown, "--view", "endings")
    rows = list(csv.DictReader(io.StringIO(printed(capsys, "report", flown, "--view", "endings", "--csv"))))
    assert {row["setting"] for row in rows} == {"golden", "golden_gaussian", "fi", "dr_gaussian"}
    assert json.loads(printed(capsys, "report", flown, "--view", "endings", "--json"))["name"] == "endings"
    names = [line.split()[0] for line in printed(capsys, "report", flown, "--view", "list").splitlines()]
    assert "endings" in names and "kernel_effects" not in names


def test_runs_are_listed(capsys, flown):
    failed = printed(capsys, "runs", flown, "--failed", "--csv")
    rows = list(csv.DictReader(io.StringIO(failed)))
    assert rows and {row["status"] for row in rows} == {"collision"}
    assert rows[0]["run_id"].rpartition("-")[0] in printed(capsys, "runs", flown, "--failed")
    assert len(json.loads(printed(capsys, "runs", flown, "--json"))["rows"]) == 2 * (2 * (5 + 30) + 3)
    frame = pl.read_csv(io.StringIO(printed(capsys, "runs", flown, "--csv")))
    assert frame.height == 146 and {"run_id", "effect", "inflation"} <= set(frame.columns)


def test_runs_fit_a_terminal_and_are_named_by_number_or_short_id(capsys, flown, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = printed(capsys, "runs", flown)
    rows = json.loads(printed(capsys, "runs", flown, "--json"))["rows"]
    lines = [line.split() for line in text.splitlines() if "-1000" in line]
    assert len(lines) == len(rows) and all(len(line) <= 80 for line in text.splitlines())
    with Store.open(flown) as store:
        for (number, short, *_), row in zip(lines, rows, strict=True):
            assert store.run(number).spec.run_id == store.run(short).spec.run_id == row["run_id"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["report", "DIR", "--csv"], "--csv: allowed: with --view NAME"),
        (["report", "DIR", "--view", "success", "--html", "r.html"], "--view: prints one table and writes nothing"),
        (
            ["report", "DIR", "--view", "nothing"],
            "view 'nothing': not known; allowed: endings, success_as_in_the_paper, ",
        ),
        (["report", "DIR", "--html", "report.pdf"], "--html: report.pdf: allowed ending: .html"),
        (["report", "DIR", "--flights", "3"], "--flights: 3: there is no page; allowed: together with --html"),
        (["export", "DIR", "--to", "x.bag"], "name the run, too"),
        (["harden", "DIR"], "mavfi campaign run kernels --out out/kernels"),
    ],
)
def test_what_is_not_there_is_one_line(capsys, flown, tmp_path, arguments, message):
    places = {"DIR": str(flown), "NONE": str(tmp_path)}
    assert run([places.get(argument, argument) for argument in arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_html_report_of_a_campaign_without_flights(capsys, flown, tmp_path):
    page = tmp_path / "report.html"
    text = printed(capsys, "report", flown, "--html", page, "--flights", "0")
    assert f"wrote {page}, with 0 flights" in text
    assert "Campaign small" in page.read_text(encoding="utf-8")
