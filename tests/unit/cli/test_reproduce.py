import pytest

from mavfi.campaign.config import Campaign
from mavfi.cli import reproduce, run


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
    assert run(arguments) == 0
