import json

import pytest

from mavfi.campaign.executors.local import LocalExecutor
from mavfi.cli.commands import run
from mavfi.extras.paper import overhead_views, overheads
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import DETECTOR, small


@pytest.fixture
def ledger(tmp_path, monkeypatch):
    def cost(scenario, name, profile, models_dir, options):
        detection, recovery = (dict.fromkeys(overheads.STAGES, spent) for spent in (0.25, 0.5))
        return overheads.Cost(1.0, detection, recovery, 7, 0.0, 50.0)

    monkeypatch.setattr(overheads, "cost", cost)
    run_campaign(small(missions=2, faults=3), tmp_path, executor=LocalExecutor(1))
    return tmp_path


def test_measured_overheads_are_written_and_shown(ledger, capsys):
    assert run(["bench", "overheads", str(ledger), "--missions", "1", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert {row["stage"] for row in rows} == set(overheads.STAGES)
    assert all(row["measured_detection"] == 0.25 and row["measured_sum"] == 0.75 for row in rows)
    assert all(row["modelled_detection"] == 0.005 <= row["modelled_sum"] for row in rows)
    assert len(overhead_views.load(ledger)["rows"]) == 2 * len(overheads.STAGES), "two environments"
    assert run(["report", str(ledger), "--view", "overheads_as_in_the_paper"]) == 0
    assert "25 %" in capsys.readouterr().out


def test_bad_input_is_one_line(ledger, capsys):
    assert run(["bench", "overheads", str(ledger), "--missions", "0"]) == 2
    assert "--missions: 0: allowed: 1 to 1000" in capsys.readouterr().err
    (ledger / overheads.FILE).write_text("{")
    assert run(["report", str(ledger), "--view", "overheads_as_in_the_paper"]) == 2


def test_a_profile_is_that_of_a_detector(capsys):
    assert run(["bench", "detectors", "--scheme", "limits", "--profile", "tuned"]) == 2
    assert "--profile: 'tuned': allowed: with --detector" in capsys.readouterr().err


@pytest.fixture
def own_bench(tmp_path, monkeypatch):
    """A bench whose campaign takes microseconds, with a published list of its faults and one published row."""
    from mavfi.extras.bench import bench as benches

    made = small(missions=2, faults=3, arms={}).to_json()
    monkeypatch.setattr(benches, "config_root", lambda: tmp_path)
    (tmp_path / "c.yaml").write_text(json.dumps(made))
    part = {"campaign": str(tmp_path / "c.yaml"), "title": "T"}
    bench = {"name": "b", "parts": {"p": part}, "arms": {"a": {"detector": DETECTOR}}}
    (tmp_path / "b.yaml").write_text(json.dumps(bench))
    return tmp_path


def fly_own(folder, capsys, *more):
    command = ["bench", "detectors", str(folder / "b.yaml"), "--detector", DETECTOR, "--out", str(folder / "out")]
    assert run([*command, *more]) == 0
    capsys.readouterr()
    return (folder / "out" / "leaderboard.md").read_text()


def test_ones_own_detector_stands_beside_the_published_rows_if_its_faults_are_the_published_ones(own_bench, capsys):
    page = fly_own(own_bench, capsys, "--part", "p")
    assert "| a |" not in page
    assert f"mavfi bench detectors {own_bench / 'b.yaml'} --part p --detector my_package:MyDetector\n" in page
    frozen = own_bench / "bench" / "b"
    frozen.mkdir(parents=True)
    (frozen / "p-quick.csv").write_text((own_bench / "out" / "p" / "faults.csv").read_text())
    (frozen / "p-quick.rows.csv").write_text("scheme,lost\na,3\ngone,4\n")
    page = fly_own(own_bench, capsys)
    assert "| a |" in page and "| FakeDetector |" in page and "as published in b" in page
    assert "| gone |" not in page, "the bench has no such scheme any more"
    (frozen / "p-quick.csv").write_text("others")
    assert "| a |" not in fly_own(own_bench, capsys)


def test_a_part_without_published_rows_is_compared_with_the_benchs_own_schemes_once_they_are_flown(
    own_bench, capsys, monkeypatch
):
    monkeypatch.chdir(own_bench)
    command = ["bench", "detectors", "b.yaml", "--part", "p"]
    assert run([*command, "--detector", DETECTOR]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "Compared with nothing yet: `mavfi bench detectors b.yaml --part p` flies the bench's own schemes" in text
    assert run(command) == 0
    capsys.readouterr()
    assert run([*command, "--detector", DETECTOR]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "the other rows are those flown in out/bench-quick/p" in text and "Compared with nothing" not in text
