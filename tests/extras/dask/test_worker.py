"""A worker process in a new interpreter."""

import pytest

from mavfi.campaign.executors.executor import Done
from mavfi.campaign.executors.process import Raised
from mavfi.extras.dask.worker import start_worker


def count_to(number):
    yield from range(number)


def items(worker):
    taken = worker.take()
    while not isinstance(taken[-1], (Done, Raised)):
        taken += worker.take()
    return taken


@pytest.mark.slow
def test_it_takes_one_mission_after_the_other(monkeypatch, request):
    monkeypatch.setenv("PYTHONPATH", str(request.config.rootpath), prepend=":")
    worker = start_worker(count_to)
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
    worker = start_worker(count_to)
    try:
        worker.give(1)
        [raised] = items(worker)
        assert "workers cannot import what they should call: No module named 'tests'" in str(raised.error)
    finally:
        worker.end()
