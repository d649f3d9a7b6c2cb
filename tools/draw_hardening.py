"""Draw docs/images/hardening.png: coverage of each kernel against its time, from docs/generated/hardening.md.

Run as `make pictures`, after `make hardening`.
"""

import re
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mavfi.reports import style
from mavfi.reports.hardening.drawing import best
from tools.drawing import save
from tools.markers import GENERATED, IMAGES

COLUMNS = 5
PREDICTED, CERTIFIED = "SDCs removed, predicted", "SDCs removed"
"""Headings of columns."""
NO_COVERAGE = (float("nan"),) * 3
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


@dataclass(frozen=True, slots=True)
class Step:
    """A row of the page's curves: time ratio; coverage and the ends of its interval, predicted and certified (%)."""

    time: float
    predicted: tuple[float, ...] = NO_COVERAGE
    certified: tuple[float, ...] = NO_COVERAGE


def curves() -> dict[str, list[Step]]:
    """Steps of each function, from the page; none where the ledger has no silent corruption of it.

    Raises:
        ValueError: The page has no such table.
    """
    page = (GENERATED / "hardening.md").read_text(encoding="utf-8")
    heading = "\n| function | step |"
    if heading not in page:
        raise ValueError("docs/generated/hardening.md: has no table of curves; allowed: that of `make hardening`")
    found: dict[str, list[Step]] = {}
    headings, _, *lines = (heading + page.split(heading)[1].split("\n\n")[0]).strip().splitlines()
    for line in lines:
        row = dict(zip(_cells(headings), _cells(line), strict=True))
        values = [tuple(map(float, _NUMBER.findall(row[key]))) or NO_COVERAGE for key in (PREDICTED, CERTIFIED)]
        found.setdefault(row["function"].replace("`", ""), []).append(Step(float(row["time ×"]), *values))
    return {name: steps for name, steps in found.items() if not np.isnan([step.predicted for step in steps]).all()}


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def draw(axes: Axes, name: str, steps: list[Step]) -> None:
    """Draw one function."""
    times = np.array([1.0, *(step.time for step in steps)])
    rate, low, high = np.array([(0.0, 0.0, 0.0), *(step.predicted for step in steps)]).T
    front = best(times.tolist(), rate.tolist())
    axes.fill_between(times[front], low[front], high[front], color=style.SKY, alpha=0.3, linewidth=0)
    axes.plot(times[front], rate[front], color=style.BLUE, linewidth=1.6)
    axes.plot(times, rate, "o", color=style.BLUE, markersize=3.5)
    certified = np.array([step.certified for step in steps])
    lower, upper = certified[:, 0] - np.maximum(certified[:, 1], 0.0), certified[:, 2] - certified[:, 0]
    axes.errorbar(times[1:], certified[:, 0], (lower, upper), fmt="s", color=style.ORANGE, markersize=6, capsize=3,
                  markeredgecolor="white", linewidth=1.2, zorder=5)  # fmt: skip
    function, _, kernel = name.partition(" (")
    axes.set_title(f"{function}\n({kernel}", fontsize=9)
    axes.grid(visible=True)


def main() -> None:
    """Draw all functions."""
    found = curves()
    with style.house_style():
        rows = -(-len(found) // COLUMNS)
        figure, grid = plt.subplots(
            rows, COLUMNS, figsize=(11, 2.4 * rows + 0.8), sharex=True, sharey=True, layout="constrained", squeeze=False
        )
        for axes in grid.flat[len(found) :]:
            axes.set_axis_off()
        for axes, (name, steps) in zip(grid.flat, found.items(), strict=False):
            draw(axes, name, steps)
        grid[0, 0].set(xlim=(0.95, None), ylim=(-4.0, 104.0))
        figure.suptitle("What duplicated instructions buy, kernel by kernel", x=0.01, ha="left", fontweight="bold")
        figure.supxlabel("time of the protected kernel / time without protection", fontsize=9.5)
        figure.supylabel("silent corruptions removed (%)", fontsize=9.5)
        handles = [
            Line2D([], [], color=style.BLUE, marker="o", markersize=3.5, label="predicted, 95 % interval"),
            Line2D([], [], color=style.ORANGE, marker="s", linestyle="", label="certified with fresh faults, 95 %"),
        ]
        figure.legend(handles=handles, loc="outside upper right", ncols=2)
        save(figure, "hardening.png", IMAGES)


if __name__ == "__main__":
    main()
