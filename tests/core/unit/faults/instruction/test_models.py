"""Models of instruction faults: which bits of a value are drawn."""

import numpy as np
import pytest

from mavfi.ir.injection.table import InjectionSite
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.levels.instruction.plan import plan

KINDS = {"double": 64, "i32": 32, "i1": 1, "<2 x double>": 128}


def site(kind):
    return InjectionSite(0, 0, "load", kind, KINDS[kind], "integer", ())


def drawn_bits(model, kind):
    random = np.random.default_rng(1)
    faults = [plan(random, "f", "", site(kind), 0, model) for _ in range(3000)]
    assert all(fault.model == model for fault in faults)
    return np.bincount([fault.bit for fault in faults], minlength=KINDS[kind])


@pytest.mark.parametrize(
    ("model", "kind", "expected"),
    [
        ("low_byte", "double", range(8)),
        ("low_byte", "i32", range(8)),
        ("low_byte", "i1", range(1)),
        ("high_bits", "double", range(52, 63)),
        ("high_bits", "i32", range(32)),
        ("high_bits", "i1", range(1)),
        ("high_bits", "<2 x double>", range(128)),
    ],
)
def test_one_bit_is_drawn_uniformly_from_the_range_of_the_authors_injector(model, kind, expected):
    hits = drawn_bits(model, kind)
    assert set(np.flatnonzero(hits)) == set(expected)
    mean = 3000 / len(expected)
    assert np.abs(hits[expected.start : expected.stop] - mean).max() < 5 * np.sqrt(mean)


def test_draws_of_one_bit_are_those_of_stored_campaigns():
    random = np.random.default_rng(7)
    faults = [plan(random, "f", "", site("double"), 0) for _ in range(4)]
    assert [fault.bits for fault in faults] == [(60,), (40,), (43,), (57,)]
    low = plan(np.random.default_rng(7), "f", "", site("double"), 0, "low_byte")
    assert InstructionFault.from_json({key: value for key, value in low.to_json().items() if key != "level"}) == low
