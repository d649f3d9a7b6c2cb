from collections import Counter

import numpy as np
import pytest
from scipy.stats import chisquare

from mavfi.faults.sampling import share_out
from mavfi.levels.state.drawing import draw, stage_target
from mavfi.record import Profile
from mavfi.states import STATES

DRAWS = 3000
AUTOPILOT = "published"
LENGTHS = {name: 3 + 2 * place for place, name in enumerate(STATES)}
PROFILE = Profile(
    {name: np.arange(n, dtype=np.int64) * 10 for name, n in LENGTHS.items()},
    {name: np.full(n, 4 if STATES[name].elements else 0, np.int32) for name, n in LENGTHS.items()},
)


@pytest.fixture(scope="module", params=["perception", "planning", "control"])
def drawn(request):
    target = stage_target(request.param, AUTOPILOT)
    return target, [draw(target, "sign_exponent", PROFILE, seed, 0) for seed in range(DRAWS)]


def uniform(counts: Counter, size: int) -> bool:
    """Whether counts over `size` classes could come from a uniform law (a false alarm in 10,000 laws)."""
    assert len(counts) == size, "every class is reached"
    return size == 1 or chisquare(list(counts.values())).pvalue > 1e-4


def test_states_are_uniform(drawn):
    target, faults = drawn
    assert uniform(Counter(fault.where.state for fault in faults), len(target.fields))


def test_fields_are_uniform_within_their_state_and_none_is_dead(drawn):
    target, faults = drawn
    for state, names in target.fields.items():
        faults_of_state = [fault for fault in faults if fault.where.state == state]
        assert uniform(Counter(fault.where.field for fault in faults_of_state), len(names))
        assert not any(STATES[state].find(fault.where.field).dead_in(AUTOPILOT) for fault in faults_of_state)


def test_publications_elements_and_bits_are_uniform(drawn):
    target, faults = drawn
    for state in target.fields:
        faults_of_state = [fault for fault in faults if fault.where.state == state]
        assert uniform(Counter(fault.time_us for fault in faults_of_state), LENGTHS[state])
        elements = Counter(fault.where.element for fault in faults_of_state if fault.where.element is not None)
        assert not elements or uniform(elements, 4)
        doubles = Counter(f.bit for f in faults_of_state if STATES[state].find(f.where.field).dtype == "f8")
        assert not doubles or uniform(doubles, 12)


def test_the_two_strata_estimate_the_mean_over_whole_words():
    """A property of the bit alone, known exactly: the weighted estimate from both strata must find it."""
    target = stage_target("control", AUTOPILOT)
    estimate = 0.0
    for stratum in ("sign_exponent", "mantissa"):
        faults = [draw(target, stratum, PROFILE, seed, 1) for seed in range(DRAWS)]
        estimate += float(np.mean([fault.weight * (fault.bit % 3 == 0) for fault in faults]))
    assert estimate == pytest.approx(22 / 64, abs=0.02)


@pytest.mark.parametrize("count", [1, 2, 3, 30, 100])
def test_strata_get_their_shares_in_a_drawn_order(count):
    strata = share_out({"sign_exponent": 2, "mantissa": 1}, count, 10_000, "planning")
    assert len(strata) == count
    assert abs(strata.count("sign_exponent") - count * 2 / 3) < 1
    assert strata == share_out({"sign_exponent": 2, "mantissa": 1}, count, 10_000, "planning")


def test_the_order_of_strata_differs_between_targets_and_environments():
    orders = {
        tuple(share_out({"a": 1, "b": 1}, 20, 10_000, environment, name))
        for environment in ("sparse", "dense")
        for name in ("perception", "planning", "control")
    }
    assert len(orders) == 6
