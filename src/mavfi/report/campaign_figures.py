"""General figures of a campaign: success with intervals, and flight times."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, PercentFormatter

from mavfi.analysis import published as paper
from mavfi.analysis.measures import (
    in_leading,
    leading,
    leading_faults,
    leads,
    population_names,
    population_text,
)
from mavfi.analysis.rows import POPULATIONS
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate
from mavfi.analysis.views import has
from mavfi.campaign.plan import FI, GOLDEN
from mavfi.plugins import Chapter
from mavfi.report import links, style
from mavfi.report.figures import Drawing

_LEGEND: dict[str, Any] = {"columnspacing": 1.2, "fontsize": 8.5, "handlelength": 1.8}


# ---- success -----------------------------------------------------------------------------------------------------
def success(runs: Runs) -> Figure | None:
    """Success by environment and setting, with intervals, counts and the paper's values, for faults of any level."""
    chosen = _flown(runs)
    settings = _settings(chosen)
    environments = chosen.values("environment")
    if settings in ([], [GOLDEN]):
        return None
    names = population_names(chosen, ("environment", "setting"))
    figure = Figure(figsize=(max(6.6, 1.6 + 1.7 * len(environments)), 3.9), layout="constrained")
    axes = figure.subplots()
    looks = style.setting_looks(settings)
    width = 0.8 / len(settings)
    lowest = 1.0
    handles: list[Line2D] = []
    for place, setting in enumerate(settings):
        found = _rates(chosen, setting, names)
        at = np.array([environments.index(name) for name in found]) - 0.4 + (place + 0.5) * width
        rates = list(found.values())
        look = looks[setting]
        behind = {name: in_leading(chosen.where(environment=name, setting=setting), names) for name in found}
        urls = [links.to_runs(own, environment=name, setting=setting) for name, own in behind.items()]
        _points(axes, at, rates, look, urls)
        handles.append(_handle(setting, look, 7))
        lowest = min([lowest, *(rate.low for rate in rates if rate.low is not None)])
        for x, (environment, rate) in zip(at, found.items(), strict=True):
            if rate.low is not None:
                axes.annotate(
                    f"{rate.n}",
                    (x, rate.low),
                    (0, -9),
                    textcoords="offset points",
                    ha="center",
                    zorder=6,
                    bbox=_OVER_LINES,
                    **_SMALL,
                )
            figured = _paper(chosen, environment, setting)
            if figured is not None:
                axes.plot([x - 0.4 * width, x + 0.4 * width], [figured, figured], color=style.INK, zorder=5)
                lowest = min(lowest, figured)
    if any(_paper(chosen, name, setting) is not None for name in environments for setting in settings):
        handles.append(Line2D([], [], color=style.INK, label="the paper's figure"))
    bottom = max(0.0, np.floor(10 * lowest - 0.5) / 10)
    axes.set_ylim(bottom, 1.0 + 0.04 * (1.0 - bottom))  # markers at 100 % keep clear of the title
    axes.set_xlim(-0.5, len(environments) - 0.5)
    axes.set_xticks(range(len(environments)), environments)
    for place in range(1, len(environments)):
        axes.axvline(place - 0.5, color=style.PALE, linewidth=0.8)
    axes.tick_params(axis="x", length=0)
    axes.yaxis.set_major_formatter(PercentFormatter(1, 0, " %"))
    axes.grid(axis="y")
    axes.set_ylabel("missions that succeed")
    if names:
        bits = f"faults in {POPULATIONS.get(names[0], names[0])}; "
    else:
        bits = ""
    if has(chosen, level="instruction"):
        dead = "nodes that die are restarted; "
    else:
        dead = ""
    axes.set_xlabel(f"{bits}{dead}95 % intervals, number of missions below each", fontsize=8.5, color=style.GREY)
    if runs.campaign.get("profile"):
        profile = f" · autopilot {runs.campaign['profile']}"
    else:
        profile = ""
    axes.set_title(f"Success{profile} · one fault per mission")
    labels = [str(handle.get_label()) for handle in handles]
    figure.legend(handles=handles, loc="outside upper left", **_legend(figure, labels))
    return figure


def _legend(figure: Figure, labels: Iterable[str]) -> dict[str, Any]:
    """Options of a legend with as many columns as fit above a figure."""
    longest = max(map(len, labels))
    return {**_LEGEND, "ncols": max(1, int(figure.get_figwidth() / (_LEGEND_MARK + _LEGEND_LETTER * longest)))}


