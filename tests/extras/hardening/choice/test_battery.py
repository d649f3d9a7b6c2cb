"""Injections into recorded calls: drawn uniformly, repeatable, and without effect on the arguments."""

from collections import Counter

import numpy as np
import pytest

from mavfi.extras.hardening.battery import MASKED, SDC, Battery, counts_of
from mavfi.faults.levels.instruction.variant import variant_for
from tests.extras.hardening.choice.kernels import calls, smooth


@pytest.fixture(scope="module")
def battery():
    own = calls()
    return Battery("smooth", smooth, variant_for(smooth, own[0]), own)


def test_places_are_uniform_over_dynamic_instructions(battery):
    places = battery.draw(np.random.default_rng(1), 4000)
    by_call = Counter(place.call for place in places)
    expected = battery.counts / battery.counts.sum()
    assert all(abs(by_call[call] / 4000 - share) < 0.03 for call, share in enumerate(expected))
    assert all(place.number < battery.executions[place.call, place.block] for place in places)
    assert all(place.bit < battery.site(place.block, place.offset).width for place in places)


def test_injections_have_effects_and_can_be_repeated(battery):
    places = battery.draw(np.random.default_rng(5), 30)
    before = [(values.copy(), out.copy()) for values, out in battery.calls]
    effects = battery.run(places)
    assert effects == battery.run(places)
    counted = counts_of(effects)
    assert counted[SDC] > 0 and counted[MASKED] > 0 and sum(counted.values()) == 30
    np.testing.assert_equal([tuple(args) for args in battery.calls], before)


def test_a_shared_process_gives_the_effects_of_one_process_each(battery):
    places = battery.draw(np.random.default_rng(9), 30)
    shared = battery.run(places)
    assert "crash" in shared  # after which the other faults of the call run in a new process
    assert [battery.run([place])[0] for place in places] == shared
