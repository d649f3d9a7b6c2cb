"""Runs that are flown again give the records that are stored, or it is said which do not."""

import json

import pytest

from mavfi.campaign.replay import verify
from mavfi.cli import run
from mavfi.errors import BadInputError
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import TROUBLE, small


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    directory = tmp_path_factory.mktemp("campaign")
    run_campaign(small(environments=["dense"], missions=3, faults=3), directory)
    return directory


def test_all_records_come_out_again(directory):
    reports = []
    verification = verify(directory, 1.0, progress=lambda *now: reports.append(now))
    assert verification.flown == verification.runs == 3 * 2 + 9 * 2 + 3 and verification.differing == ()
    assert reports == [(number, verification.runs) for number in range(verification.runs)]


def test_a_share_is_chosen_by_the_seed(directory):
    assert verify(directory, 0.2).flown == 5
    assert verify(directory, 1e-9).flown == 1
    with pytest.raises(BadInputError, match="--share: 0.0: allowed: above 0, 1 at most"):
        verify(directory, 0.0)


def test_a_record_that_differs_is_named(directory, capsys, monkeypatch):
    assert run(["campaign", "verify", str(directory), "--share", "1"]) == 0
    assert "27 of 27 runs replayed, all records equal; at most 11 %" in capsys.readouterr().out
    monkeypatch.setattr(TROUBLE, "stray", 1e-9)
    assert run(["campaign", "verify", str(directory), "--share", "1", "--json"]) == 1
    printed = capsys.readouterr()
    assert len(json.loads(printed.out)["differing"]) == 27
    assert "27 of 27 replayed runs have another record: dense-" in printed.err and printed.err.count("\n") == 1
