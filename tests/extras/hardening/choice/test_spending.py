"""What a plan adds to flights, as measured, against its budget."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mavfi.analysis.statistics import mcnemar
from mavfi.extras.hardening.certify import (
    Certificate,
    Certification,
    Spending,
    certification_json,
    spending_of,
    ticks_of,
)
from mavfi.extras.hardening.observed import GoldenCheck
from mavfi.extras.hardening.report import certificate_table, verdict_line
from mavfi.ir.build import name_of
from tests.extras.hardening.choice.kernels import calls, see, smooth
from tools.stored_certificate import certification_of


def seen(signature, total):
    return SimpleNamespace(key=(name_of(smooth), signature), total=total)


def certificate(signature, time, planned_time):
    effects = {"masked": 50, "sdc": 50}, {"detected": 100}
    return Certificate("pid", name_of(smooth), signature, 9, *effects, 1.0, None, mcnemar([], []), time, planned_time)


def test_times_are_weighted_by_the_functions_share_of_the_flight():
    flown = [seen("f8", 60), seen("f4", 10), seen("i8", 3)]
    ticks = dict(zip((one.key for one in flown), (1.0, 3.0, 100 / 30), strict=True))  # 60, 30 and 10 % of the flight
    rows = [certificate("f8", 1.2, 1.1), certificate("f4", None, 1.4), certificate("of another planner", 9.0, 9.0)]
    found = spending_of("rrt", flown, ticks, rows, 0.18)
    assert found.measured == pytest.approx(0.6 * 0.2 + 0.3 * 0.4)
    assert found.planned == pytest.approx(0.6 * 0.1 + 0.3 * 0.4)
    assert (found.planner, found.budget, found.refuted) == ("rrt", 0.18, True)


@pytest.mark.parametrize(
    ("measured", "budget", "refuted"),
    [(0.119, 0.1, False), (0.121, 0.1, True), (0.119, None, False), (0.121, None, True), (0.01, 0.1, False)],
)
def test_a_budget_is_refuted_beyond_its_tolerance(measured, budget, refuted):
    one = Spending("rrt", measured, 0.1, budget)
    own = (certificate("f8", 1.2, 1.1),)
    found = Certification("ab" * 32, 100, (), own, GoldenCheck(1, 1, 9, 0), spending=(Spending("pid", 0, 0), one))
    assert one.refuted == found.refuted == refuted
    line = verdict_line(found)
    assert line.startswith("The plan is refuted") == refuted and ("beyond it: refuted" in line) == refuted
    assert f"adds {100 * measured:.1f} % of a flight's kernel time (with the plan's times: 10.0 %" in line
    assert ("the budget is 10.0 %" in line) == (budget is not None)
    assert any(note.startswith("flights with rrt: ") for note in certificate_table(found).notes)
    assert certification_of(certification_json(found)).spending == found.spending
    assert "adds" not in verdict_line(replace(found, spending=()))


def test_a_longer_call_has_more_ticks():
    long = see(smooth, [(np.full(20_000, 0.5), np.zeros(20_000))])
    assert ticks_of(long) > 5 * ticks_of(see(smooth, calls())) > 0
