"""Places of dynamic instructions: uniform over calls, and block executions found by number."""

import numpy as np

from mavfi.faults.levels.instruction import choose, count, resolve
from mavfi.faults.levels.instruction.variant import Passes, variant_for
from tests.core.unit.faults.instruction.kernels import LOOP, loop


def test_every_pass_through_every_block_begins_where_resolving_finds_it():
    variant = variant_for(loop, LOOP)
    total = count(loop, *LOOP)
    sites = resolve(loop, range(total), *LOOP)
    passed, expected = {}, {}
    for index, site in enumerate(sites):
        if site.offset == 0:
            number = passed.get(site.block, 0)
            expected[site.block, number] = index
            passed[site.block] = number + 1
    passes = Passes(len(variant.table.blocks), expected)
    assert variant.locate(passes, *LOOP) == loop(*LOOP)
    assert {place: passes.start(*place) for place in expected} == expected
    assert len(expected) > 40


def test_calls_are_drawn_with_the_weight_of_their_counts():
    counts = [10, 0, 1000, 10]
    drawn = choose(np.random.default_rng(1), counts, 5_000)
    calls = np.bincount([call for call, _ in drawn], minlength=4)
    assert calls[1] == 0
    assert abs(calls[2] - 5_000 * 1000 / 1020) < 200
    assert all(0 <= index < counts[call] for call, index in drawn)
    assert {index for call, index in drawn if call == 0} == set(range(10))
