"""Memory of workers over many flights stays as it is."""

import mmap
import os

import pytest

from benchmarks.memory import MOST_GROWTH_KIB, Look, campaign_of, fly, growth, resident_kib

ROOM_KIB = 16 * 1024
"""Growth of a worker in a few missions that is no leak: caches of environments and of compiled code fill."""


def test_growth_is_that_of_the_second_half():
    filling = [Look(runs, 1000.0 + 100.0 * runs, 0.0) for runs in range(0, 100, 10)]
    flat = [Look(runs, 11_000.0, 0.0) for runs in range(100, 200, 10)]
    assert growth([*filling, *flat]) == pytest.approx(0.0, abs=1e-6)
    assert growth(filling) == pytest.approx(100 * 100.0)
    assert growth(filling) > MOST_GROWTH_KIB


def test_memory_is_that_of_a_process():
    before = resident_kib(os.getpid())
    with mmap.mmap(-1, 64 * 2**20) as held:  # not of the heap, which may have as much to spare
        for page in range(0, len(held), mmap.PAGESIZE):
            held[page] = 1
        assert 60 * 1024 < resident_kib(os.getpid()) - before < 80 * 1024
    assert resident_kib(2**22 + 1) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("level", "runs"), [("state", 60), ("instruction", 30)])
def test_a_worker_that_flies_mission_after_mission_keeps_its_size(level, runs):
    seen = fly(campaign_of(level, runs))
    assert len(seen) >= 10 and seen[-1].runs >= runs
    assert seen[-1].memory_kib - seen[len(seen) // 3].memory_kib < ROOM_KIB
