"""A worker with an interpreter of its own."""

import pytest

from mavfi.campaign.executors.executor import Done
from mavfi.campaign.executors.process import Raised, Worker
from tests.unit.campaign.executors.test_local import count_to


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
