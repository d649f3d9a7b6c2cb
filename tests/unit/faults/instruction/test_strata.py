"""Stratified draws: exact places, every stratum injected, and rates that are those of the uniform draw."""

from collections import Counter

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.faults.instruction import (
    Locating,
    Profiling,
    Resolving,
    count,
    draw_stratified,
    estimate,
    histogram,
    resolve,
    run_forked,
)
from mavfi.faults.instruction.selection import parse_selection
from mavfi.faults.instruction.strata import REST, StratumKey, allocate, choose, densities, key_of, pick, pooled
from mavfi.faults.instruction.variant import Passes, variant_for
from tests.unit.faults.instruction.kernels import LOOP, MASKING, fill, loop, masking

N = 40
SEEDS = 60
"""Draws of which the mean is held against the truth."""


def numbers():
    return np.linspace(0.0, 4.0, 12)


def sizes_of(executed):
    """Dynamic instructions of each stratum."""
    found = Counter()
    for site, times in executed:
        found[key_of(site)] += times
    return {key: size for key, size in found.items() if size}


# ---- places ---------------------------------------------------------------------------------------------------------
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


def test_passes_are_counted_on_over_calls():
    variant = variant_for(loop, LOOP)
    _, times, _ = variant.profile(*LOOP)
    block = int(np.argmax(times))
    alone = Passes(len(times), [(block, 2)])
    variant.locate(alone, *LOOP)
    passes = Passes(len(times), [(block, 2 + int(times[block])), (block, 3 * int(times[block]))])
    variant.locate(passes, *LOOP)
    assert (passes.starts == -1).all()
    variant.locate(passes, *LOOP)
    assert passes.start(block, 2 + int(times[block])) == alone.start(block, 2)
    assert passes.start(block, 3 * int(times[block])) == -1


def test_faults_lie_in_their_strata_and_arguments_stay():
    values = numbers()
    strata = draw_stratified(fill, 60, values, 2.0, seed=3)
    assert np.array_equal(values, numbers())
    for stratum in strata:
        for site in resolve(fill, [fault.index for fault in stratum.faults], numbers(), 2.0):
            assert key_of(site) == stratum.key
    assert all(0 <= fault.bits[0] < 64 for stratum in strata for fault in stratum.faults)
    assert run_forked(fill, strata[0].faults[0], values, 2.0).injection.activated


def test_all_strata_are_injected_and_shares_are_those_of_the_call():
    strata = draw_stratified(fill, 60, numbers(), 2.0, seed=3)
    sizes = sizes_of(histogram(fill, numbers(), 2.0))
    assert {stratum.key: stratum.instructions for stratum in strata} == sizes
    assert sum(stratum.instructions for stratum in strata) == count(fill, numbers(), 2.0)
    assert sum(stratum.share for stratum in strata) == pytest.approx(1.0)
    assert sum(len(stratum.faults) for stratum in strata) == 60
    assert sum(stratum.weight(60) * len(stratum.faults) for stratum in strata) == pytest.approx(60)


def test_shares_are_those_within_the_class_that_was_asked_for():
    strata = draw_stratified(fill, 10, numbers(), 2.0, which="floating_point")
    sizes = sizes_of((site, times) for site, times in histogram(fill, numbers(), 2.0) if site.floating)
    assert {stratum.key: stratum.instructions for stratum in strata} == sizes


def test_within_a_stratum_all_dynamic_instructions_come_up_alike():
    strata = draw_stratified(loop, 6000, *LOOP, seed=1)
    sites = resolve(loop, range(count(loop, *LOOP)), *LOOP)
    for stratum in strata:
        places = {
            index: place for place, index in enumerate(i for i, s in enumerate(sites) if key_of(s) == stratum.key)
        }
        hits = np.zeros(len(places))
        for fault in stratum.faults:
            hits[places[fault.index]] += 1  # a place outside of the stratum is a KeyError
        expected = len(stratum.faults) / len(places)
        assert ((hits - expected) ** 2 / expected).sum() - len(places) < 5 * np.sqrt(2 * len(places))


def test_the_same_seed_gives_the_same_faults():
    assert draw_stratified(loop, 20, *LOOP, seed=5) == draw_stratified(loop, 20, *LOOP, seed=5)
    assert draw_stratified(loop, 20, *LOOP, seed=5) != draw_stratified(loop, 20, *LOOP, seed=6)


