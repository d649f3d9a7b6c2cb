"""A worker with an interpreter of its own."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from mavfi.campaign.executors.executor import Done
from mavfi.campaign.executors.process import Raised, Worker
from tests.core.unit.campaign.executors.test_local import count_to


def items(worker):
    found = worker.take()
    while not isinstance(found[-1], (Done, Raised)):
        found += worker.take()
    return found


@pytest.mark.slow
def test_it_takes_one_mission_after_the_other(monkeypatch, request):
    monkeypatch.setenv("PYTHONPATH", str(request.config.rootpath), prepend=":")
    worker = Worker.started(count_to)
    try:
        for number in (3, 0, 2):
            worker.give(number)
            assert items(worker) == [*range(number), Done()]
    finally:
        worker.end()


@pytest.mark.slow
def test_what_it_cannot_import_is_an_error(monkeypatch):
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.chdir("/")
    worker = Worker.started(count_to)
    try:
        worker.give(1)
        [raised] = items(worker)
        assert "workers cannot import what they should call: No module named 'tests'" in str(raised.error)
    finally:
        worker.end()


PARENT = """
import os, time
import slow
from mavfi.campaign.executors.process import Worker
os.environ["SLOW"] = "60"
worker = Worker.started(slow.function)
time.sleep(1.0)  # it imports the function's module by now
print(worker._process._process.pid)
"""


@pytest.mark.slow
def test_it_is_killed_with_its_parent_even_while_it_imports(tmp_path, monkeypatch):
    """It imports a campaign's modules for seconds, and read its pipe, which was closed, only then."""
    slow = (
        "import os, time\ntime.sleep(float(os.environ.get('SLOW', '0')))\ndef function(mission):\n    return iter(())\n"
    )
    (tmp_path / "slow.py").write_text(slow, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    parent = subprocess.run([sys.executable, "-c", PARENT], capture_output=True, text=True, check=True, timeout=60)
    child = Path(f"/proc/{int(parent.stdout)}/stat")
    deadline = time.monotonic() + 10.0
    while child.exists() and child.read_text().rpartition(")")[2].split()[0] != "Z" and time.monotonic() < deadline:
        time.sleep(0.05)
    assert time.monotonic() < deadline
