"""Dask workers give what local ones give; whatever dies there loses nothing."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mavfi.campaign import fingerprint
from mavfi.campaign.executors.executor import Done, Lost
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError, MachineError
from mavfi.extras.dask import executor as dask
from mavfi.extras.dask.executor import DaskExecutor
from tests.campaigns import run_campaign
from tests.core.unit.campaign.executors.test_local import count_to, die, flat, hang, items_of
from tests.core.unit.campaign.fakes import small

ROOT = Path(__file__).parents[3]
pytest.importorskip("distributed", reason="needs the extra `cluster`")
pytestmark = pytest.mark.slow


def dask_process(folder, role, *arguments):
    """A scheduler or a worker on the loopback interface."""
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    here = ("--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0")
    return subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.dask_{role}", *arguments, *here],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
    )


@contextlib.contextmanager
def dask_cluster(folder, count):
    """A scheduler with its address, and workers, all of them processes of their own, and these."""
    file = folder / "scheduler.json"
    processes = [dask_process(folder, "scheduler", "--port", "0", "--scheduler-file", str(file))]
    try:
        while not file.is_file():
            assert processes[0].poll() is None
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        processes += [dask_process(folder, "worker", address, "--nthreads", "1") for _ in range(count)]
        yield address, processes[0]
    finally:
        for child in reversed(processes):
            child.terminate()
            child.wait(20)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Address of a scheduler with two workers, and a client of it."""
    from distributed import Client

    with (
        dask_cluster(tmp_path_factory.mktemp("cluster"), 2) as (address, _),
        Client(address, set_as_default=False) as client,
    ):
        client.wait_for_workers(2, timeout=120)
        yield address, client


@pytest.fixture
def executor(cluster):
    return DaskExecutor(cluster[0])


def test_what_a_mission_gives_comes_in_its_order_and_ends_with_done(executor):
    results = flat(executor.map(count_to, range(9)))
    for number in range(9):
        assert items_of(results, number) == [*range(number), Done()]


def test_items_are_handed_over_while_the_mission_continues(executor):
    results = executor.map(hang, [60.0])
    assert next(results) == (60.0, ["begun"])
    started = time.monotonic()
    results.close()
    assert flat(executor.map(count_to, [1])) == [(1, 0), (1, Done())]
    # a guard against waiting for all of the 60 s, not a measurement
    assert time.monotonic() - started < 30.0, "what was left is not flown to its end"


def test_a_flight_that_dies_loses_its_mission_only(executor):
    missions = [(number, signal.SIGSEGV if number == 2 else None) for number in range(1, 5)]
    results = flat(executor.map(die, missions))
    lost = Lost("its worker died (SIGSEGV)", died=True, signal="SIGSEGV")
    for number, how in missions:
        assert items_of(results, (number, how))[-1] == (lost if how else Done())


def _children(pid):
    return [int(child) for path in Path(f"/proc/{pid}/task").glob("*/children") for child in path.read_text().split()]


def test_a_campaign_has_the_ledger_that_local_workers_leave(executor, tmp_path):
    run_campaign(small(), tmp_path / "local")
    run_campaign(small(), tmp_path / "dask", executor=executor)
    with Store.open(tmp_path / "local") as local, Store.open(tmp_path / "dask") as there:
        assert there.complete and there.digest() == local.digest()


def test_workers_with_other_code_are_refused(executor, monkeypatch):
    here = dict(fingerprint.fingerprint())
    monkeypatch.setattr(dask, "fingerprint", lambda: {**here, "code": "another" * 9})
    with pytest.raises(
        BadInputError, match=r"Dask worker tcp://127.0.0.1:\d+: has code [0-9a-f]{12}, the campaign ano"
    ):
        flat(executor.map(count_to, [1]))


@pytest.mark.long
def test_without_an_address_it_has_a_cluster_here_that_listens_on_the_loopback_interface_only():
    code = """
import os
from mavfi.extras.dask.executor import DaskExecutor
from tests.extras.dask.test_executor import look_for_sockets
print(list(DaskExecutor(workers=1).map(look_for_sockets, [os.getpid()])))
"""  # in a process of its own: multiprocessing leaves a child behind that tracks resources
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "[['0100007F']" in done.stdout and "Done(" in done.stdout


def look_for_sockets(campaign):
    """Addresses on which the processes of a campaign listen."""
    lines = [
        line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]
    ]
    held = {link for pid in _family(campaign) for link in _sockets(pid)}
    yield sorted({line[1].split(":")[0] for line in lines if line[3] == "0A" and f"socket:[{line[9]}]" in held})


def _family(pid):
    return [pid, *(member for child in _children(pid) for member in _family(child))]


def _sockets(pid):
    try:
        folder = f"/proc/{pid}/fd"
        return {link for link in (os.readlink(f"{folder}/{name}") for name in os.listdir(folder)) if "socket" in link}
    except OSError:
        return set()


def test_an_address_where_nobody_answers_is_one_line(monkeypatch):
    monkeypatch.setattr(dask, "_PATIENCE_S", 1.0)
    with pytest.raises(BadInputError, match="--scheduler: tcp://127.0.0.1:9: no scheduler answers"):
        flat(DaskExecutor("tcp://127.0.0.1:9").map(count_to, [1]))


@pytest.mark.long
def test_a_scheduler_that_dies_is_a_failure_of_the_machine_in_one_line(tmp_path, monkeypatch):
    with dask_cluster(tmp_path, 1) as (address, scheduler):
        executor = DaskExecutor(address)
        results = executor.map(hang, [60.0])
        assert next(results) == (60.0, ["begun"])
        scheduler.kill()
        monkeypatch.setattr(dask, "_PATIENCE_S", 2.0)
        for retry in (results, executor.map(hang, [60.0])):
            with pytest.raises(MachineError, match="^the Dask scheduler is gone"):
                flat(retry)


@pytest.mark.long
def test_a_worker_that_is_killed_while_the_cluster_starts_is_a_failure_of_the_machine(monkeypatch):
    """Found by a signal at this instant: a traceback.  Failures of the machine are tried again."""

    def killed(**_):
        raise RuntimeError("Nanny failed to start.")

    monkeypatch.setattr("distributed.LocalCluster", killed)
    with pytest.raises(MachineError, match=r"^the local Dask cluster did not start \(Nanny failed to start.\)$"):
        next(DaskExecutor().map(count_to, [1]))
