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
    assert text.startswith("sparse, fi: ") and "(10 faults); without a fault 0 of 10 missions" in text
    assert text.index("dr_gaussian") < text.index("JESD89A")


def test_a_target_is_answered_without_the_table(ledger, capsys):
    assert run(["failures", ledger, "--show", "1e-7"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("sparse, fi: fewer than 1e-07 failures per flight hour: shown, at most ")
    assert "What widens the bound most: " in text and "instructions/h" not in text
    assert run(["failures", ledger, "--show", "0"]) == 2
    assert "--show: 0.0: allowed: 1e-30 to 1e+06" in capsys.readouterr().err


def test_bad_input_is_one_line(tmp_path, capsys):
    run_campaign(small(missions=1, faults=1), tmp_path, executor=LocalExecutor(1))
    capsys.readouterr()
    assert run(["failures", str(tmp_path)]) == 2
    assert "holds faults of level state; allowed: a campaign with faults in instructions" in capsys.readouterr().err
    assert run(["failures", str(tmp_path), "--upsets", "space"]) == 2
    assert "upset 'space': not known; allowed: low_altitude" in capsys.readouterr().err
