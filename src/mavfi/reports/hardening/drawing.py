"""Drawings of the page of an advice, in pixels: coverage over time, and over added instructions by way to choose."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mavfi.campaign.hardening.ways import WAYS
from mavfi.reports.hardening.plain import NAMES, interval
from mavfi.reports.text import percent

WIDTH, HEIGHT = 300, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 20, 10, 32
_TICKS = (1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0)
_MOST_TICKS = 5


def best(times: Sequence[float], rates: Sequence[float]) -> list[int]:
    """Indices of the steps that remove more than all that take less time, by time: what a time buys."""
    found: list[int] = []
    for place in sorted(range(len(times)), key=lambda place: (times[place], -rates[place])):
        if not found or rates[place] > rates[found[-1]]:
            found.append(place)
    return found


def curve(row: Mapping[str, Any]) -> dict[str, Any]:
    """A function's curve of predicted coverage over time."""
    last: float = max(1.05, *(step["time"] for step in row["steps"]))

    def x(time: float) -> float:
        return _across((time - 1) / (last - 1))

    steps = [step for step in row["steps"] if step["coverage"]["rate"] is not None]
    points = [
        {
            "x": x(step["time"]), "y": _down(step["coverage"]["rate"]), "low": _down(step["coverage"]["low"]),
            "high": _down(step["coverage"]["high"]), "chosen": step["chosen"],
            "text": f"×{step['time']:.2f} time: {interval(step['coverage'])} of SDCs",
        }
        for step in steps
    ]  # fmt: skip
    front = best([step["time"] for step in steps], [step["coverage"]["rate"] for step in steps])
    inside = [tick for tick in _TICKS if tick <= last + 1e-9]
    ticks = inside[:: -(-len(inside) // _MOST_TICKS)]
    return _frame(row, x, [(tick, f"×{tick:g}") for tick in ticks]) | {
        "points": points, "path": _path([(points[place]["x"], points[place]["y"]) for place in front]), "axis": "time",
        "label": f"SDCs removed over time of {row['entry']}",
    }  # fmt: skip


def ways(row: Mapping[str, Any]) -> dict[str, Any] | None:
    """A function's coverage by each way to choose, from nothing to full duplication; None if not compared.

    All ways meet at both ends: there is one way to duplicate nothing, and one to duplicate everything.
    """
    if not row["ways"]:
        return None
    ends = ((0.0, 0.0), (1.0, row["steps"][-1]["coverage"]["rate"]))
    lines: list[dict[str, Any]] = []
    for way in WAYS:
        inner = [(one["share"], one["coverage"][way]) for one in row["ways"]]
        shares = sorted([*ends, *((share, found["rate"]) for share, found in inner)])
        marks = [
            {"x": _across(share), "y": _down(found["rate"]),
             "text": f"{NAMES[way]}, {percent(share, 0)} of the instructions: {interval(found)} of SDCs"}
            for share, found in inner
        ]  # fmt: skip
        path = _path([(_across(share), _down(rate)) for share, rate in shares])
        lines.append({"way": way, "path": path, "points": marks, "text": _spoken(way, inner)})
    costs = ", ".join(percent(one["share"], 0) for one in row["ways"])
    label = f"SDCs of {row['entry']} removed with {costs} of the instructions of full duplication: "
    return _frame(row, _across, [(tick, percent(tick, 0)) for tick in (0.0, 0.25, 0.5, 0.75, 1.0)]) | {
        "lines": lines, "axis": "instructions added, of full duplication",
        "label": label + "; ".join(line["text"] for line in lines),
    }  # fmt: skip


def _spoken(way: str, found: Sequence[tuple[float, Mapping[str, Any]]]) -> str:
    """The points of a line for readers who do not see it."""
    return f"{NAMES[way]} {', '.join(percent(one['rate'], 0) for _, one in found)}"


def _frame(row: Mapping[str, Any], x: Callable[[float], float], ticks: Sequence[tuple[float, str]]) -> dict[str, Any]:
    """What all drawings have: caption, axes and their labels."""
    return {
        "kernel": row["kernel"], "entry": row["entry"], "width": WIDTH, "height": HEIGHT, "left": _LEFT,
        "right": WIDTH - _RIGHT, "bottom": HEIGHT - _BOTTOM, "n": row["coverage"]["n"],
        "xs": [(x(tick), text) for tick, text in ticks],
        "ys": [(_down(share), f"{100 * share:.0f} %") for share in (0.0, 0.5, 1.0)],
    }  # fmt: skip


def _across(share: float) -> float:
    return _LEFT + round((WIDTH - _LEFT - _RIGHT) * share, 1)


def _down(share: float) -> float:
    return round(HEIGHT - _BOTTOM - (HEIGHT - _TOP - _BOTTOM) * share, 1)


def _path(points: Sequence[tuple[float, float]]) -> str:
    return " ".join(f"{x},{y}" for x, y in points)
