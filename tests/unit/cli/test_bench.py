import json

import pytest

from mavfi.campaign import overheads
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.run import run_campaign
from mavfi.cli.commands import run
from tests.unit.campaign.fakes import small


@pytest.fixture
def ledger(tmp_path, monkeypatch):
    def cost(scenario, name, profile, models_dir):
        return overheads.Cost(1.0, dict.fromkeys(overheads.STAGES, 0.25), dict.fromkeys(overheads.STAGES, 0.5), 7, 0.0)

    monkeypatch.setattr(overheads, "cost", cost)
    run_campaign(small(missions=2, faults=3), tmp_path, executor=LocalExecutor(1))
    return tmp_path


def test_measured_overheads_are_written_and_shown(ledger, capsys):
    assert run(["bench", "overheads", str(ledger), "--missions", "1", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert {row["stage"] for row in rows} == set(overheads.STAGES)
    assert all(row["measured_detection"] == 0.25 and row["measured_sum"] == 0.75 for row in rows)
    assert len(overheads.load(ledger)["rows"]) == 2 * len(overheads.STAGES), "two environments"
    assert run(["report", str(ledger), "--view", "overheads_as_in_the_paper"]) == 0
    assert "25 %" in capsys.readouterr().out


def test_bad_input_is_one_line(ledger, capsys):
    assert run(["bench", "overheads", str(ledger), "--missions", "0"]) == 2
    assert "--missions: 0: allowed: 1 to 1000" in capsys.readouterr().err
    (ledger / overheads.FILE).write_text("{")
    assert run(["report", str(ledger), "--view", "overheads_as_in_the_paper"]) == 2
