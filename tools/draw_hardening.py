"""Draw docs/images/hardening.png: coverage of each kernel against its time (docs/results/hardening.md)."""

import csv
import math
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from examples.pictures.drawing import save
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mavfi.extras.hardening.report import pareto_front
from mavfi.report import style
from tools.markers import IMAGES
from tools.results import TABLES

COLUMNS = 5
NO_COVERAGE = (float("nan"),) * 3


@dataclass(frozen=True, slots=True)
class Step:
    """A row of the page's curves: time ratio; coverage and the ends of its interval, predicted and certified (%)."""

    time: float
    predicted: tuple[float, ...] = NO_COVERAGE
    certified: tuple[float, ...] = NO_COVERAGE


def curves() -> dict[str, list[Step]]:
    """Steps of each function; those without a silent corruption in the ledger are left out."""
    steps_of: dict[str, list[Step]] = {}
    with (TABLES / "hardening" / "curves.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            name = f"{row['function']} ({row['kernel']})"
            step = Step(float(row["time"]), _percents(row, "predicted"), _percents(row, "removed"))
            steps_of.setdefault(name, []).append(step)
    return {name: steps for name, steps in steps_of.items() if not np.isnan([step.predicted for step in steps]).all()}


def _percents(row: dict[str, str], key: str) -> tuple[float, ...]:
    """A rate and the ends of its interval (%)."""
    if not row[key]:
        return NO_COVERAGE
    return tuple(100 * float(row[name]) for name in (key, f"{key}_low", f"{key}_high"))


def draw(axes: Axes, name: str, steps: list[Step]) -> None:
    """Draw one function."""
    # what was predicted: the front with its band, every step as a dot; unprotected code is at (1, 0)
    times = np.array([1.0, *(step.time for step in steps)])
    rate, low, high = np.array([(0.0, 0.0, 0.0), *(step.predicted for step in steps)]).T
    front = pareto_front(times.tolist(), rate.tolist())
    axes.fill_between(times[front], low[front], high[front], color=style.SKY, alpha=0.3, linewidth=0)
    axes.plot(times[front], rate[front], color=style.BLUE, linewidth=1.6)
    axes.plot(times, rate, "o", color=style.BLUE, markersize=3.5)

    # what was certified, with the lengths of its bars; bars are cut at 0
    certified = np.array([step.certified for step in steps])
    lower = certified[:, 0] - np.maximum(certified[:, 1], 0.0)
    upper = certified[:, 2] - certified[:, 0]
    axes.errorbar(
        times[1:],
        certified[:, 0],
        (lower, upper),
        fmt="s",
        color=style.ORANGE,
        markersize=6,
        capsize=3,
        markeredgecolor="white",
        linewidth=1.2,
        zorder=5,
    )
    function, _, kernel = name.partition(" (")
    axes.set_title(f"{function}\n({kernel}", fontsize=9)
    axes.grid(visible=True)


def main() -> None:
    """Draw all functions."""
    steps_of = curves()
    with style.house_style():
        # a panel for each function; the last row may have empty ones
        rows = math.ceil(len(steps_of) / COLUMNS)
        figure, grid = plt.subplots(
            rows, COLUMNS, figsize=(11, 2.4 * rows + 0.8), sharex=True, sharey=True, layout="constrained", squeeze=False
        )
        for axes in grid.flat[len(steps_of) :]:
            axes.set_axis_off()
        for axes, (name, steps) in zip(grid.flat, steps_of.items(), strict=False):
            draw(axes, name, steps)

        # limits, and texts of the whole figure
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
