"""Memory of workers over many flights stays as it is."""

import numpy as np
import pytest

from benchmarks.memory import MOST_GROWTH_KIB, Look, campaign_of, fly, growth

MOST_GROWTH_OF_A_FEW_KIB = 8 * MOST_GROWTH_KIB
"""Growth in tens of missions that is no leak (KiB per 100 runs): the caches of environments still fill."""


def test_growth_is_that_of_the_second_half():
    filling = [Look(runs, 1000.0 + 100.0 * runs, 0.0) for runs in range(0, 100, 10)]
    flat = [Look(runs, 11_000.0, 0.0) for runs in range(100, 200, 10)]
    assert growth([*filling, *flat]) == pytest.approx(0.0, abs=1e-6)
    assert growth(filling) == pytest.approx(100 * 100.0)
    assert growth(filling) > MOST_GROWTH_KIB


def test_a_single_step_is_no_growth_and_a_leak_under_noise_is():
    missions = range(60)
    step = [Look(20 * mission, 500_000.0 + 17_000.0 * (mission > 45), 0.0) for mission in missions]
    assert growth(step) == pytest.approx(0.0, abs=1e-6)
    noise = np.random.default_rng(0).normal(0.0, 200.0, len(missions))
    leak = [Look(20 * mission, 500_000.0 + 400.0 * mission + noise[mission], 0.0) for mission in missions]
    assert growth(leak) == pytest.approx(2000.0, rel=0.2)
    assert growth(leak) > MOST_GROWTH_KIB


@pytest.mark.long  # 90 missions
@pytest.mark.parametrize(("level", "runs"), [("state", 60), ("instruction", 30)])
def test_a_worker_that_flies_mission_after_mission_keeps_its_size(level, runs):
    seen = fly(campaign_of(level, runs))
    assert len(seen) >= 10 and seen[-1].runs >= runs
    assert growth(seen) < MOST_GROWTH_OF_A_FEW_KIB
