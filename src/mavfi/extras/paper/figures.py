"""Figures of the paper: flight time and success by kernel, state and bit class (Fig. 3, 4), distributions (Fig. 6)."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, PercentFormatter

from mavfi.analysis.measures import rate_of
from mavfi.analysis.runs import Runs
from mavfi.extras.paper.views import GOLDEN_ROW, by_bits, by_kernel, by_state, distribution, value_at_risk
from mavfi.plugins import Chapter
from mavfi.report import links, style
from mavfi.report.figures import Drawing

_ROW = 0.3
"""Height of a row (in)."""
_BOX = 0.5
"""Height of a box relative to that of its row."""


def _rows(runs: Runs, select: Callable[[Runs], Runs], column: str) -> Figure | None:
    """Flight times of successful missions (left) and success (right), one row per value of a column."""
    shown = select(runs)
    if not len(shown.injected):
        return None
    environments = {name: own.groups(column) for (name,), own in shown.groups("environment").items()}
    counts = [len(groups) for groups in environments.values()]
    height = 0.75 + sum(0.75 + _ROW * count for count in counts)
    figure = Figure(figsize=(9.2, height), layout="constrained")
    panels = figure.subplots(len(counts), 2, squeeze=False, height_ratios=counts, width_ratios=(1.6, 1), sharex="col")
    for (left, right), (environment, groups) in zip(panels, environments.items(), strict=True):
        names = [str(name) for (name,) in groups]
        golden = names.index(GOLDEN_ROW) if GOLDEN_ROW in names else None
        _times(left, [own.where("success") for own in groups.values()], golden)
        for place, own in enumerate(groups.values()):
            label = {"environment": environment, column: names[place]}
            _link_times(left, own, place, label)
            rate = rate_of(own, "success")
            if rate.rate is None or rate.low is None or rate.high is None:
                continue
            look = _look(names[place])
            links.points(right, [rate.rate], [place], [links.to_runs(own, **label)])
            right.errorbar(rate.rate, place, xerr=[[rate.rate - rate.low], [rate.high - rate.rate]], markersize=6,
                           linestyle="", elinewidth=1.8, capsize=2, clip_on=False, zorder=4, **look)  # fmt: skip
        sizes = [len(own) for own in groups.values()]
        left.set_yticks(range(len(names)), [f"{name}  (n = {n})" for name, n in zip(names, sizes, strict=True)])
        right.set_yticks(range(len(names)), [])
        left.set_title(environment)
        for axes in (left, right):
            axes.set_ylim(len(names) - 0.5, -0.5)
            axes.tick_params(axis="y", length=0)
            axes.grid(axis="x")
    panels[-1][0].set_xlabel("flight time of missions that succeed (s)")
    panels[-1][1].set_xlim(right=1.02)  # after the last environment: a limit ends autoscaling of the shared axis
    panels[-1][1].set_xlabel("missions that succeed")
    panels[-1][1].xaxis.set_major_formatter(PercentFormatter(1, 0, " %"))
    panels[-1][1].xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    return figure


def _look(name: str) -> dict[str, str]:
    return {"color": style.BLUE, "marker": "o"} if name == GOLDEN_ROW else {"color": style.ORANGE, "marker": "s"}


def _times(axes: Axes, parts: Sequence[Runs], golden: int | None) -> None:
    """Draw a box per part, and a line at the golden median."""
    for place, arrived in enumerate(parts):
        if len(arrived):
            _box(axes, arrived, place, style.BLUE if place == golden else style.ORANGE)
    if golden is not None and len(parts[golden]):
        axes.axvline(
            float(np.median(parts[golden]["flight_time_s"])),
            color=style.BLUE,
            linewidth=0.9,
            linestyle=(0, (4, 3)),
            zorder=1,
        )


def _box(axes: Axes, arrived: Runs, place: float, colour: str, *, upright: bool = False) -> None:
    """Draw median and quartiles of flight times, with every run as a dot; dots have deterministic jitter."""
    values = arrived["flight_time_s"]
    axes.boxplot(
        [values], positions=[place], widths=_BOX, orientation="vertical" if upright else "horizontal", whis=0,
        showfliers=False, showcaps=False, manage_ticks=False, zorder=3,
        medianprops={"color": style.INK, "linewidth": 2.0}, boxprops={"color": style.INK, "linewidth": 0.8},
    )  # fmt: skip
    spread = place + 0.8 * _BOX * (np.arange(len(values)) * 0.618 % 1.0 - 0.5)  # golden ratio: even, without overlap
    at = (spread, values) if upright else (values, spread)
    drawn = axes.plot(*at, ".", color=colour, markersize=4.5, markeredgewidth=0, alpha=0.65, zorder=2)
    links.dots(drawn, arrived["run_id"])


def _link_times(axes: Axes, own: Runs, place: float, label: Mapping[str, str], *, upright: bool = False) -> None:
    """Link the band of box and dots to the missions that succeed."""
    arrived = own.where("success")
    if len(arrived):
        links.band(axes, place, links.to_runs(arrived, **label), upright=upright)


# ---- Fig. 6 ------------------------------------------------------------------------------------------------------
def distributions(runs: Runs) -> Figure | None:
    """Flight times of successful missions by environment and setting, with the conditional value at risk."""
    shown = distribution(runs)
    if not len(shown.injected):
        return None
    settings, environments = shown.values("setting"), shown.values("environment")
    figure = Figure(figsize=(max(5.0, 0.8 + 2.9 * len(environments)), 4.1), layout="constrained")
    panels = figure.subplots(1, len(environments), squeeze=False, sharey=True)[0]
    looks = style.setting_looks(settings)
    for axes, environment in zip(panels, environments, strict=True):
        own = shown.where(environment=environment)
        for place, setting in enumerate(settings):
            part = own.where(setting=setting)
            arrived = part.where("success")
            values = arrived["flight_time_s"]
            if values:
                _box(axes, arrived, place, looks[setting]["color"], upright=True)
                tail = value_at_risk(values)
                axes.plot([place], [tail], "_", color=style.INK, markersize=15, markeredgewidth=1.2, zorder=4)
                axes.plot([place], [max(values)], linestyle="", markersize=6.5, zorder=5, **looks[setting])
                _link_times(axes, part, place, {"environment": environment, "setting": setting}, upright=True)
                worst = part.where("success", flight_time_s=max(values)).first("run_id")
                links.points(axes, [place], [max(values)], [links.to_run(worst)])
                axes.annotate(f"{max(values):.0f} s", (place, max(values)), (0, 6), textcoords="offset points",
                              ha="center", fontsize=8)  # fmt: skip
        limit = own.frame["time_limit_s"].max()
        axes.set_title(f"{environment} (limit {limit:.0f} s)" if isinstance(limit, float) else environment)
        axes.set_xticks(range(len(settings)), [f"{_short(name)}\n{_count(own, name)}" for name in settings], fontsize=8)
        axes.set_xlim(-0.6, len(settings) - 0.4)
        axes.tick_params(axis="x", length=0)
        axes.grid(axis="y")
        axes.margins(y=0.14)  # the worst case's time is above its mark
    panels[0].set_ylabel("flight time of missions that succeed (s)")
    handles = [
        Line2D([], [], color=style.INK, linewidth=2.0, label="median, box: quartiles"),
        Line2D([], [], color=style.INK, linestyle="", marker="_", markersize=12, label="mean of the slowest 5 %"),
        *(Line2D([], [], linestyle="", markersize=6.5, label=f"worst {style.setting_label(name)}", **looks[name])
          for name in settings),
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside upper left", ncols=3, fontsize=8.5)
    return figure


def _short(setting: str) -> str:
    kind, _, arm = setting.partition("_")
    return {"golden": "golden", "fi": "fault"}.get(kind, arm) if not arm else arm


def _count(own: Runs, setting: str) -> str:
    """Successes / n of a setting, as text."""
    part = own.where(setting=setting)
    return f"{len(part.where('success'))}/{len(part)}"


def _drawings() -> Iterable[Drawing]:
    about = (
        "left: flight times of missions that succeed, each flight, median and quartiles (dashed: median of the golden "
        "run); right: success with 95 % intervals; n missions each."
    )
    for name, title, select, column in (
        ("kernels", "Fig. 3, one fault in one instruction of one kernel", by_kernel, "kernel"),
        ("states", "Fig. 4, one fault in one inter-kernel state", by_state, "target"),
        ("bit_fields", "Section III-B, one fault by class of the flipped bit", by_bits, "bits"),
    ):
        yield Drawing(name, lambda runs, s=select, c=column: _rows(runs, s, c), f"{title}; {about}")  # type: ignore[misc]
    yield Drawing(
        "flight_time_distribution", distributions,
        "Fig. 6, flight times of missions that succeed, worst cases in seconds; below each setting: successes / n; the "
        "time limit of missions bounds every worst case.",
    )  # fmt: skip


CHAPTER = Chapter(20, tuple(_drawings()))
