"""The log next to the ledger says what happened to missions, workers and the machine, and never stops a campaign."""

import errno
import json
import os
import signal
from datetime import UTC, datetime

import pytest

from mavfi.campaign import log as log_module
from mavfi.campaign import run as session_module
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.fingerprint import versions
from mavfi.campaign.log import FILE, Log
from mavfi.campaign.store import Store
from mavfi.errors import MachineError
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import TROUBLE, failures, small

TOTAL = 2 * (2 * (4 + 18) + 3)


def flown_into(directory, campaign=None, workers=1, **options):
    return run_campaign(campaign or small(), directory, executor=LocalExecutor(workers), **options)


def events(directory, name=None):
    entries = map(json.loads, (directory / FILE).read_bytes().splitlines())
    return [entry for entry in entries if name in (None, entry["event"])]


def digest(directory):
    with Store.open(directory) as store:
        return store.digest()


def test_a_session_logs_its_start_and_its_end(tmp_path):
    before = datetime.now(UTC)
    flown_into(tmp_path, workers=2)
    begin, *missions, end = events(tmp_path)
    assert datetime.fromisoformat(begin["time"]) >= before.replace(microsecond=0)
    assert begin["time"].endswith("+00:00")
    assert begin["versions"] == versions() and begin["campaign"] == "small"
    assert (begin["workers"], begin["runs_left"]) == (2, TOTAL)
    assert (end["event"], end["why"], end["done"], end["unknown"]) == ("end", "complete", TOTAL, 0)
    assert end["digest"] == digest(tmp_path)
    ended = [entry for entry in missions if entry["event"] == "mission_end"]
    assert len(missions) == 16 and len({entry["mission"] for entry in ended}) == 8
    assert sum(entry["runs"] for entry in ended) == TOTAL
    assert all(entry["worker_peak_mib"] > 10 for entry in ended), "workers report their memory"


def test_a_campaign_that_is_resumed_continues_the_same_log(tmp_path):
    def interrupt(progress):
        if progress.flown == 30:
            os.kill(os.getpid(), signal.SIGINT)
            signal.sigtimedwait([], 5)

    with pytest.raises(KeyboardInterrupt):
        flown_into(tmp_path, progress=interrupt)
    (end,) = events(tmp_path, "end")
    assert (end["why"], end["total"]) == ("stopped", TOTAL) and "digest" not in end
    assert 30 <= end["done"] <= 50, "runs are kept in batches"
    flown_into(tmp_path)
    assert [entry["runs_left"] for entry in events(tmp_path, "begin")] == [TOTAL, TOTAL - end["done"]]
    assert [entry["why"] for entry in events(tmp_path, "end")] == ["stopped", "complete"]


def test_failures_of_the_machine_are_named_with_their_reason(tmp_path, monkeypatch):
    monkeypatch.setattr(session_module, "PAUSE_S", 0.0)
    monkeypatch.setattr(TROUBLE, "machine", failures(tmp_path / "failures", errno.ENOSPC, 1))
    flown_into(tmp_path / "once")
    (retry,) = events(tmp_path / "once", "retry")
    assert retry["attempt"] == 1 and "No space left on device" in retry["reason"]
    begun = [entry["mission"] for entry in events(tmp_path / "once", "mission_begin")]
    assert max(map(begun.count, begun)) == 2, "the one that it stopped begins again"
    monkeypatch.setattr(TROUBLE, "machine", failures(tmp_path / "more", errno.ENOSPC, 1000))
    with pytest.raises(MachineError):
        flown_into(tmp_path / "always")
    assert [entry["attempt"] for entry in events(tmp_path / "always", "retry")] == [1, 2, 3, 4]
    (end,) = events(tmp_path / "always", "end")
    assert end["why"] == "failed" and "No space left on device" in end["reason"]


def test_runs_with_status_unknown_are_named_up_to_a_number(tmp_path, monkeypatch):
    monkeypatch.setattr(TROUBLE, "raises", True)
    monkeypatch.setattr(log_module, "MOST_UNKNOWN", 3)
    status = flown_into(tmp_path)
    assert status.unknown > 3
    named = events(tmp_path, "unknown")
    assert len(named) == 3
    assert named[0]["error"] == "ZeroDivisionError"
    assert ":FakeHost: ZeroDivisionError: a mistake of ours (fakes.py:" in named[0]["reason"]
    assert events(tmp_path, "end")[0]["unknown"] == status.unknown


@pytest.mark.parametrize("trouble", ["a folder", "a full disk"])
def test_a_log_that_cannot_be_written_does_not_stop_a_campaign(tmp_path, trouble):
    flown_into(tmp_path / "whole")
    (tmp_path / "out").mkdir()
    if trouble == "a folder":
        (tmp_path / "out" / FILE).mkdir()
    else:
        (tmp_path / "out" / FILE).symlink_to("/dev/full")
    assert flown_into(tmp_path / "out").complete
    assert digest(tmp_path / "out") == digest(tmp_path / "whole")


def test_the_line_after_one_that_was_cut_off_is_whole(tmp_path):
    (tmp_path / FILE).write_bytes(b'{"time": "2026-01-01", "event": "begin"}\n[1]\n{"time": "2026\xff')
    Log(tmp_path).note("end", why="x" * 10_000)
    lines = (tmp_path / FILE).read_bytes().splitlines()
    last = json.loads(lines[-1])
    assert len(lines) == 4 and last["event"] == "end" and len(last["why"]) == 500
