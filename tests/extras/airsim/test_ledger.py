"""Commands on the ledger of a program's campaign: its runs are no flights, so they can be repeated but not drawn."""

import importlib.util

import pytest

from mavfi.analysis.runs import Runs
from mavfi.cli import run

PROGRAM = """
import airsim
client = airsim.MultirotorClient()
client.enableApiControl(True)
client.takeoffAsync().join()
client.moveToZAsync(-3.0, 2.0).join()
"""
CAMPAIGN = """
host: airsim_program
name: short
program: {script: SCRIPT, golden_runs: 1}
environments: [sparse]
missions: 1
sampling: {level: message, sides: [arguments, return]}
null_runs: 0
faults: 2
"""
"""`SCRIPT`: path of the program."""


@pytest.fixture(scope="module")
def ledger(tmp_path_factory):
    folder = tmp_path_factory.mktemp("program")
    (folder / "program.py").write_text(PROGRAM)
    (folder / "short.yaml").write_text(CAMPAIGN.replace("SCRIPT", str(folder / "program.py")))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MAVFI_ALLOW_PLUGINS", "all")
        assert run(["campaign", "run", str(folder / "short.yaml"), "--out", str(folder / "out")]) == 0
    return folder / "out"


def run_ids(ledger):
    """The golden run first."""
    return Runs.read(ledger).frame["run_id"].to_list()


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("cosysairsim") is None, reason="needs the package cosysairsim"),
]


def test_runs_are_repeated_bit_for_bit(ledger, monkeypatch, capsys):
    monkeypatch.setenv("MAVFI_ALLOW_PLUGINS", "all")
    golden, first, *_ = run_ids(ledger)
    for run_id in (golden, first):
        assert run(["replay", str(ledger), run_id]) == 0
        assert "✓ the same run, bit for bit" in capsys.readouterr().out
    assert run(["campaign", "verify", str(ledger), "--share", "1"]) == 0
    assert "all records equal" in capsys.readouterr().out


def test_another_program_than_that_of_the_campaign_is_refused(ledger, monkeypatch, capsys):
    monkeypatch.setenv("MAVFI_ALLOW_PLUGINS", "all")
    golden, *_ = run_ids(ledger)
    program = ledger.parent / "program.py"
    program.write_text(PROGRAM + "# changed\n")
    try:
        assert run(["replay", str(ledger), golden]) == 2
    finally:
        program.write_text(PROGRAM)
    assert f"{program}: is absent, or another program" in capsys.readouterr().err


def test_its_program_is_not_run_unless_allowed(ledger, monkeypatch, capsys):
    monkeypatch.delenv("MAVFI_ALLOW_PLUGINS", raising=False)
    golden, *_ = run_ids(ledger)
    assert run(["replay", str(ledger), golden]) == 2
    assert "named in a file, and so not run" in capsys.readouterr().err


def test_what_needs_a_flight_is_refused_in_one_line(ledger, monkeypatch, capsys):
    monkeypatch.setenv("MAVFI_ALLOW_PLUGINS", "all")
    _, first, *_ = run_ids(ledger)
    assert run(["export", str(ledger), first, "--to", "flight.mcap"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "its publications cannot be recorded; allowed: faults of level" in line
