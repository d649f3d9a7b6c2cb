"""The pages of `mavfi serve`, called without a network: who gets them, what is on them, what happens to ledgers."""

import re
import shutil
import subprocess
import sys
from contextlib import closing

import pytest

from mavfi.campaign.store import LOCK, Store
from mavfi.cli import run
from mavfi.extras.serve.flights import RunKey
from mavfi.extras.serve.ledgers import ServedLedger
from tests.extras.serve.conftest import TOKEN, FlightsHere, WaitingFlights, client_of

ADDRESSES = ["/", "/row/first", "/campaign/first", "/state/first", "/flight/first?run=x", "/compare"]


def files(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


@pytest.mark.parametrize("address", ADDRESSES)
def test_nobody_gets_a_page_without_the_token(stranger, address):
    assert stranger.get(address).status_code == 403
    assert stranger.get(address, params={"token": "another"}).status_code == 403


def test_the_token_moves_from_the_address_to_a_cookie(stranger):
    moved = stranger.get("/", params={"token": TOKEN}, follow_redirects=False)
    assert moved.status_code == 303
    assert "token" not in moved.headers["location"]
    cookie = moved.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert stranger.get("/").status_code == 200


def test_other_host_names_other_methods_and_other_sites_get_nothing(client):
    assert client.get("/", headers={"Host": "attacker.example"}).status_code == 400
    assert client.post("/").status_code == 405
    answer = client.get("/", headers={"Origin": "http://attacker.example"})
    assert not any(name.startswith("access-control") for name in answer.headers)


def test_pages_begin_with_the_answer_and_change_no_file(client, study):
    before = files(study)
    overview = client.get("/").text
    assert re.findall(r'href="/campaign/([^"]+)"', overview) == ["first", "more/second"]
    assert "of 1 missions" in client.get("/row/first").text
    assert "Reading more/second" in client.get("/campaign/more/second").text
    campaign = client.get("/campaign/more/second", headers={"mavfi-waits": "yes"}).text
    assert campaign.index("Without a fault") < campaign.index("2 missions per environment")
    assert client.get("/state/more/second").json()["complete"]
    both = client.get("/compare", params={"first": "first", "second": "more/second"}).text
    assert both.index("B: more/second") < both.index("Findings")
    assert 'href="/campaign/more/second#runs?set=' in both
    assert files(study) == before


def test_an_address_that_names_nothing_says_so(client, study):
    answer = client.get("/campaign/third")
    assert answer.status_code == 404
    assert "third" in answer.text
    assert client.get("/flight/first", params={"run": "none"}).status_code == 404


def test_a_run_that_is_being_flown_is_not_flown_twice(study):
    flights = WaitingFlights()
    once = RunKey(study / "first", "run", "digest", None)
    assert flights.page(once) is flights.page(once)
    assert flights.asked == [once]
    flights.page(once._replace(digest="of another campaign in this folder"))
    assert len(flights.asked) == 2


def test_code_that_a_ledger_names_is_not_run(study, tmp_path, monkeypatch):
    with Store.open(study / "first") as store:
        run_ids = [run.spec.run_id for run in store.runs()]
    monkeypatch.delenv("MAVFI_ALLOW_PLUGINS")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))  # where it is remembered what was allowed before
    client = client_of(study, FlightsHere())
    client.get("/", params={"token": TOKEN})
    for run_id in run_ids:
        answer = client.get("/flight/first", params={"run": run_id})
        assert answer.status_code == 422
        assert "--allow-plugins" in answer.text


def test_a_ledger_is_read_again_when_it_has_changed(study, tmp_path):
    shutil.copytree(study / "first", tmp_path / "copy")
    ledger = ServedLedger(tmp_path / "copy")
    first = ledger.read()
    assert ledger.read() is first
    shutil.copy(study / "more/second/campaign.sqlite", tmp_path / "copy")
    assert ledger.stamp() == first.stamp  # so soon, reading again would take more than its share of time
    ledger._read_until = float("-inf")
    assert ledger.stamp() != first.stamp
    assert len(ledger.read().report.runs) > len(first.report.runs)


def test_a_campaign_is_running_while_a_process_has_its_lock(study, tmp_path):
    shutil.copytree(study / "first", tmp_path / "copy")
    ledger = ServedLedger(tmp_path / "copy")
    assert not ledger.pace().running
    code = "import fcntl, sys; f = open(sys.argv[1], 'w'); fcntl.lockf(f, fcntl.LOCK_EX); print(flush=True); input()"
    command = [sys.executable, "-c", code, str(tmp_path / "copy" / LOCK)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer, closing(writer.stdin):
        writer.stdout.readline()
        assert ledger.pace().running


@pytest.mark.parametrize(
    ("content", "text"), [(None, "holds no campaign"), (b"", "is empty"), (b"not SQLite" * 100, "is not a ledger")]
)
def test_a_folder_without_a_sound_ledger_is_one_line(tmp_path, capsys, content, text):
    if content is not None:
        (tmp_path / "campaign.sqlite").write_bytes(content)
    assert run(["serve", str(tmp_path)]) == 2
    assert text in capsys.readouterr().err


def test_a_port_in_use_is_one_line(study, capsys):
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert run(["serve", str(study), "--port", port]) == 2
    assert capsys.readouterr().err.startswith(f"mavfi: --port: {port}: Address already in use")
