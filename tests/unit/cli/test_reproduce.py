import json

import pytest

from mavfi.campaign.config import Campaign
from mavfi.cli import reproduce, run
from mavfi.cli.progress import Bar


@pytest.fixture
def small(monkeypatch):
    """A table of one environment and one mission instead of the paper's; the training flights are three."""
    campaign = Campaign.model_validate(
        {"name": "table1", "environments": ["sparse"], "flights": 1, "faults": 1, "null_runs": 1,
         "strata": {"sign_exponent": 1}, "detectors": {"gaussian": {"detector": "gaussian"}}}
    )  # fmt: skip
    monkeypatch.setattr("mavfi.campaign.config.load_campaign", lambda name: campaign)
    monkeypatch.setattr(reproduce, "TRAINING_FLIGHTS", 3)


@pytest.mark.slow
def test_it_trains_flies_prints_and_writes_and_goes_on_where_it_stopped(capsys, tmp_path, small, monkeypatch):
    arguments = ["reproduce", "--out", str(tmp_path / "out"), "--workers", "1"]
    assert run(arguments) == 0
    text = capsys.readouterr().out
    assert "Success of missions" in text and "It took" in text
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"campaign.sqlite", "models", "report.md", "readme_block.md", "summary.json", "success.png"} <= names

    def never(*_, **__):
        raise AssertionError("trained again")

    monkeypatch.setattr("mavfi.campaign.training.train", never)
    assert run([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["campaign"]["name"] == "table1"


@pytest.mark.slow
def test_training_that_is_stopped_goes_on(capsys, tmp_path, small, monkeypatch):
    out = tmp_path / "out"
    show, told = Bar.show, []

    def stop(bar, done, total):
        told.append((done, total))
        show(bar, done, total)
        if done == 2 and len(told) > 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(Bar, "show", stop)
    assert run(["reproduce", "--out", str(out), "--workers", "1"]) == 130
    assert "the same command goes on" in capsys.readouterr().err
    assert told == [(0, 3), (1, 3), (2, 3)] and not list((out / "models").glob("*.json"))
    told.clear()
    assert run(["reproduce", "--out", str(out), "--workers", "1"]) == 0
    assert told == [(2, 3), (3, 3)]
    assert len(list((out / "models").glob("*.json"))) == 4 and not (out / "models" / ".flights").exists()
