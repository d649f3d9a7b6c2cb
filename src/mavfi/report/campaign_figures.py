"""General figures of a campaign: success with intervals, and flight times."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, PercentFormatter

from mavfi.analysis import published as paper
from mavfi.analysis.measures import (
    leading_faults,
    leading_populations,
    leading_rate,
    leading_runs,
    population_names,
    population_text,
)
from mavfi.analysis.rows import ALL_BITS, INJECTED, POPULATIONS
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate
from mavfi.analysis.views import has
from mavfi.campaign.plan import FI, GOLDEN
from mavfi.plugins import Chapter
from mavfi.report import links, style
from mavfi.report.figures import Drawing

_LEGEND: dict[str, Any] = {"columnspacing": 1.2, "fontsize": 8.5, "handlelength": 1.8}


# ---- success -----------------------------------------------------------------------------------------------------
class SuccessCell(NamedTuple):
    """The success of a setting in an environment.

    Attributes:
        environment: Name of the environment.
        setting: Name of the setting.
        rate: The rate, with its interval.
        published: The paper's rate; None = not comparable.
        link: Link to the runs behind it; "" = none.
    """

    environment: str
    setting: str
    rate: Rate
    published: float | None = None
    link: str = ""


def success(runs: Runs) -> Figure | None:
    """Success by environment and setting, with intervals, counts and the paper's values, for faults of any level."""
    # judged golden runs without a detector, and judged runs with faults
    judged = runs.where("judged")
    chosen = judged.where(pl.col("setting").is_in([GOLDEN, *judged.injected.values("setting")]))
    settings = chosen.settings()
    if len(chosen.where(setting=GOLDEN)):
        settings = [GOLDEN, *settings]
    if settings in ([], [GOLDEN]):
        return None
    names = population_names(chosen, ("environment", "setting"))
    summarized = leading_populations(chosen)
    if len(summarized) > 1 and not population_text(summarized):  # a group would be left out: all faults are shown
        is_faulty = pl.col("kind") == INJECTED
        chosen = chosen.adding(population=pl.when(is_faulty).then(pl.lit(ALL_BITS)).otherwise(pl.col("population")))
        names = [ALL_BITS]
    cells = []
    for setting in settings:
        for environment, rate in _rates(chosen, setting, names).items():
            missions = chosen.where(environment=environment, setting=setting)
            link = links.to_runs(leading_runs(missions, names), environment=environment, setting=setting)
            published = None
            if paper.comparable(missions):
                published = paper.success(environment, setting)
            cells.append(SuccessCell(environment, setting, rate, published, link))
    conditions = "95 % intervals, n below each"
    if has(chosen, level="instruction"):
        conditions = f"nodes that die are restarted; {conditions}"
    if names and chosen.injected.values("level") != ["sensor"]:  # those of sensors are in no bits
        conditions = f"faults in {POPULATIONS.get(names[0], names[0])}; {conditions}"
    title = "Success"
    if runs.campaign.get("profile"):
        title = f"Success · autopilot {runs.campaign['profile']}"
    return draw_success(cells, f"{title} · {runs.per_mission} per mission", conditions)


def draw_success(cells: Sequence[SuccessCell], title: str, conditions: str) -> Figure:
    """Draw rates of success.

    Args:
        cells: The rates, in the order of the settings.
        title: Above the axes.
        conditions: Below them.
    """
    environments = list(dict.fromkeys(cell.environment for cell in cells))
    settings = list(dict.fromkeys(cell.setting for cell in cells))
    figure = Figure(figsize=(max(6.6, 1.6 + 1.7 * len(environments)), 3.9), layout="constrained")
    axes = figure.subplots()
    looks = style.setting_looks(settings)

    # one column of points per setting within the space of each environment, linked to the runs behind them
    width = 0.8 / len(settings)
    columns = {}
    for cell in cells:
        x = environments.index(cell.environment) - 0.4 + (settings.index(cell.setting) + 0.5) * width
        columns[x] = f"{cell.rate.n}"
        _point(axes, x, cell, looks[cell.setting])
        # the paper's bar lies behind the point, and is seen on both sides of it
        if cell.published is not None:
            ends = [x - 0.44 * width, x + 0.44 * width]
            axes.plot(ends, [cell.published] * 2, color=style.PAPER, linewidth=2.0, zorder=3, clip_on=False)

    # axes: from the tenth below the lowest bound, but half a tenth away from it
    bounds = [bound for cell in cells for bound in (cell.rate.low, cell.published) if bound is not None]
    bottom = max(0.0, np.floor(10 * min([1.0, *bounds]) - 0.2) / 10)
    axes.set_ylim(bottom, 1.0 + 0.04 * (1.0 - bottom))  # markers at 100 % keep clear of the title
    axes.set_xlim(-0.5, len(environments) - 0.5)
    axes.xaxis.remove_overlapping_locs = False  # the count in the middle is above the name of the environment
    axes.set_xticks(sorted(columns), [columns[x] for x in sorted(columns)], minor=True, **_SMALL)
    axes.tick_params(axis="x", which="minor", length=0, pad=3)
    if len(settings) > _MAX_UPRIGHT_COUNTS:
        axes.tick_params(axis="x", which="minor", rotation=90)
    axes.set_xticks(range(len(environments)), environments)
    axes.tick_params(axis="x", length=0, pad=16)
    for index in range(1, len(environments)):
        axes.axvline(index - 0.5, color=style.PALE, linewidth=0.8)
    axes.yaxis.set_major_formatter(PercentFormatter(1, 0, " %"))
    axes.grid(axis="y")

    # texts
    axes.set_ylabel("missions that succeed")
    axes.set_xlabel(conditions, fontsize=8.5, color=style.GREY)
    axes.set_title(title)
    handles = [
        Line2D([], [], label=style.setting_label(setting), linestyle="", markersize=7, **looks[setting])
        for setting in settings
    ]
    if any(cell.published is not None for cell in cells):
        handles.append(Line2D([], [], color=style.PAPER, linewidth=2.0, label="the paper"))
    labels = [str(handle.get_label()) for handle in handles]
    figure.legend(handles=handles, loc="outside upper left", **_legend(figure, labels))
    return figure


