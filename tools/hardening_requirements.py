"""The table of requirements of docs/generated/hardening.md: required, measured, whether met, and what limits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from mavfi.campaign.analysis.statistics import Rate
from mavfi.campaign.hardening.advise import Advice, Curve, Step, coverage_of_steps
from mavfi.campaign.hardening.certify import CONFIRMED, UNDECIDED, UNKNOWN
from mavfi.campaign.hardening.golden import GoldenCheck
from mavfi.campaign.hardening.summary import AdviceSummary
from mavfi.reports.hardening.plain import interval
from mavfi.reports.text import percent

MAP = "octomap"
HEADINGS = ("what", "requirement", "measured", "met", "what limits")
Row = dict[str, Any]
Certified = Sequence[tuple[Curve, Step, Row]]
REQUIRED: dict[str, tuple[float, float | None, float, str]] = {
    "plan_rrt_connect": (1.2, 0.97, 0.94, "≥ 97 % of SDCs removed (lower bound ≥ 94 %) at ≤ ×1.20"),
    "time_to_collision": (1.2, 0.97, 0.94, "≥ 97 % of SDCs removed (lower bound ≥ 94 %) at ≤ ×1.20"),
    "track": (1.3, 0.85, -1.0, "≥ 85 % at ≤ ×1.30"),
    "apply_updates": (1.3, 0.85, -1.0, "≥ 85 % at ≤ ×1.30"),
    "back_project": (1.5, None, -1.0, "best found within ×1.5"),
    "insert_scan": (1.5, None, -1.0, "best found within ×1.5"),
}
"""Largest time, least coverage (None = the best found) and its lower bound, and requirement, by function."""


def requirements(
    curves: Sequence[Curve], certified: Certified, advice: AdviceSummary, rest: "Bought",
    check: GoldenCheck,
) -> list[list[str]]:  # fmt: skip
    """Required and measured values, in the columns of `HEADINGS`; `rest` is that of `all_but_map`."""
    whole = check.passed and check.flights >= 40 and check.calls >= 10_000
    rows = [
        ["golden digests with any plan; false alarms", "equal on 40 missions in four environments; 0 in ≥ 10,000 calls",
         f"{check.same} of {check.flights} equal; {check.alarms} in {check.calls:,} calls", _met(whole), ""],
    ]  # fmt: skip
    rows += [_function(entry, curves, certified) for entry in REQUIRED]
    return [*rows, _budget(advice, rest), _prediction(certified)]


def of_functions(required: Sequence[Sequence[str]]) -> list[list[str]]:
    """The rows of functions with a limit of time, without what limits them."""
    return [list(row[:4]) for row in required if row[0].strip("`") in REQUIRED]


def _met(whether: bool) -> str:
    return "yes" if whether else "no"


def _function(entry: str, curves: Sequence[Curve], certified: Certified) -> list[str]:
    """The best certified step of a function within its time."""
    most, least, bound, wanted = REQUIRED[entry]
    steps = [(step, row) for curve, step, row in certified if curve.target.seen.entry == entry]
    own = [(step, row) for step, row in steps if step.time <= most and row["coverage"]["rate"] is not None]
    curve = next((one for one in curves if one.target.seen.entry == entry), None)
    if not own or curve is None:
        cheapest = min((step.time for step, _ in steps), default=None)
        measured = "not certified" if cheapest is None else f"no certified step; the cheapest takes ×{cheapest:.2f}"
        return [f"`{entry}`", wanted, measured, _met(False), ""]
    step, row = max(own, key=lambda one: one[1]["coverage"]["low"])  # of several certificates the most telling one
    found = row["coverage"]
    met = least is not None and found["rate"] >= least and found["low"] >= bound
    limits = "" if met or entry not in _LIMITS else _LIMITS[entry](curve, row, most)
    measured = f"{interval(Rate(**found))} at ×{step.time:.2f}"
    return [f"`{entry}`", wanted, measured, "best found" if least is None else _met(met), limits]


def _full(curve: Curve) -> str:
    return f"in full ×{curve.steps[-1].time:.2f}"


def _bound(curve: Curve, most: float) -> str:
    return (
        "throughput-bound: plain code leaves the processor few free slots, so shadows take their own time, "
        f"{_full(curve)}; {_gap(curve, most)}"
    )


def _gap(curve: Curve, most: float) -> str:
    """Times of the steps around the largest one that is allowed."""
    below = max(step.time for step in curve.steps if step.time <= most)
    above = min((step.time for step in curve.steps if step.time > most), default=None)
    return "" if above is None else f"no step between ×{below:.2f} and ×{above:.2f} was tried"


def _next(curve: Curve, most: float) -> str:
    """The cheapest step that takes longer than is allowed."""
    step = min((step for step in curve.steps if step.time > most), key=lambda step: step.time)
    return f"the next step takes ×{step.time:.2f}, predicted: {interval(step.coverage)}; {_full(curve)}"


_LIMITS: dict[str, Callable[[Curve, Row, float], str]] = {
    "plan_rrt_connect": lambda curve, row, most: (
        f"n = {row['sdc_after']['n']} faults cannot reach a lower bound of 94 %: more faults would help; {_full(curve)}"
        if row["coverage"]["rate"] >= REQUIRED["plan_rrt_connect"][1]
        else _next(curve, most)
    ),
    "time_to_collision": lambda curve, row, most: (
        "what escapes is spread over the arithmetic before the first voxel of each ray, not in calls of `floor`; "
        f"{_next(curve, most)}"
    ),
    "apply_updates": lambda curve, row, most: (
        f"most of its instructions update counters, each of which is an output: only more time helps; {_full(curve)}"
    ),
    **dict.fromkeys(("back_project", "insert_scan"), lambda curve, row, most: _bound(curve, most)),
}
"""What limits a function: what was tried, and what would help, from its curve, certificate and largest time."""


@dataclass(frozen=True, slots=True)
class Bought:
    """Time that some protection adds to a flight, and the coverage that it is predicted to give."""

    spent: float
    coverage: Rate


def all_but_map(advice: Advice) -> Bought:
    """What it costs and removes to protect every function but those of the map in full."""
    steps = [
        (curve, curve.steps[0 if MAP in curve.target.kernels else -1])
        for curve in advice.curves
        if len(curve.steps) > 1
    ]
    return Bought(sum(curve.extra(step) for curve, step in steps), coverage_of_steps(steps))


def _budget(advice: AdviceSummary, rest: Bought) -> list[str]:
    """What the budget buys, against every kernel but the map in full, whatever that costs."""
    better = advice.spent <= advice.budget and (advice.coverage.low or 0.0) >= (rest.coverage.rate or 0.0)
    return [
        f"`--budget {advice.budget:.2f}` of a flight's kernel time", "every kernel but the map in full, or better",
        f"{interval(advice.coverage)} of all SDCs removed for {percent(advice.spent)}, predicted; every kernel "
        f"but the map in full: {interval(rest.coverage)} for {percent(rest.spent)}",
        _met(better), "" if better else "most SDCs and most of the kernel time are those of the map",
    ]  # fmt: skip


def _prediction(certified: Certified) -> list[str]:
    """Agreement of prediction and certificate, in two readings; the first is of the plans that are decided."""
    judged = [(step, row) for _, step, row in certified if row["verdict"] != UNKNOWN]
    decided = [row for _, row in judged if row["verdict"] != UNDECIDED]
    agree = sum(row["verdict"] == CONFIRMED for row in decided)
    inside = sum(_inside(step, row) for step, row in judged)
    return [
        "prediction", "inside its 95 % interval for ≥ 90 % of ≥ 20 plans",
        f"difference of measured and predicted rate not below or above 0: {agree} of {len(decided)} plans "
        f"({len(judged) - len(decided)} more are undecided); measured rate inside the predicted "
        f"interval: {inside} of {len(judged)}",
        f"{_met(_most(agree, len(decided)))}; {_met(_most(inside, len(judged)))}",
        "" if _most(inside, len(judged)) else "the second reading ignores the interval of the measured rate, "
        "mostly several times as wide: exact predictions would miss it, too",
    ]  # fmt: skip


def _inside(step: Step, row: Row) -> bool:
    low, high = step.coverage.low, step.coverage.high
    return low is not None and high is not None and low <= row["coverage"]["rate"] <= high


def _most(count: int, whole: int) -> bool:
    return whole >= 20 and count >= 0.9 * whole