# ---- rates ----------------------------------------------------------------------------------------------------------
def changed_by_every_bit(kernel, args):
    """For each dynamic instruction, by bit: whether flipping it changes the result."""
    variant = variant_for(kernel, args)
    golden, total = variant.count(*args)
    sites = resolve(kernel, range(total), *args)
    bits = np.float64(golden).tobytes()
    return sites, [
        [np.float64(variant.inject(index, -1, 1 << bit, 10**6, *args)).tobytes() != bits for bit in range(site.width)]
        for index, site in enumerate(sites)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def known():
    sites, table = changed_by_every_bit(masking, MASKING)
    return sites, table, float(np.mean([np.mean(row) for row in table]))


@pytest.mark.slow
def test_weighted_rates_are_those_of_the_uniform_draw(known):
    """The estimator's mean over draws is the rate that is known from every (index, bit); without weights it is not."""
    _, table, truth = known
    weighted, plain, covered = [], [], 0
    for seed in range(SEEDS):
        strata = draw_stratified(masking, N, *MASKING, seed=seed)
        outcomes = [(s.share, [table[f.index][f.bits[0]] for f in s.faults]) for s in strata]
        found = estimate(outcomes)
        weighted.append(found.rate)
        plain.append(np.mean([counts for _, own in outcomes for counts in own]))
        by_fault = [s.weight(N) * table[f.index][f.bits[0]] for s in strata for f in s.faults]
        assert np.mean(by_fault) == pytest.approx(found.rate)
        covered += found.low <= truth <= found.high
    error = np.std(weighted) / np.sqrt(len(weighted))
    assert abs(np.mean(weighted) - truth) < 4 * error
    assert abs(np.mean(plain) - truth) > 6 * np.std(plain) / np.sqrt(len(plain))
    assert covered >= 0.95 * SEEDS


def test_the_estimate_is_exact_where_every_stratum_is_known(known):
    sites, table, truth = known
    keys = {key_of(site) for site in sites}
    total = len(sites)
    exact = 0.0
    for key in keys:
        own = [row for site, row in zip(sites, table, strict=True) if key_of(site) == key]
        exact += len(own) / total * float(np.mean([np.mean(row) for row in own]))
    assert exact == pytest.approx(truth)


def test_an_interval_keeps_the_doubt_of_strata_that_end_alike():
    found = estimate([(0.5, [True] * 4), (0.5, [False] * 4)])
    assert found.rate == 0.5 and found.low < 0.35 and found.high > 0.65 and found.n == 8
    wide, narrow = estimate([(1.0, [True, False])]), estimate([(1.0, [True, False] * 50)])
    assert wide.high - wide.low > 3 * (narrow.high - narrow.low)


@pytest.mark.parametrize(
    ("outcomes", "text"), [([(0.5, [True])], "sum is 0.5"), ([(0.5, [True]), (0.5, [])], "no outcomes")]
)
def test_what_cannot_be_estimated_is_refused(outcomes, text):
    with pytest.raises(BadInputError, match=text):
        estimate(outcomes)


# ---- how many where -------------------------------------------------------------------------------------------------
SIZES = {StratumKey("integer", "k.py", line): size for line, size in enumerate((900, 80, 15, 4, 1))}


def test_half_of_the_faults_follow_the_shares_and_half_are_spread_evenly():
    numbers = list(allocate(SIZES, 1000).values())
    assert sum(numbers) == 1000
    assert [round(number / 1000, 2) for number in numbers] == [0.55, 0.14, 0.11, 0.1, 0.1]
    assert list(allocate(SIZES, 5).values()) == [1] * 5


def test_the_smallest_strata_are_taken_together_where_there_are_too_many():
    homes = pooled(SIZES, 3)
    assert [home == key for key, home in homes.items()] == [True, True, False, False, False]
    assert set(homes.values()) == {*list(SIZES)[:2], REST}
    assert all(home == key for key, home in pooled(SIZES, 5).items())
    assert set(pooled(SIZES, 1).values()) == {REST}
    strata = draw_stratified(fill, 3, numbers(), 2.0)
    assert sum(stratum.share for stratum in strata) == pytest.approx(1.0) and len(strata) == 3


@pytest.mark.parametrize(("n", "which", "text"), [(0, "all", "1 or more"), (5, "opcode:fdiv", "executes none")])
def test_what_cannot_be_drawn_is_refused(n, which, text):
    with pytest.raises(BadInputError, match=text):
        draw_stratified(fill, n, numbers(), 2.0, which=which)


# ---- several calls --------------------------------------------------------------------------------------------------
DRAWS, FEW = 2500, 3
CALLS = (4, 23, 11)


@pytest.fixture(scope="module")
def counted():
    """Two functions of a kernel, called several times."""
    functions = {"loop": Profiling(loop), "fill": Profiling(fill)}
    for n in CALLS:
        functions["loop"](LOOP[0], n)
    functions["fill"](np.linspace(0.0, 4.0, 12), 2.0)
    return functions


def test_calls_are_drawn_with_the_weight_of_their_counts():
    counts = [10, 0, 1000, 10]
    drawn = choose(np.random.default_rng(1), counts, 5_000)
    calls = np.bincount([call for call, _ in drawn], minlength=4)
    assert calls[1] == 0
    assert abs(calls[2] - 5_000 * 1000 / 1020) < 200
    assert all(0 <= index < counts[call] for call, index in drawn)
    assert {index for call, index in drawn if call == 0} == set(range(10))


@pytest.mark.slow
def test_weighted_picks_are_uniform_over_dynamic_instructions(counted):
    """Of few picks at a time, the mean weight of each stratum is its share; without weights it is the density."""
    sizes = sizes_of((site, times) for own in counted.values() for _, site, times in own.executed())
    whole, wanted = sum(sizes.values()), densities(sizes)
    random = np.random.default_rng(8)
    picks = [chosen for _ in range(DRAWS) for chosen in pick(random, counted, parse_selection("all"), FEW)]
    assert len(picks) == DRAWS * FEW
    weights, hits = Counter(), Counter()
    for chosen in picks:
        weights[key_of(chosen.member.site)] += chosen.weight
        hits[key_of(chosen.member.site)] += 1
    for key, size in sizes.items():
        error = np.sqrt(wanted[key] / len(picks))
        assert abs(hits[key] / len(picks) - wanted[key]) < 5 * error
        share = size / whole
        assert abs(weights[key] / len(picks) - share) < 5 * error * share / wanted[key]
    assert max(chosen.weight for chosen in picks) <= 2.0


def test_picks_of_one_mission_are_kept_apart(counted):
    together = Counter()
    for seed in range(200):
        picks = pick(np.random.default_rng(seed), counted, parse_selection("all"), FEW)
        together[len({key_of(chosen.member.site) for chosen in picks})] += 1
    assert together[FEW] > 150


def test_picks_are_of_the_class_that_was_asked_for_or_none(counted):
    random = np.random.default_rng(1)
    picks = pick(random, counted, parse_selection("floating_point"), 50)
    assert len(picks) == 50 and all(chosen.member.site.floating for chosen in picks)
    assert pick(random, counted, parse_selection("opcode:fdiv"), 5) == []
    assert pick(random, counted, parse_selection("all"), 0) == []


def test_picks_are_found_again_in_their_calls(counted):
    own = {"loop": counted["loop"]}
    picks = pick(np.random.default_rng(2), own, parse_selection("all"), 60)
    digest = picks[0].member.digest
    locating = Locating(loop, {digest: [(chosen.member.site.block, chosen.number) for chosen in picks]})
    for n in CALLS:
        assert locating(LOOP[0], n) == loop(LOOP[0], n)
    places = [locating.place(digest, chosen.member.site.block, chosen.number) for chosen in picks]
    assert {call for call, _ in places} == {0, 1, 2}
    wanted = {}
    for (call, start), chosen in zip(places, picks, strict=True):
        wanted.setdefault(call, []).append(start + chosen.member.site.offset)
    resolving = Resolving(loop, wanted)
    for n in CALLS:
        resolving(LOOP[0], n)
    for (call, start), chosen in zip(places, picks, strict=True):
        assert resolving.sites[call, start + chosen.member.site.offset] == chosen.member.site
