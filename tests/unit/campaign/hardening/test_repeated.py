"""Whole calls executed two or three times: certified as duplicated instructions are."""

from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest

from mavfi.campaign.hardening.battery import DETECTED, MASKED, SDC
from mavfi.campaign.hardening.certification import with_certified
from mavfi.campaign.hardening.certify import Pair, certify, pairs_of, unprotected
from mavfi.campaign.hardening.golden import Guarded
from mavfi.campaign.hardening.kernel import see
from mavfi.campaign.hardening.machine import machine_levels
from mavfi.campaign.hardening.repeated import Repeated, keep_and_compare, repeating
from mavfi.errors import BadInputError
from mavfi.hardening.plan import Coverage, FunctionPlan, Plan
from mavfi.ir.build import name_of
from tests.unit.campaign.hardening.kernels import calls, smooth

EXECUTIONS = {"rerun": 2, "vote": 3}


def planned(kind, **more):
    seen = see(smooth, calls())
    return seen, FunctionPlan(
        kernel="smooth", function=name_of(smooth), signature=seen.signature_text, ir_sha256=seen.variant.ir_sha256,
        kind=kind, **more,
    )  # fmt: skip


@pytest.mark.parametrize("kind", EXECUTIONS)
def test_repeated_calls_are_certified_and_timed(kind):
    seen, own = planned(kind)
    plan = Plan(functions=(own,))
    (pair,) = pairs_of([seen], plan)
    found = certify(pair, 60)
    assert unprotected([seen], plan) == []
    assert found.before[SDC] > 20 and SDC not in found.after and found.after[DETECTED] > 20
    assert found.growth == EXECUTIONS[kind] and found.coverage.rate == 1.0
    assert found.paired.first_only == found.before[SDC] and found.paired.second_only == 0
    assert found.time > 1.0


def effect(times, results, golden=1.0, fault=2.0):
    """Effect of a fault that makes the first execution return `fault`; `results` are those of the others."""
    variant = SimpleNamespace(inject=lambda *_: fault, report=lambda: "activated")
    left = iter(results)
    battery = Repeated("f", lambda *_: next(left), variant, [], times)
    battery._outputs = lambda result, _: (result,)
    return battery._injected((), 0, 0, 1, (golden,))


@pytest.mark.parametrize(
    ("results", "fault", "expected"),
    [
        ([1.0, 1.0], 1.0, MASKED),
        ([1.0, 1.0], 2.0, DETECTED),
        ([2.0, 2.0], 2.0, SDC),  # a fault that outlives its execution
        ([2.0, 1.0], 2.0, SDC),  # the majority is wrong
        ([1.0, 3.0], 2.0, DETECTED),  # there is none
    ],
)
def test_the_majority_of_three_is_published(results, fault, expected):
    assert effect(3, results, fault=fault) == expected


@pytest.mark.parametrize(("second", "expected"), [(1.0, DETECTED), (2.0, SDC)])
def test_two_executions_that_differ_are_detected(second, expected):
    assert effect(2, [second]) == expected


@pytest.mark.parametrize("kind", EXECUTIONS)
def test_false_alarms_of_repeated_calls_are_counted(kind):
    _, own = planned(kind)
    guarded, args, other = Guarded(smooth, Plan(functions=(own,))), calls()[0], calls()[0]
    assert np.float64(guarded(*args)).tobytes() == np.float64(smooth(*other)).tobytes()
    assert args[1].tobytes() == other[1].tobytes() and (guarded.calls, guarded.alarms) == (1, 0)
    numbers = count()
    with pytest.raises(SystemError):  # a function that remembers its calls
        repeating(lambda: next(numbers), EXECUTIONS[kind])()


def test_a_repetition_of_other_code_is_refused():
    seen, own = planned("rerun")
    with pytest.raises(BadInputError, match="planned for IR 000000000000"):
        Pair.of(seen, own.model_copy(update={"ir_sha256": "0" * 64}))


def test_a_repetition_has_no_code_of_its_own_at_machine_level():
    seen, own = planned("vote")
    with pytest.raises(BadInputError, match="--machine"):
        machine_levels([Pair.of(seen, own)], "smooth", 1, print)


def test_the_coverage_of_a_repetition_is_not_that_of_plain_code():
    _, own = planned("rerun", certified=Coverage(estimate=1.0, low=0.9, high=1.0))
    plain = Plan(functions=(own.model_copy(update={"kind": "none", "certified": None}),))
    assert with_certified(plain, Plan(functions=(own,))).functions[0].certified is None


def test_memory_is_kept_and_compared():
    values, kept = np.arange(9), np.zeros(9, np.int64)
    assert keep_and_compare(values, kept, values.copy()) and (kept == values).all()
    assert not keep_and_compare(values, kept, values + (values == 7))
