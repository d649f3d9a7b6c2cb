import pytest

from mavfi.campaign.executors.local import LocalExecutor
from mavfi.cli.commands import run
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import small
from tests.extras.paper.test_failure_views import campaign


@pytest.fixture
def ledger(tmp_path, monkeypatch):
    """A folder whose runs are those made by hand."""
    monkeypatch.setattr("mavfi.analysis.runs.Runs.read", lambda _: campaign())
    return str(tmp_path)


def test_the_answer_comes_first_and_the_assumptions_after_it(ledger, capsys):
    assert run(["failures", ledger]) == 0
    text = capsys.readouterr().out
    rates = text.partition("Does ")[0]
    assert "[" in rates and "[-" not in rates, "no rate is below none"
    assert text.startswith("Failures per flight hour, sparse: fi ")
    assert text.index("dr_gaussian") < text.index("JESD89A")


def test_bad_input_is_one_line(tmp_path, capsys):
    run_campaign(small(missions=1, faults=1), tmp_path, executor=LocalExecutor(1))
    capsys.readouterr()
    assert run(["failures", str(tmp_path)]) == 2
    assert "holds faults of level state; allowed: a campaign with faults in instructions" in capsys.readouterr().err
    assert run(["failures", str(tmp_path), "--upsets", "space"]) == 2
    assert "upset 'space': not known; allowed: low_altitude" in capsys.readouterr().err