def _legend(figure: Figure, labels: Iterable[str]) -> dict[str, Any]:
    """Options of a legend with as many columns as fit above a figure."""
    longest = max(map(len, labels))
    return {**_LEGEND, "ncols": max(1, int(figure.get_figwidth() / (_LEGEND_MARK + _LEGEND_LETTER * longest)))}


_SMALL: dict[str, Any] = {"fontsize": 6.5, "color": style.GREY}
_MAX_UPRIGHT_COUNTS = 6
"""Largest number of settings whose numbers of missions fit side by side below an environment."""
_LEGEND_MARK = 0.5
_LEGEND_LETTER = 0.06
"""Width of a legend's column without its text, and of a letter (inches)."""


def _rates(runs: Runs, setting: str, names: list[str]) -> dict[str, Rate]:
    """Success rates by environment, without undefined ones."""
    rates = {}
    for (environment,), missions in runs.where(setting=setting).groups("environment").items():
        rate = leading_rate(missions, names, "success")
        if rate is not None and rate.rate is not None:
            rates[environment] = rate
    return rates


def _point(axes: Axes, x: float, cell: SuccessCell, look: Mapping[str, Any]) -> None:
    """Draw a rate with its interval, linked to its runs."""
    rate = cell.rate
    value = rate.rate or 0.0
    errors = [[value - (rate.low or 0.0)], [(rate.high or 0.0) - value]]
    axes.errorbar(
        x,
        value,
        yerr=np.abs(errors),
        fmt="",
        linestyle="",
        markersize=6,
        elinewidth=1.8,
        clip_on=False,
        zorder=4,
        **look,
    )
    if cell.link:
        links.points(axes, [x], [value], [cell.link])


def _success_caption(runs: Runs) -> str:
    if paper.compared(runs.campaign):
        return "Success with 95 % intervals; horizontal bars: the paper's figures."
    return "Success with 95 % intervals."


# ---- flight time -------------------------------------------------------------------------------------------------
def flight_time(runs: Runs) -> Figure | None:
    """Cumulative share of arrived missions by flight time relative to the golden run; failures never arrive."""
    judged = leading_faults(runs)
    settings = judged.settings()
    environments = judged.values("environment")
    if not settings:
        return None
    figure = Figure(figsize=(max(4.2, 1.2 + 2.7 * len(environments)), 3.6), layout="constrained")
    panels = figure.subplots(1, len(environments), sharey=True, squeeze=False)[0]
    looks = style.setting_looks(settings)
    lowest = 1.0
    for axes, environment in zip(panels, environments, strict=True):
        # flight times of the missions that arrived, in ascending order, relative to the golden run's
        by_setting = {setting: judged.where(environment=environment, setting=setting) for setting in settings}
        flown = {setting: missions for setting, missions in by_setting.items() if len(missions)}
        times = {
            setting: np.sort(missions.frame["inflation"].drop_nulls().to_numpy()) for setting, missions in flown.items()
        }
        slowest = 1.08 * max([0.1, *(float(values.max()) for values in times.values() if len(values))])
        fastest = min([0.0, *(float(values.min()) for values in times.values() if len(values))])
        # curves rise from 0, left of the panel, to the share that arrived, at its right edge
        for setting, missions in flown.items():
            values = times[setting]
            arrived = np.concatenate([[0.0], np.arange(1, len(values) + 1), [len(values)]])
            look = style.curve(looks[setting], wide=setting == FI)  # visible where an arm coincides with fi
            x = np.concatenate([[-1.0], values, [slowest]])
            label = style.setting_label(setting)
            curve = axes.step(x, arrived / len(missions), where="post", label=label, **look)
            links.lines(curve, links.to_runs(missions, environment=environment, setting=setting))
            lowest = min(lowest, float((values <= -0.02).sum()) / len(missions))
        axes.set_title(f"{environment}, n = {_range(len(missions) for missions in flown.values())}")
        axes.set_xlim(fastest - 0.02, slowest)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.xaxis.set_major_formatter(_signed)
        axes.grid(True)
        axes.set_xlabel("flight time against the golden run's")
    # shared by all panels; most missions arrive, so the axis begins where the first curve does
    panels[0].set_ylim(max(0.0, np.floor(10 * lowest) / 10 - 0.1), 1.005)
    panels[0].yaxis.set_major_formatter(PercentFormatter(1, 0, " %"))
    panels[0].set_ylabel("missions that arrived")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", **_legend(figure, labels))
    return figure


def _arrival_caption(runs: Runs) -> str:
    text = population_text(leading_populations(runs))
    faults = f"faults in {text} bits" if text else "faults"
    return f"Share of missions that arrived, {faults}, by flight time over the golden run's; lost ones never do."


def _range(counts: Iterable[int]) -> str:
    """Format counts as a single number or a range."""
    numbers = sorted(set(counts))
    if len(numbers) == 1:
        return f"{numbers[0]}"
    return f"{numbers[0]}–{numbers[-1]}"


def _signed(share: float, _: float) -> str:
    """Format a relative difference with its sign; zero has none."""
    percent = round(100 * share)
    if percent:
        return f"{percent:+d} %"
    return "0 %"


CHAPTER = Chapter(
    10,
    (
        Drawing("success", success, _success_caption, general=True),
        Drawing("flight_time", flight_time, _arrival_caption, general=True),
    ),
)