_SMALL: dict[str, Any] = {"fontsize": 6.5, "color": style.GREY}
_OVER_LINES: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.4}
_LEGEND_MARK = 0.5
_LEGEND_LETTER = 0.06
"""Width of a legend's column without its text, and of a letter (inches)."""


def _flown(runs: Runs) -> Runs:
    """Judged golden runs without a detector, and judged runs with faults."""
    judged = runs.where("judged")
    kept = [GOLDEN, *judged.injected.values("setting")]
    return judged.where(pl.col("setting").is_in(kept))


def _settings(runs: Runs) -> list[str]:
    """Settings in order: golden, faults without a detector, arms."""
    injected = runs.settings()
    if len(runs.where(setting=GOLDEN)):
        return [GOLDEN, *injected]
    return injected


def _rates(runs: Runs, setting: str, names: list[str]) -> dict[str, Rate]:
    """Success rates by environment, without undefined ones."""
    parts = runs.where(setting=setting).groups("environment")
    found = {environment: leading(own, names, "success") for (environment,), own in parts.items()}
    return {environment: rate for environment, rate in found.items() if rate is not None and rate.rate is not None}


def _paper(runs: Runs, environment: str, setting: str) -> float | None:
    own = runs.where(environment=environment, setting=setting)
    if not len(own) or not paper.comparable(runs.campaign, own.first("detector_profile")):
        return None
    return paper.success(environment, setting)


def _handle(setting: str, look: Mapping[str, Any], size: float) -> Line2D:
    """Legend entry of a setting."""
    return Line2D([], [], label=style.setting_label(setting), linestyle="", markersize=size, **look)


def _points(axes: Axes, at: np.ndarray, rates: list[Rate], look: Mapping[str, Any], urls: list[str]) -> None:
    """Draw rates with intervals along the y axis, each linked to its runs."""
    values = np.array([rate.rate or 0.0 for rate in rates])
    bounds = np.array([[rate.low or 0.0, rate.high or 0.0] for rate in rates]).reshape(-1, 2)
    errors = np.abs(bounds.T - values)
    axes.errorbar(
        at, values, yerr=errors, fmt="", linestyle="", markersize=6, elinewidth=1.8, clip_on=False, zorder=4, **look
    )
    links.points(axes, at, values, urls)


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
        own = {setting: judged.where(environment=environment, setting=setting) for setting in settings}
        counts = {setting: len(part) for setting, part in own.items() if len(part)}
        values = {setting: np.sort(own[setting].frame["inflation"].drop_nulls().to_numpy()) for setting in counts}
        reach = 1.08 * max([0.1, *(float(part.max()) for part in values.values() if len(part))])
        fastest = min([0.0, *(float(part.min()) for part in values.values() if len(part))])
        for setting, part in values.items():
            n = counts[setting]
            share = np.concatenate([[0.0], np.arange(1, len(part) + 1), [len(part)]]) / n
            look = style.curve(looks[setting], wide=setting == FI)  # visible where an arm coincides with fi
            x = np.concatenate([[-1.0], part, [reach]])
            curve = axes.step(x, share, where="post", label=style.setting_label(setting), **look)
            links.lines(curve, links.to_runs(own[setting], environment=environment, setting=setting))
            lowest = min(lowest, float((part <= -0.02).sum()) / n)
        axes.set_title(f"{environment}, n = {_range(counts.values())}")
        axes.set_xlim(fastest - 0.02, reach)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.xaxis.set_major_formatter(_signed)
        axes.grid(True)
        axes.set_xlabel("flight time against the golden run's")
    panels[0].set_ylim(max(0.0, np.floor(10 * lowest) / 10 - 0.1), 1.005)
    panels[0].yaxis.set_major_formatter(PercentFormatter(1, 0, " %"))
    panels[0].set_ylabel("missions that arrived")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", **_legend(figure, labels))
    return figure


def _arrival_caption(runs: Runs) -> str:
    text = population_text(leads(population_names(runs.injected, ())))
    bits = f" in {text} bits" if text else ""
    return f"Share of missions that arrived, faults{bits}, by flight time over the golden run's; lost ones never do."


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
        Drawing("success", success, "Success with 95 % intervals; horizontal bars: the paper's figures.", general=True),
        Drawing("flight_time", flight_time, _arrival_caption, general=True),
    ),
)
