"""The drawing of a function's curve on the page of an advice, in pixels: predicted coverage over time."""

from collections.abc import Sequence
from dataclasses import dataclass

from mavfi.extras.hardening.summary import FunctionSummary, StepSummary
from mavfi.extras.hardening.text import interval
from mavfi.report.text import percent

WIDTH, HEIGHT = 300, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 20, 10, 32
_TICKS = (1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0)
_MAX_TICKS = 5
_MIN_SPAN = 0.05
"""Smallest range of the axis of time: a curve of one step has none."""


@dataclass(frozen=True, slots=True)
class Point:
    """A step of a curve: its position, the ends of its interval (y), and its text."""

    x: float
    y: float
    low: float
    high: float
    chosen: bool
    text: str


@dataclass(frozen=True, slots=True)
class Drawing:
    """A curve with its axes.

    Attributes:
        function: What is drawn.
        points: Steps with a known coverage.
        path: Points of the line.
        xs: Position and text of each tick of time.
        ys: The same for coverage.
    """

    function: FunctionSummary
    points: tuple[Point, ...]
    path: str
    xs: tuple[tuple[float, str], ...]
    ys: tuple[tuple[float, str], ...]
    width: int = WIDTH
    height: int = HEIGHT
    left: int = _LEFT
    right: int = WIDTH - _RIGHT
    bottom: int = HEIGHT - _BOTTOM


def best(times: Sequence[float], rates: Sequence[float]) -> list[int]:
    """Indices of the steps that remove more than all that take less time, by time: what a time buys."""
    front: list[int] = []
    for index in sorted(range(len(times)), key=lambda index: (times[index], -rates[index])):
        if not front or rates[index] > rates[front[-1]]:
            front.append(index)
    return front


def curve(function: FunctionSummary) -> Drawing:
    """A function's curve of predicted coverage over time."""
    last = max(1 + _MIN_SPAN, *(step.time for step in function.steps))

    def x(time: float) -> float:
        return _LEFT + round((WIDTH - _LEFT - _RIGHT) * (time - 1) / (last - 1), 1)

    points: list[Point] = []
    rates: list[float] = []
    times: list[float] = []
    for step in function.steps:
        coverage = step.coverage
        if coverage.rate is None or coverage.low is None or coverage.high is None:
            continue
        rates.append(coverage.rate)
        times.append(step.time)
        points.append(
            Point(
                x(step.time), _down(coverage.rate), _down(coverage.low), _down(coverage.high), step.chosen, _text(step)
            )
        )
    inside = [tick for tick in _TICKS if tick <= last + 1e-9]
    ticks = inside[:: -(-len(inside) // _MAX_TICKS)]
    return Drawing(
        function=function,
        points=tuple(points),
        path=" ".join(f"{points[index].x},{points[index].y}" for index in best(times, rates)),
        xs=tuple((x(tick), f"×{tick:g}") for tick in ticks),
        ys=tuple((_down(share), percent(share, 0)) for share in (0.0, 0.5, 1.0)),
    )


def _text(step: StepSummary) -> str:
    return f"×{step.time:.2f} time: {interval(step.coverage)} of SDCs"


def _down(share: float) -> float:
    return round(HEIGHT - _BOTTOM - (HEIGHT - _TOP - _BOTTOM) * share, 1)
