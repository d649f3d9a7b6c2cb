"""Faults in memory are drawn uniformly over bits and instants: against a list of all of them."""

from collections import Counter

import numpy as np
import pytest

from mavfi.campaign.config import Campaign
from mavfi.errors import BadInputError
from mavfi.faults.fault import NO_SITE
from mavfi.faults.strata import WORD_BITS, bits_of
from mavfi.levels.memory.exposure import Exposure, FaultDrawing
from mavfi.levels.memory.fault import MemoryFault
from mavfi.levels.memory.sampling import MemorySampler
from mavfi.pipeline.words import Words

INSTANTS = {
    0: {"pid": [Words("remaining", "f8", 1)], "planner": [Words("acted_seq", "i4", 1), Words("random", "u8", 2)]},
    20_000: {"pid": [Words("remaining", "f8", 1), Words("fresh", "?", 1)], "planner": [Words("acted_seq", "i4", 1)]},
    40_000: {"planner": [Words("cells", "u1", 5), Words("strange", "c16", 9)]},
}
EVERYTHING = (("pid", ""), ("planner", ""))


def drawn(count=1, sites=EVERYTHING, stratum="", bit=None, seed=0):
    drawings = [FaultDrawing(np.random.default_rng([seed, number]), number) for number in range(count)]
    exposure = Exposure(sites, stratum, bit, drawings)
    for now, remembered in INSTANTS.items():
        exposure.observe(remembered, now)
    return exposure.faults()


def listed(stratum=""):
    """Every bit of every instant, as the fault that strikes it."""
    return [
        (kernel, words.name, index if words.count > 1 else None, now, bit)
        for now, remembered in INSTANTS.items()
        for kernel, every in remembered.items()
        for words in every
        if words.dtype in WORD_BITS
        for index in range(words.count)
        for bit in (bits_of(words, stratum) if stratum else range(WORD_BITS[words.dtype]))
    ]


@pytest.mark.parametrize("stratum", ["", "sign_exponent", "mantissa"])
def test_every_bit_of_every_instant_is_alike(stratum):
    count, every = 20_000, listed(stratum)
    faults = drawn(count, stratum=stratum)
    counts = Counter((f.kernel, f.field, f.index, f.time_us, f.bit) for f in faults)
    assert set(counts) <= set(every)
    expected = count / len(every)
    spread = sum((counts[word] - expected) ** 2 / expected for word in every)  # chi square with len - 1 degrees
    assert abs(spread - (len(every) - 1)) < 5 * np.sqrt(2 * (len(every) - 1))
    assert {f.weight for f in faults} == {len(every) / len(listed()) if stratum else 1.0}


def test_a_target_and_a_bit_can_be_named():
    assert {(f.kernel, f.field) for f in drawn(50, (("planner", "acted_seq"),))} == {("planner", "acted_seq")}
    assert {(f.field, f.bit) for f in drawn(50, bit=40)} == {("remaining", 40), ("random", 40)}
    assert {(f.field, f.index) for f in drawn(50, (("planner", "cells[3]"),))} == {("cells", 3)}


def test_what_nobody_remembers_is_no_site():
    (fault,) = drawn(1, (("pid", "waypoint"),))
    assert fault == MemoryFault("pid", "waypoint", time_us=NO_SITE, seed=0) and not fault.has_site


def campaign(**sampling):
    return Campaign(name="c", environments=("sparse",), missions=2, faults=4, sampling={"level": "memory", **sampling})


@pytest.mark.parametrize(
    ("sampling", "targets"),
    [
        ({}, ["memory"]),
        ({"share": "kernel", "kernels": ("pid", "octomap")}, ["pid", "octomap"]),
        ({"groups": [{"name": "counter", "sites": ["planner.acted_seq", "pid"]}]}, ["counter"]),
    ],
)
def test_targets_are_all_bits_kernels_or_groups(sampling, targets):
    blocks = MemorySampler(campaign(**sampling)).blocks("sparse")
    assert [block.draw(0).target for block in blocks] == targets
    assert [block.first for block in blocks] == [4 * block_number for block_number in range(len(targets))]
    assert [blocks[0].draw(index).seed - 10_000 for index in range(4)] == [0, 1, 0, 1]


def test_what_does_not_exist_is_refused():
    for sampling, text in (
        ({"kernels": ("pilot",)}, "kernel 'pilot': not known; allowed: point_cloud"),
        ({"kernels": ("state_estimation",)}, "kernel 'state_estimation': is not part of this mission"),
        ({"groups": [{"name": "a", "sites": ["pilot.x"]}]}, "kernel 'pilot': not known"),
        ({"strata": {"high": 1}}, "'high': not known"),
        ({"share": "stage"}, "'exposure' or 'kernel'"),
    ):
        with pytest.raises((BadInputError, ValueError), match=text):
            campaign(**sampling)
