import html
import json
import re
from types import SimpleNamespace

import pytest
import yaml

from mavfi.analysis.runs import Runs
from mavfi.analysis.views import VIEWS, table_asked_for
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.store import Store
from mavfi.cli import run
from mavfi.extras.paper import overhead_views
from mavfi.extras.paper.provenance import load_runs
from mavfi.extras.paper.report import study_report
from mavfi.extras.paper.study import load_study
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import small


@pytest.fixture(autouse=True)
def few_flights(monkeypatch, tmp_path):
    """One flight in the page of a study; code is compiled when it is needed."""
    monkeypatch.setattr("mavfi.extras.paper.cli.FLIGHTS_EACH", 1)
    monkeypatch.setattr("mavfi.campaign.warm_up.compile_ahead", lambda *_: None)


def no_report(monkeypatch):
    """Write and print nothing after the flights."""
    nothing = SimpleNamespace(campaigns={})
    monkeypatch.setattr("mavfi.extras.paper.cli_report.write_study_report", lambda *_, **__: (nothing, 0))
    monkeypatch.setattr("mavfi.extras.paper.cli_report.show_study_report", lambda *_, **__: None)


def study(folder, **changes):
    """One environment and one mission at both levels instead of the paper's tables; the training flights are three."""
    both = {"environments": ["sparse"], "missions": 1, "faults": 1, "arms": {"gaussian": {"detector": "gaussian"}}}
    campaigns = {
        "table1": {**both, "null_runs": 1, "sampling": {"strata": {"sign_exponent": 1}}},
        "table1_instructions": {
            **both,
            "sampling": {"level": "instruction", "kernels": ["rrt_connect", "pid"], "share": "stage", "which": "data"},
        },
    }
    for name, content in campaigns.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump({"name": name, **content, **changes.get(name, {})}))
    where = {".": str(folder / "table1.yaml"), "instructions": str(folder / "table1_instructions.yaml")}
    content = {"name": "small", "training_flights": 3, "campaigns": where, **changes.get("study", {})}
    (folder / "small.yaml").write_text(yaml.safe_dump(content))
    return str(folder / "small.yaml")


