"""Budget of time over functions, and predicted coverage."""

from dataclasses import dataclass
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavfi.extras.hardening import advise
from mavfi.extras.hardening.advise import (
    Advice,
    Curve,
    CurveStep,
    PreparedFunction,
    allocate,
    allocate_and_retime,
    coverage_of,
    coverage_of_steps,
)
from mavfi.extras.hardening.choose import NOTHING
from mavfi.extras.hardening.target import Injected


@dataclass
class Target:
    name: str
    sdc_mass: float


def judged(hits, n, world=str):
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


def test_predicted_coverage_counts_calls_as_clusters():
    alone = coverage_of(judged(50, 100))
    clustered = coverage_of(judged(50, 100, lambda i: str(i // 50)))
    assert alone.rate == clustered.rate == 0.5
    assert clustered.high - clustered.low > 2 * (alone.high - alone.low)


def test_functions_count_by_their_silent_corruptions():
    parts = [("a", 90.0, judged(100, 100)), ("b", 10.0, judged(0, 50)), ("c", 5.0, [])]
    found = coverage_of_steps(
        [(Curve(Target(name, mass), 1.0, 0.1, ()), CurveStep(1.0, NOTHING, 1.0, own)) for name, mass, own in parts]
    )
    assert found.rate == pytest.approx(0.9)
    assert found.low < 0.9 < found.high
