"""Memory of workers over many flights stays as it is."""

import pytest

from benchmarks.memory import MOST_GROWTH_KIB, campaign_of, fly, growth

MOST_GROWTH_OF_A_FEW_KIB = 8 * MOST_GROWTH_KIB
"""Growth in tens of missions that is no leak (KiB per 100 runs): the caches of environments still fill."""


@pytest.mark.long  # 90 missions
@pytest.mark.parametrize(("level", "runs"), [("state", 60), ("instruction", 30)])
def test_a_worker_that_flies_mission_after_mission_keeps_its_size(level, runs):
    seen = fly(campaign_of(level, runs))
    assert len(seen) >= 10 and seen[-1].runs >= runs
    assert growth(seen) < MOST_GROWTH_OF_A_FEW_KIB