@pytest.mark.slow
def test_it_trains_flies_times_prints_and_writes_and_resumes_where_it_stopped(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("mavfi.extras.paper.cli.TIMED_FLIGHTS", 1)
    leading = {".": "success_as_in_the_paper", "instructions": "instructions_as_in_the_paper"}
    sections = [{"title": name, "campaign": name, "views": [view], "headline": True} for name, view in leading.items()]
    sections.append({"title": "Table II", "campaign": ".", "views": ["overheads_as_in_the_paper"]})
    out = tmp_path / "out"
    arguments = ["reproduce", study(tmp_path, study={"sections": sections}), "--out", str(out), "--workers", "1"]
    assert run(arguments) == 0
    text, progress = capsys.readouterr()
    shown = [line.removeprefix("study small, ") for line in progress.splitlines()]
    assert re.fullmatch(r"report\.html and its flights (\d+)/\1 flights", shown[-1])
    assert any(re.fullmatch(r"flights of all campaigns (\d+)/\1 flights", line) for line in shown)
    folders = (out, out / "instructions")
    states, instructions = (
        table_asked_for(Runs.read(folder), view).title for folder, view in zip(folders, leading.values(), strict=True)
    )
    assert 0 <= text.index(states) < text.index(instructions) < text.index("The models are in")
    ends = [line.split() for line in text.partition("The ledgers, with their digests")[2].splitlines()[1:3]]
    ledgers = {"table1": out, "table1_instructions": out / "instructions"}
    digests = []
    for name, folder in ledgers.items():
        with Store.open(folder) as store:
            digests.append([name, store.digest()[:16], str(folder)])
    assert ends == digests, "as in README.md"
    assert {"study.md", "study.json"} <= {path.name for path in out.iterdir()}
    for folder in ledgers.values():
        assert {"report.md", "readme_block.md", "summary.json"} <= {path.name for path in folder.iterdir()}

    def never(*_, **__):
        raise AssertionError("trained or timed again")

    assert overhead_views.load(out)["missions"] == 1
    written = (out / "study.md").read_text(encoding="utf-8")
    assert "- Machine: " in written and written.count("- Digest of the ledger in ") == 2
    assert f"## {states}" in written and f"## {instructions}" in written, "the leading table of each campaign"
    assert "All rows: [overheads_as_in_the_paper](tables/table1_overheads_as_in_the_paper.csv)." in written
    monkeypatch.setattr("mavfi.campaign.training.record", never)
    monkeypatch.setattr("mavfi.extras.paper.overheads.measure", never)
    monkeypatch.setattr("mavfi.extras.paper.cli.FLIGHTS_EACH", 0)
    assert run([*arguments, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert set(data["campaigns"]) == {".", "instructions"} and len(data["provenance"]) == 6
    assert len(load_runs(out)) == 2, "a resumed study adds its run"


@pytest.mark.slow
@pytest.mark.long
def test_sections_of_a_study_come_in_its_order_with_their_tables_and_figures(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("mavfi.campaign.training.record", lambda *_, **__: None)
    monkeypatch.setattr("mavfi.campaign.training.RecordedFlights.fit", lambda _: None)
    changes = {name: {"arms": {}} for name in ("table1", "table1_instructions")}
    sections = [
        {"title": "One", "campaign": "instructions", "views": ["kernel_effects", "flight_times"]},
        {"title": "Two", "campaign": ".", "views": ["endings"], "figures": ["flight_time"]},
    ]
    changes["study"] = {"sections": sections}
    out = tmp_path / "out"
    assert run(["reproduce", study(tmp_path, **changes), "--out", str(out), "--workers", "1"]) == 0
    printed = capsys.readouterr().out
    titles = ["One", VIEWS["kernel_effects"].title, "Two", VIEWS["endings"].title]
    assert sorted(titles, key=printed.index) == titles
    assert VIEWS["flight_times"].title not in printed, "the first table of a section is printed"
    report = (out / "study.md").read_text(encoding="utf-8")
    links = ("[kernel_effects](tables/table1_instructions_kernel_effects.csv)", "(figures/table1_flight_time.png)")
    assert f"## {VIEWS['kernel_effects'].title}" in report and all(link in report for link in links)
    assert VIEWS["flight_times"].title not in report, "the second table of a section is linked"
    assert (out / "figures" / "table1_flight_time.png").stat().st_size > 10_000
    table = (out / "tables" / "table1_instructions_kernel_effects.csv").read_text(encoding="utf-8")
    assert len(table.splitlines()) > 1
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "mavfi reproduce small --scale quick --out" in page, "how to repeat it"
    assert "Study small" in page and "<svg" in page and all(f">{title}<" in page for title in ("One", "Two"))
    findings = study_report(load_study(tmp_path / "small.yaml"), out).findings
    assert list(findings) == ["One", "Two"] and all(f"<h3>{title}</h3>" in page for title in findings)
    assert [line for lines in findings.values() for line in lines if line not in html.unescape(page)] == []

    assert run(["report", str(out), "--html", str(tmp_path / "page.html"), "--flights", "1"]) == 0
    printed = capsys.readouterr().out
    assert all(title in printed for title in titles)
    again = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Study small" in again and "mavfi reproduce small --scale quick --out" in again


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"campaign": ".", "views": ["none"]}, "small.yaml: section 'a': views: 'none': not known; allowed: success"),
        ({"campaign": "elsewhere", "views": ["success"]}, "campaign: 'elsewhere': not known; allowed: ., instructions"),
    ],
)
def test_wrong_names_are_refused_before_anything_is_flown(section, message, capsys, tmp_path):
    out = tmp_path / "out"
    sections = [{"title": "a", **section}]
    assert run(["reproduce", study(tmp_path, study={"sections": sections}), "--out", str(out)]) == 2
    assert message in capsys.readouterr().err and not out.exists()


def test_a_damaged_record_of_a_study_is_named(capsys, tmp_path):
    run_campaign(small(missions=1, faults=1), tmp_path, executor=LocalExecutor(1))
    for content, message in (
        ("{", "study.json: is no record of a study"),
        ('{"scale": "quick"}', "study.json: is no record of a study"),
        ('{"scale": "quick", "definition": {"name": 3}}', "study.json: definition: key 'name': 3: "),
    ):
        (tmp_path / "study.json").write_text(content, encoding="utf-8")
        assert run(["report", str(tmp_path)]) == 2
        assert message in capsys.readouterr().err


@pytest.fixture
def trained(monkeypatch):
    """Autopilot profiles that detectors were trained for; nothing is flown."""
    missions = []
    monkeypatch.setattr(
        "mavfi.extras.paper.cli._is_trained", lambda campaign, *_: campaign.mission.get("autopilot") in missions
    )
    no_report(monkeypatch)
    monkeypatch.setattr("mavfi.campaign.begin.begin", lambda *_, **__: None)
    monkeypatch.setattr("mavfi.campaign.run.run_campaigns", lambda *_, **__: None)
    monkeypatch.setattr(
        "mavfi.campaign.training.record", lambda _, __, mission, **___: missions.append(mission.autopilot)
    )
    monkeypatch.setattr("mavfi.campaign.training.RecordedFlights.fit", lambda _: None)
    return missions


@pytest.mark.parametrize(
    ("first", "second", "wanted"),
    [
        ({"mission": {"autopilot": "published"}}, {"mission": {"autopilot": "hardened"}}, ["published", "hardened"]),
        ({"mission": {"autopilot": "hardened"}}, {"mission": {"autopilot": "hardened"}}, ["hardened"]),
        ({"arms": {}}, {"arms": {}}, []),
    ],
)
def test_detectors_are_trained_once_for_each_mission_that_is_watched(tmp_path, trained, first, second, wanted):
    name = study(tmp_path, table1=first, table1_instructions=second)
    assert run(["reproduce", name, "--out", str(tmp_path / "out")]) == 0
    assert trained == wanted
