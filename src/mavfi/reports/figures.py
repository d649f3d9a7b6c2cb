"""Figures of a report: success with intervals, flight times, and what each state costs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from mavfi.campaign.plan import FI
from mavfi.reports import style, text
from mavfi.reports.tables import Analysis, Entry, populations_of


def draw(analysis: Analysis, directory: Path) -> list[str]:
    """Draw every figure for which there is something to show; a campaign of kernels has tables and a page of its own.

    Returns:
        Names of the files in the directory.

    Raises:
        BadInputError: The directory cannot be written.
    """
    makers: dict[str, Callable[[Analysis], Figure | None]] = {
        "success.png": success, "flight_time.png": flight_time, "states.png": states,
    }  # fmt: skip
    if analysis["campaign"]["law"] == "kernels":
        return []
    written = []
    with style.house_style():
        for name, maker in makers.items():
            figure = maker(analysis)
            if figure is not None:
                style.write(figure, directory / name)
                written.append(name)
    return written


def _headline(entries: list[Entry]) -> list[Entry]:
    """Golden runs, and the first bit stratum of the others."""
    populations = populations_of(entries)
    wanted = {"all", *populations[:1]}
    return [entry for entry in entries if entry["population"] in wanted]


def _leading(entries: list[Entry], name: str) -> list[Entry]:
    """Of each value and setting the leading bit stratum; groups may be drawn from strata of their own."""
    order = populations_of(entries)
    found: dict[tuple[str, ...], Entry] = {}
    for entry in sorted(entries, key=lambda entry: order.index(entry["population"])):
        found.setdefault((entry["environment"], entry[name], entry["setting"]), entry)
    places = [(entry["environment"], entry[name], entry["setting"]) for entry in entries]
    return [found[place] for place in dict.fromkeys(places)]


def _names(entries: list[Entry], key: str) -> list[str]:
    return list(dict.fromkeys(entry[key] for entry in entries))


def success(analysis: Analysis) -> Figure | None:
    """Success by environment and setting, with intervals and the paper's figures."""
    entries = [entry for entry in _headline(list(analysis["success"])) if not entry["setting"].startswith("golden_")]
    environments, settings = _names(entries, "environment"), _names(entries, "setting")
    if not entries:
        return None
    figure = Figure(figsize=(max(6.6, 1.6 + 1.7 * len(environments)), 3.9), layout="constrained")
    axes = figure.subplots()
    colours = style.setting_colours(settings)
    width = 0.8 / len(settings)
    lowest = 1.0
    for place, setting in enumerate(settings):
        own = {entry["environment"]: entry for entry in entries if entry["setting"] == setting}
        at = np.array([i for i, name in enumerate(environments) if name in own and own[name]["rate"] is not None])
        shown = [own[environments[i]] for i in at]
        if not shown:
            continue
        x = at - 0.4 + (place + 0.5) * width
        rates = np.array([entry["rate"] for entry in shown])
        bounds = np.array([[entry["low"], entry["high"]] for entry in shown])
        errors = np.abs(bounds.T - rates)
        axes.errorbar(
            x, rates, errors, fmt="o", color=colours[setting], markersize=7, elinewidth=2.2, capsize=0, label=setting,
            clip_on=False, zorder=4,
        )  # fmt: skip
        lowest = min(lowest, float(bounds.min()))
        beside = [(a, entry["paper"]) for a, entry in zip(x, shown, strict=True) if entry["paper"] is not None]
        for a, value in beside:
            ends = [a - 0.36 * width, a + 0.36 * width]
            axes.plot(ends, [value] * 2, color=style.INK, linewidth=2.0, zorder=3, clip_on=False)
            lowest = min(lowest, value)
    _frame(axes, environments, max(0.0, np.floor(10 * lowest - 0.5) / 10))
    axes.set_title(f"Success · stack {analysis['campaign']['stack']} · one fault per mission", pad=10)
    handles, labels = axes.get_legend_handles_labels()
    if any(entry["paper"] is not None for entry in entries):
        handles.append(Line2D([], [], color=style.INK, linewidth=2.0))
        labels.append("the paper (instruction level)")
    figure.legend(handles, labels, loc="outside lower left", ncols=6, fontsize=8.5, columnspacing=1.2, handlelength=1.2)
    return figure


def _frame(axes: Axes, environments: list[str], lowest: float) -> None:
    axes.set_ylim(lowest, 1.0)
    axes.set_xlim(-0.5, len(environments) - 0.5)
    axes.set_xticks(range(len(environments)), environments)
    for place in range(1, len(environments)):
        axes.axvline(place - 0.5, color=style.PALE, linewidth=0.8)
    axes.tick_params(axis="x", length=0)
    axes.yaxis.set_major_formatter(lambda share, _: f"{100 * share:.0f} %")
    axes.grid(axis="y")
    axes.set_ylabel("missions that succeed")


