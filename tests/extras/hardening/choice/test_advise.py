"""Budget of time over functions, and predicted coverage."""

from dataclasses import dataclass, field
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavfi.analysis.statistics import Rate, wilson
from mavfi.extras.hardening import advise
from mavfi.extras.hardening.advise import (
    Advice,
    Curve,
    CurveStep,
    PreparedFunction,
    allocate,
    allocate_and_retime,
    coverage_of_steps,
)
from mavfi.extras.hardening.choose import NOTHING
from mavfi.extras.hardening.target import Injected


@dataclass
class Target:
    name: str
    sdc_mass: float
    sdc_rate: Rate = field(default_factory=lambda: wilson(50, 100))

    @property
    def sdc_mass_by_mission(self):
        return dict.fromkeys("01234567", self.sdc_mass / 8)


def judged(hits, n, world=lambda i: str(i % 8)):
    return [(Injected(0, i, True, world(i)), i < hits) for i in range(n)]


def curve(name, share, mass, *points):
    """A curve with (time, share of SDCs removed) at each step."""
    steps = [
        CurveStep(0.0, NOTHING, 1.0, judged(0, 100)),
        *(CurveStep(1.0, NOTHING, t, judged(round(100 * c), 100)) for t, c in points),
    ]
    return Curve(Target(name, mass), 1.0, share, tuple(steps))


def test_a_step_is_chosen_by_a_time_that_did_not_lead_to_its_choice(monkeypatch):
    """Its first time is the shortest of many: the error of the measurement is part of why it was chosen."""
    octomap = curve("map", 0.7, 75.0, (1.04, 0.3), (1.02, 0.4), (1.3, 0.9))
    small = curve("small", 0.01, 20.0, (1.5, 1.0))
    ready = [PreparedFunction([], [], [own.target.name.encode(), *map(str.encode, "123")]) for own in (octomap, small)]
    true, timed = {b"1": 1.05, b"2": 1.10, b"3": 1.25}, []

    def times_of(target, codes, seconds):
        assert codes[0] == target.name.encode() and seconds == 0.5
        timed.append((target.name, codes[1]))
        return 1.0, [true[codes[1]]]

    monkeypatch.setattr(advise, "times_of", times_of)
    assert allocate([octomap, small], 0.05) == (2, 1)
    curves, chosen = allocate_and_retime([octomap, small], ready, 0.05, 0.5)
    assert timed == [("map", b"2"), ("map", b"1")], "the small function is not timed again"
    assert chosen == (1, 1) and [step.time for step in curves[0].steps] == [1.0, 1.05, 1.10, 1.3]
    assert curves[1] == small and Advice(0.05, curves, chosen).spent <= 0.05


@settings(max_examples=100, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(0.01, 1),
            st.floats(0, 9),
            st.lists(st.tuples(st.floats(1, 3), st.integers(0, 100)), min_size=1, max_size=3),
        ),
        max_size=4,
    ),
    st.floats(0.001, 2),
)
def test_no_other_choice_within_the_budget_removes_more(rows, budget):
    curves = [
        curve(str(i), share, mass, *((time, hits / 100) for time, hits in points))
        for i, (share, mass, points) in enumerate(rows)
    ]
    small = budget * (1 - len(curves) / 5000)  # times are rounded up
    worth = [
        sum(own.removed(own.steps[place]) for own, place in zip(curves, places, strict=True))
        for places in product(*(range(len(own.steps)) for own in curves))
        if sum(own.extra(own.steps[place]) for own, place in zip(curves, places, strict=True)) <= small
    ]
    advice = Advice(budget, tuple(curves), allocate(curves, budget))
    assert sum(own.removed(step) for own, step in advice.steps) >= max(worth) - 1e-9
    assert advice.spent <= budget + 1e-12


def test_predicted_coverage_counts_missions_as_clusters():
    alike = CurveStep(1.0, NOTHING, 1.0, judged(50, 100)).coverage
    different = CurveStep(1.0, NOTHING, 1.0, judged(50, 100, lambda i: str(i // 13))).coverage
    assert alike.rate == different.rate == 0.5
    assert different.high - different.low > 2 * (alike.high - alike.low)


def test_too_few_missions_predict_nothing_and_the_rest_of_a_plan_is_told_without_them():
    few = CurveStep(1.0, NOTHING, 1.0, judged(100, 100, lambda i: str(i % 2)))
    many = CurveStep(1.0, NOTHING, 1.0, judged(100, 100))
    assert few.coverage.rate is None and few.removed_share == 1.0
    parts = [(Curve(Target(name, mass), 1.0, 0.1, ()), step) for name, mass, step in (("a", 90, many), ("b", 10, few))]
    total = coverage_of_steps(parts)
    assert total.rate == pytest.approx(0.9) and total.high > 0.99
    assert coverage_of_steps(parts[1:]).rate is None


def test_blocks_that_no_mission_executed_lower_the_bound():
    seen = CurveStep(1.0, NOTHING, 1.0, judged(100, 100)).coverage
    unseen = CurveStep(1.0, NOTHING, 1.0, judged(100, 100), 0.2).coverage
    assert (unseen.rate, unseen.low) == (1.0, pytest.approx(0.8 * seen.low))


def test_functions_count_by_their_silent_corruptions():
    parts = [("a", 90.0, judged(100, 100)), ("b", 10.0, judged(0, 50)), ("c", 0.0, [])]
    found = coverage_of_steps(
        [(Curve(Target(name, mass), 1.0, 0.1, ()), CurveStep(1.0, NOTHING, 1.0, own)) for name, mass, own in parts]
    )
    assert found.rate == pytest.approx(0.9)
    assert found.low < 0.9 < found.high
