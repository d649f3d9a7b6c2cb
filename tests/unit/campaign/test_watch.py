"""A campaign seen from outside: speed, time left, missions in the air, latest trouble."""

import os
import signal
import subprocess
import sys
import time

import pytest
import yaml

from mavfi.campaign import watch as watch_module
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.log import Log
from mavfi.campaign.outside import is_written
from mavfi.campaign.run import run_campaign, status
from mavfi.campaign.watch import Watch, errors_of, flying_missions, session_of
from mavfi.cli import run
from tests.unit.campaign.fakes import HOST, HURRY, small

SLOW = HOST.replace("FakeHost", "SlowHost")


def entry(event, **fields):
    return {"time": "2026-01-01T00:00:00+00:00", "event": event, **fields}


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    directory = tmp_path_factory.mktemp("flown")
    run_campaign(small(), directory, executor=LocalExecutor(1))
    return directory


@pytest.fixture
def flying(tmp_path):
    """A campaign in another process, slow enough to be watched."""
    content = {"name": "slow", "host": SLOW, "environments": ["sparse"], "missions": 40, "faults": 40, "null_runs": 0}
    (tmp_path / "slow.yaml").write_text(yaml.safe_dump(content))
    command = [sys.executable, "-m", "mavfi", "campaign", "run", str(tmp_path / "slow.yaml"), "--out"]
    process = subprocess.Popen(
        [*command, str(tmp_path / "out"), "--workers", "2"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env={**os.environ, HURRY: str(tmp_path / "hurry")},
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not (tmp_path / "out" / "log.jsonl").is_file() and time.monotonic() < deadline:
        time.sleep(0.05)
    yield tmp_path / "out"
    process.kill()
    process.wait()


@pytest.mark.slow
def test_a_campaign_is_watched_from_outside(flying):
    watch = Watch(flying)
    while not (outlook := watch.look()).in_the_air or outlook.done < 8:
        assert outlook.flying and not outlook.complete
        time.sleep(0.05)
    assert outlook.workers == 2 and 1 <= len(outlook.in_the_air) <= 2
    assert 0 < outlook.rate and 0 < outlook.remaining_s < 60


@pytest.mark.slow
@pytest.mark.parametrize("stop", [True, False])
def test_watching_ends_with_the_campaign_or_with_ctrl_c(flying, stop):
    command = [sys.executable, "-m", "mavfi", "campaign", "status", str(flying), "--watch", "--every", "0.2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as watching:
        out, err = _watched(watching, flying, stop)
    if stop:
        assert (watching.returncode, err) == (130, "Stopped watching; the campaign is left as it is.\n")
        assert is_written(flying)
        return
    assert (watching.returncode, err) == (0, "")
    lines = out.splitlines()
    last = lines[next(i for i, line in enumerate(lines) if line.startswith("160 of 160 runs · complete")) :]
    golden = next(line for line in last if line.startswith("golden"))
    assert golden.split()[:4] == ["golden", "40", "40", "100.0"] and "100.0 % [91.2, 100.0]" in golden


def _watched(watching, flying, stop):
    """Output and errors of the command, whose campaign hurries once its speed was shown."""
    line = watching.stdout.readline()
    assert "of 160 runs" in line
    if stop:
        watching.send_signal(signal.SIGINT)
    else:
        while "runs/s" not in line or "left" not in line:
            assert line, f"the speed was not shown: {watching.stderr.read()}"
            line = watching.stdout.readline()
        (flying.parent / "hurry").touch()
    return watching.communicate(timeout=120)


def test_a_complete_campaign_is_shown_once(capsys, flown):
    assert run(["campaign", "status", str(flown), "--watch"]) == 0
    assert capsys.readouterr().out.startswith("94 of 94 runs · complete\n")
    outlook = Watch(flown).look()
    assert outlook.complete and not outlook.flying and outlook.remaining_s == 0.0 and outlook.in_the_air == ()


def test_a_campaign_that_nobody_flies_has_no_speed(tmp_path):
    def stop(progress):
        if progress.flown == 60:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(small(), tmp_path, executor=LocalExecutor(1), progress=stop)
    outlook = Watch(tmp_path).look()
    assert 60 <= outlook.done == status(tmp_path).done < outlook.total, "runs are kept in batches"
    assert (outlook.flying, outlook.rate, outlook.in_the_air) == (False, 0.0, ())
    assert outlook.remaining_s == float("inf")


def test_asking_whether_a_campaign_is_written_locks_nothing(tmp_path):
    assert not is_written(tmp_path), "there is no ledger"
    run_campaign(small(), tmp_path, executor=LocalExecutor(1))
    code = (
        "import sys; from pathlib import Path; from mavfi.campaign.store import Store\n"
        f"with Store.open(Path({str(tmp_path)!r})) as held: identity = held.meta('identity')\n"
        f"store = Store.create(Path({str(tmp_path)!r}), identity)\n"
        "print('ready', flush=True); sys.stdin.readline()"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer:
        assert writer.stdout.readline() == b"ready\n"
        assert is_written(tmp_path) and is_written(tmp_path)
        writer.stdin.close()
    assert not is_written(tmp_path)


def test_the_rate_is_that_of_the_last_minutes(flown, monkeypatch):
    watch = Watch(flown)
    assert [watch._rate(float(second), 2 * second) for second in (0, 5, 10, 20)] == [0.0, 0.0, 2.0, 2.0]
    assert watch._rate(400.0, 400) == pytest.approx((400 - 40) / 380)


def test_missions_are_in_the_air_until_they_end():
    log = [
        entry("begin"), entry("mission_begin", mission="a"),
        entry("begin", workers=3), *(entry("mission_begin", mission=name) for name in "bcde"),
        entry("mission_end", mission="b"), entry("worker_lost", mission="c", reason="died"),
    ]  # fmt: skip
    assert session_of(log)[0]["workers"] == 3
    assert flying_missions(session_of(log)) == ("d", "e")
    assert flying_missions([*session_of(log), entry("retry", reason="disk")]) == ()


def test_the_latest_trouble_is_shown(tmp_path):
    log = Log(tmp_path)
    for number in range(9):
        log.note("unknown", run=f"run-{number}", reason="a mistake\n of ours")
    log.note("mission_end", mission="a")
    log.note("end", why="failed", reason="disk full")
    found = errors_of(watch_module.entries(tmp_path))
    assert len(found) == 5
    assert found[0].endswith("unknown run-5: a mistake of ours") and found[-1].endswith("end: disk full")


def test_bad_intervals_are_one_line(capsys, flown):
    assert run(["campaign", "status", str(flown), "--watch", "--every", "0"]) == 2
    assert capsys.readouterr().err == "mavfi: --every: 0.0: allowed: 0.1 to 3600\n"
    assert run(["campaign", "status", str(flown), "--watch", "--json"]) == 2
    assert capsys.readouterr().err == "mavfi: --watch: cannot be given with --json\n"
