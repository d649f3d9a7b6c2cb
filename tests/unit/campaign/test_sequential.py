from dataclasses import replace

import numpy as np
import pytest

from mavfi.campaign.analysis import Runs, table
from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.run import run_campaign, status
from mavfi.campaign.sequential import ALPHA, cell_of, half_width, log_mixture, missions_needed, sequence_bounds, until
from mavfi.campaign.shard import Shard
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from tests.unit.campaign.fakes import small

CAMPAIGNS, MISSIONS = 1000, 1500


def simulated(rate, alike, flights=3, seed=7):
    """Shares of successes of missions. Shape (CAMPAIGNS, MISSIONS).

    A mission's own rate is drawn from a beta distribution; `alike` is the correlation of its flights.
    """
    random = np.random.default_rng(seed)
    spread = (1 - alike) / alike
    own = random.beta(rate * spread, (1 - rate) * spread, (CAMPAIGNS, MISSIONS))
    return random.binomial(flights, own) / flights


@pytest.mark.parametrize(("rate", "alike"), [(0.5, 0.2), (0.9, 0.3), (0.97, 0.5), (0.85, 0.95)])
def test_95_of_100_campaigns_hold_the_truth_at_every_look(rate, alike):
    total, n = np.cumsum(simulated(rate, alike), axis=1), np.arange(1, MISSIONS + 1)
    held = (log_mixture(total, n, rate) < np.log(1 / ALPHA)).all(axis=1)
    assert held.mean() >= 0.95


def test_looking_after_every_mission_would_break_an_interval_of_fixed_n():
    total, n = np.cumsum(simulated(0.5, 0.95), axis=1), np.arange(1, MISSIONS + 1)
    mean, half = total / n, 1.96 * np.sqrt(0.25 / n)
    assert (np.abs(mean - 0.5) <= half)[:, 10:].all(axis=1).mean() < 0.7


def test_campaigns_that_stop_at_their_half_width_hold_the_truth():
    shares, target = simulated(0.9, 0.3), 0.05
    total, n = np.cumsum(shares, axis=1), np.arange(1, MISSIONS + 1)
    looks = n % 25 == 0
    low, high = sequence_bounds(total[:, looks], n[looks])
    narrow = (high - low) / 2 <= target
    assert narrow.any(axis=1).all(), "every campaign stops"
    stop = narrow.argmax(axis=1)
    rows = np.arange(CAMPAIGNS)
    held = (low[rows, stop] <= 0.9) & (high[rows, stop] >= 0.9)
    assert held.mean() >= 0.95


def test_bounds():
    low, high = sequence_bounds([0.0, 50.0, 100.0, 0.0], [100, 100, 100, 0])
    assert low[0] == 0.0 and high[2] == pytest.approx(1.0) and high[0] == pytest.approx(1 - low[2])
    assert low[1] < 0.5 < high[1] and (low[3], high[3]) == (0.0, 1.0)
    for bound in (low[1], high[1]):
        assert log_mixture(50.0, 100, bound) == pytest.approx(np.log(1 / ALPHA))


@pytest.mark.parametrize("target", [0.25, 0.2, 0.05, 0.02])
def test_the_most_missions_are_enough_for_every_rate_and_one_less_is_not(target):
    n = missions_needed(target)
    assert half_width(np.linspace(0, n, 1001), n).max() <= target * 1.001
    assert half_width(np.linspace(0, n - 1, 1001), n - 1).max() > target * 0.999


def test_what_counts_in_which_rate():
    table1, kernels, states = (load_campaign(name) for name in ("table1", "kernels", "states"))
    from tests.unit.campaign.analysis.handmade import FAULT, INSTRUCTION, golden, injected, null

    assert cell_of(table1, golden(1).spec) == ("golden", "", "")
    assert cell_of(table1, injected(1, None, FAULT).spec) == ("fi", "", "")
    assert cell_of(kernels, injected(1, None, INSTRUCTION, target="pid").spec) == ("fi", "pid", "")
    yaw = ("fi", "waypoint yaw", "")
    for stratum, cell in (("sign", yaw), ("exponent", yaw), ("mantissa", None)):
        fault = replace(FAULT, stratum=stratum)
        assert cell_of(states, injected(1, None, fault, target="waypoint yaw").spec) == cell, "states as in Fig. 4"
    assert cell_of(table1, null(1, None).spec) is None
    memory = load_campaign("memory")
    by_class = memory.model_copy(
        update={"sampling": memory.sampling.model_copy(update={"strata": states.sampling.strata, "groups": ()})}
    )
    assert cell_of(by_class, injected(1, None, FAULT).spec) == ("fi", "", "sign_exponent")


def test_a_campaign_ends_when_its_rates_are_known_and_resumes_to_the_same(tmp_path):
    campaign = until(small(missions=10, faults=10, environments=["sparse"]), 0.25)
    assert campaign.missions == campaign.faults == missions_needed(0.25)
    found = run_campaign(campaign, tmp_path, executor=LocalExecutor(2))
    assert found.complete
    with Store.open(tmp_path) as store:
        flown = len(store.planned())
    assert 3 < flown < campaign.total_missions
    rows = table(Runs.read(tmp_path), "sequence").entries()
    assert max(row["half_width"] for row in rows) <= 0.25
    assert {row["environment"] for row in rows} == set(campaign.environments)
    again = run_campaign(campaign, tmp_path, executor=LocalExecutor(2))
    assert (again.done, again.total) == (found.done, found.total) == (status(tmp_path).done, status(tmp_path).total)


def test_what_cannot_be_flown_in_sequence_is_refused(tmp_path):
    with pytest.raises(BadInputError, match="not with until_halfwidth; allowed: the whole campaign"):
        run_campaign(until(small(), 0.3), tmp_path, shard=Shard(1, 2))
    with pytest.raises(BadInputError, match="campaign states: half-width 0.01: needs up to .* faults per target"):
        until(load_campaign("states").model_copy(update={"missions": 10}), 0.01)
    with pytest.raises(ValueError, match="until_halfwidth"):
        Campaign.model_validate({"name": "a", "environments": ["sparse"], "until_halfwidth": 0.001})