def flight_time(analysis: Analysis) -> Figure | None:
    """Share of missions that arrived within a flight time relative to the golden twin's; failures never arrive."""
    entries = [entry for entry in analysis["flight_times"] if entry["n"]]
    environments, settings = _names(entries, "environment"), _names(entries, "setting")
    if not entries:
        return None
    figure = Figure(figsize=(max(4.2, 1.2 + 2.7 * len(environments)), 3.4), layout="constrained")
    panels = figure.subplots(1, len(environments), sharey=True, squeeze=False)[0]
    colours = style.setting_colours(settings)
    lowest = min(_arrived(entry, -0.02) for entry in entries)
    for axes, environment in zip(panels, environments, strict=True):
        own = [entry for entry in entries if entry["environment"] == environment]
        reach = max([0.1, *(x for entry in own for x in entry["inflations"])]) * 1.08
        fastest = min([0.0, *(x for entry in own for x in entry["inflations"])])
        for entry in own:
            values = np.array(entry["inflations"])
            x = np.concatenate([[-1.0], values, [reach]])
            share = np.concatenate([[0.0], np.arange(1, len(values) + 1), [len(values)]]) / entry["n"]
            width = 2.8 if entry["setting"] == FI else 1.4  # where arms do as fi does, both are seen
            axes.step(x, share, where="post", color=colours[entry["setting"]], linewidth=width, label=entry["setting"])
        axes.set_title(environment)
        axes.set_xlim(fastest - 0.02, reach)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.xaxis.set_major_formatter(_signed)
        axes.grid(True)
        axes.set_xlabel("flight time against golden")
    panels[0].set_ylim(max(0.0, np.floor(10 * lowest) / 10 - 0.1), 1.005)
    panels[0].yaxis.set_major_formatter(lambda share, _: f"{100 * share:.0f} %")
    panels[0].set_ylabel("missions that arrived")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=6, fontsize=8.5, handlelength=1.4)
    return figure


def _signed(share: float, _: int) -> str:
    """A difference as text; none has no sign."""
    percent = round(100 * share)
    return f"{percent:+d} %" if percent else "0 %"


def _arrived(entry: Entry, inflation: float) -> float:
    """Share of the missions that arrived within a flight time relative to the golden twin's."""
    return float(np.sum(np.array(entry["inflations"]) <= inflation)) / int(entry["n"])


def states(analysis: Analysis) -> Figure | None:
    """What each state (or group of fields) costs: share of missions that fail or take more than 5 % longer."""
    key, name = ("by_target", "target") if analysis["campaign"]["law"] == "groups" else ("by_state", "state")
    entries = _leading(analysis[key], name)
    environments = _names(entries, "environment")
    whole = "all" if "all" in environments else (environments[0] if environments else "")
    entries = [entry for entry in entries if entry["environment"] == whole]
    if not entries:
        return None
    values, settings = _names(entries, name), _names(entries, "setting")
    figure = Figure(figsize=(7.6, 1.2 + 0.2 * len(values) * (1 + 0.5 * len(settings))), layout="constrained")
    axes = figure.subplots()
    colours = style.setting_colours(settings)
    for place, setting in enumerate(settings):
        own = [entry for entry in entries if entry["setting"] == setting]
        offset = 0.7 * (place - (len(settings) - 1) / 2) / len(settings)
        y = np.array([values.index(entry[name]) for entry in own]) + offset
        _points(axes, own, y, colours[setting], setting)
    axes.set_yticks(range(len(values)), values)
    axes.set_ylim(len(values) - 0.5, -0.5)
    axes.set_xlim(0, None)
    axes.xaxis.set_major_formatter(lambda share, _: f"{100 * share:.0f} %")
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)
    bits = ", ".join(text.population(name) for name in _names(entries, "population"))
    where = "all environments" if whole == "all" else whole
    axes.set_xlabel(f"missions that fail or take more than 5 % longer\n({bits}; {where})")
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=6, fontsize=8.5, handlelength=1.2)
    return figure


def _points(axes: Axes, entries: list[Entry], y: np.ndarray, colour: str, label: str) -> None:
    shown: list[dict[str, Any]] = [entry["fails_or_slower"] for entry in entries]
    rates = np.array([0.0 if hurt["rate"] is None else hurt["rate"] for hurt in shown])
    bounds = np.array([[hurt["low"] or 0.0, hurt["high"] or 0.0] for hurt in shown])
    errors = np.abs(bounds.T - rates)
    axes.errorbar(
        rates, y, xerr=errors, fmt="o", color=colour, markersize=4.5, elinewidth=1.2, capsize=2, label=label,
        clip_on=False, zorder=4,
    )  # fmt: skip
