"""Figures of the paper: Fig. 3, 4 and 6 (flight time and success), 7 (paths), 8 (redundancy) and 9 (platforms)."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator, PercentFormatter
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

from mavfi.analysis import published as paper
from mavfi.analysis.measures import against_fi, rate_of
from mavfi.analysis.rows import ACTIVATED
from mavfi.analysis.runs import Runs
from mavfi.campaign.plan import FI, GOLDEN
from mavfi.extras.paper.redundancy import (
    SCHEMES,
    DesignConfig,
    band,
    energy,
    ratio,
    shipped_designs,
)
from mavfi.extras.paper.views import (
    GOLDEN_ROW,
    by_bits,
    by_kernel,
    by_state,
    distribution,
    platform_flights,
    platforms,
    value_at_risk,
)
from mavfi.mission import MissionStatus
from mavfi.plugins import Chapter
from mavfi.report import links, style
from mavfi.report.figures import Drawing
from mavfi.report.numbers import signed_percent
from mavfi.report.picture import near_boxes, positions

if TYPE_CHECKING:
    from mavfi.flight.host import Flight


_ROW = 0.3
"""Height of a row (in)."""
_BOX = 0.5
"""Height of a box relative to that of its row."""


def _rows(runs: Runs, select: Callable[[Runs], Runs], column: str) -> Figure | None:
    """Flight times of successful missions (left) and success (right), one row per value of a column."""
    # a pair of panels for each environment, as high as its number of rows
    selected = select(runs)
    if not len(selected.injected):
        return None
    environments = {name: flights.groups(column) for (name,), flights in selected.groups("environment").items()}
    counts = [len(groups) for groups in environments.values()]
    height = 0.75 + sum(0.75 + _ROW * count for count in counts)
    figure = Figure(figsize=(9.2, height), layout="constrained")
    panels = figure.subplots(len(counts), 2, squeeze=False, height_ratios=counts, width_ratios=(1.6, 1), sharex="col")

    # a box and a mark for each row
    for (left, right), (environment, groups) in zip(panels, environments.items(), strict=True):
        labels = []
        for row, ((name,), flights) in enumerate(groups.items()):
            labels.append(f"{name}  (n = {len(flights)})")
            label = {"environment": environment, column: str(name)}
            look = {"color": style.FAULT, "marker": "s"}
            if name == GOLDEN_ROW:
                look = {"color": style.GOLDEN, "marker": "o"}
            arrived = _box(left, flights, row, look["color"], label)
            _success_mark(right, flights, row, look, label)
            if name == GOLDEN_ROW and len(arrived):
                median = float(np.median(arrived["flight_time_s"]))
                left.axvline(median, color=style.GOLDEN, linewidth=0.9, linestyle=(0, (4, 3)), zorder=1)
        left.set_yticks(range(len(labels)), labels)
        right.set_yticks(range(len(labels)), [])
        left.set_title(environment)
        for axes in (left, right):
            axes.set_ylim(len(labels) - 0.5, -0.5)
            axes.tick_params(axis="y", length=0)
            axes.grid(axis="x")

    # the shared axes are labelled at the last environment
    panels[-1][0].set_xlabel("flight time of missions that succeed (s)")
    panels[-1][1].set_xlim(right=1.02)  # after the last environment: a limit ends autoscaling of the shared axis
    panels[-1][1].set_xlabel("missions that succeed")
    panels[-1][1].xaxis.set_major_formatter(PercentFormatter(1, 0, " %"))
    panels[-1][1].xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    return figure


def _success_mark(axes: Axes, flights: Runs, row: int, look: dict[str, Any], label: Mapping[str, str]) -> None:
    """Draw the share of missions that succeed, with its interval."""
    rate = rate_of(flights, "success")
    if rate.rate is None or rate.low is None or rate.high is None:
        return
    links.points(axes, [rate.rate], [row], [links.to_runs(flights, **label)])
    axes.errorbar(
        rate.rate,
        row,
        xerr=[[rate.rate - rate.low], [rate.high - rate.rate]],
        markersize=6,
        linestyle="",
        elinewidth=1.8,
        capsize=2,
        clip_on=False,
        zorder=4,
        **look,
    )


def _box(
    axes: Axes, flights: Runs, position: float, colour: str, label: Mapping[str, str], *, upright: bool = False
) -> Runs:
    """Draw median and quartiles of the flights that succeed, with each as a dot; returns these flights.

    Dots have deterministic jitter; box and dots link to the flights, which `label` names.
    """
    arrived = flights.where("success")
    if not len(arrived):
        return arrived
    values = arrived["flight_time_s"]
    orientation: Literal["horizontal", "vertical"] = "horizontal"
    if upright:
        orientation = "vertical"
    axes.boxplot(
        [values],
        positions=[position],
        widths=_BOX,
        orientation=orientation,
        whis=0,
        showfliers=False,
        showcaps=False,
        manage_ticks=False,
        zorder=3,
        medianprops={"color": style.INK, "linewidth": 2.0},
        boxprops={"color": style.INK, "linewidth": 0.8},
    )
    spread = position + 0.8 * _BOX * (np.arange(len(values)) * 0.618 % 1.0 - 0.5)  # golden ratio: even, without overlap
    x = spread if upright else values
    y = values if upright else spread
    dots = axes.plot(x, y, ".", color=colour, markersize=4.5, markeredgewidth=0, alpha=0.65, zorder=2)
    links.dots(dots, arrived["run_id"])
    links.band(axes, position, links.to_runs(arrived, **label), upright=upright)
    return arrived


# ---- Fig. 6 ------------------------------------------------------------------------------------------------------
def distributions(runs: Runs) -> Figure | None:
    """Flight times of successful missions by environment and setting, with the conditional value at risk."""
    # a panel for each environment, a column for each setting
    selected = distribution(runs)
    if not len(selected.injected):
        return None
    settings = selected.values("setting")
    environments = selected.values("environment")
    figure = Figure(figsize=(max(5.0, 0.8 + 2.9 * len(environments)), 4.1), layout="constrained")
    panels = figure.subplots(1, len(environments), squeeze=False, sharey=True)[0]
    looks = style.setting_looks(settings)
    for axes, environment in zip(panels, environments, strict=True):
        flights = selected.where(environment=environment)
        for column, setting in enumerate(settings):
            label = {"environment": environment, "setting": setting}
            _setting_column(axes, flights.where(setting=setting), column, looks[setting], label)
        title = environment
        limit = flights.frame["time_limit_s"].max()
        if isinstance(limit, float):
            title = f"{environment} (limit {limit:.0f} s)"
        axes.set_title(title)
        names = []
        for name in settings:
            part = flights.where(setting=name)
            names.append(f"{_setting_words(name)}\n{len(part.where('success'))}/{len(part)}")
        _settings_axis(axes, names)
        axes.margins(y=0.14)  # the worst case's time is above its mark
    panels[0].set_ylabel("flight time of missions that succeed (s)")

    # the legend explains box, mean and worst
    handles = [
        Line2D([], [], color=style.INK, linewidth=2.0, label="median, box: quartiles"),
        Line2D([], [], color=style.INK, linestyle="", marker="_", markersize=12, label="mean of the slowest 5 %"),
        *(
            Line2D([], [], linestyle="", markersize=6.5, label=f"worst {style.setting_label(name)}", **looks[name])
            for name in settings
        ),
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=3, fontsize=8.5)
    return figure


def _setting_column(axes: Axes, flights: Runs, column: int, look: dict[str, Any], label: Mapping[str, str]) -> None:
    """Draw a box of the flights of a setting, the mean of the slowest, and the worst with its time."""
    arrived = _box(axes, flights, column, look["color"], label, upright=True)
    times = arrived["flight_time_s"]
    tail = value_at_risk(times)
    if tail is None:  # no mission has succeeded
        return
    axes.plot([column], [tail], "_", color=style.INK, markersize=15, markeredgewidth=1.2, zorder=4)
    worst = max(times)
    axes.plot([column], [worst], linestyle="", markersize=6.5, zorder=5, **look)
    worst_run = arrived.where(flight_time_s=worst).first("run_id")
    links.points(axes, [column], [worst], [links.to_run(worst_run)])
    axes.annotate(f"{worst:.0f} s", (column, worst), (0, 6), textcoords="offset points", ha="center", fontsize=8)


def _setting_words(setting: str) -> str:
    """Label of a setting, in lines short enough for a column."""
    return style.setting_label(setting).replace(" + ", " +\n")


def _settings_axis(axes: Axes, names: Sequence[str]) -> None:
    """Label the columns of settings, and draw a grid of times."""
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y")


def _drawings() -> Iterable[Drawing]:
    about = (
        "left: flight times of missions that succeed, each flight, median and quartiles (dashed: median of the golden "
        "run); right: success with 95 % intervals; n missions each."
    )
    for name, in_the_paper, title, select, column in (
        ("kernels", "Fig. 3, ", "one fault in one instruction of one kernel", by_kernel, "kernel"),
        ("states", "Fig. 4, ", "one fault in one inter-kernel state", by_state, "target"),
        ("bit_fields", "Section III-B, ", "one fault by class of the flipped bit", by_bits, "bits"),
    ):
        caption = paper.titled(in_the_paper, f"{title}; {about}")
        yield Drawing(name, lambda runs, s=select, c=column: _rows(runs, s, c), caption)  # type: ignore[misc]
    yield Drawing(
        "flight_time_distribution",
        distributions,
        paper.titled(
            "Fig. 6, ",
            "flight times of missions that succeed, worst cases in seconds; below each setting: successes / n; the "
            "time limit of missions bounds every worst case.",
        ),
    )


# ---- Fig. 9 of the paper: flight times by computing platform, for golden runs, faults, and faults with detectors ---


def flight_times(runs: Runs) -> Figure | None:
    """Successful flights as points, with a box, the mean of the slowest, and the worst; one panel per platform.

    The dashed line is the paper's flight time; the paper does not specify its flights.
    """
    # a panel for each platform, a column for each setting
    platform_of = platforms(runs)
    all_flights = platform_flights(runs)
    settings = [GOLDEN, *all_flights.settings()]
    if not platform_of or len(settings) < 2:
        return None
    figure = Figure(figsize=(1.2 + 2.9 * len(platform_of), 3.9), layout="constrained")
    panels = figure.subplots(1, len(platform_of), sharey=True, squeeze=False)[0]
    looks = style.setting_looks(settings)
    for axes, (environment, platform) in zip(panels, platform_of.items(), strict=True):
        for column, setting in enumerate(settings):
            flights = all_flights.where(environment=environment, setting=setting)
            _setting_column(axes, flights, column, looks[setting], {"platform": platform, "setting": setting})
        printed = paper.figure("platforms", quantity="flight_time_s", platform=platform)
        if paper.compared(runs.campaign) and printed is not None:
            axes.axhline(printed, color=style.PAPER, linestyle="--", linewidth=0.9)
            axes.annotate(
                f"paper: {printed} s",
                (len(settings) - 0.4, printed),
                (0, 3),
                ha="right",
                fontsize=8,
                textcoords="offset points",
                color=style.PAPER,
            )
        _settings_axis(axes, [_setting_words(setting) for setting in settings])
        axes.set_title(platform)
    panels[0].set_ylim(0, None)
    panels[0].set_ylabel("flight time (s) of missions that succeed")
    figure.supxlabel(
        "one fault per mission; box: quartiles; dash: mean of the slowest 5 %; number: worst",
        fontsize=8.5,
        color=style.GREY,
    )
    return figure


# ---- Fig. 8 of the paper: flight time with redundant processors relative to that with a detector -------------------

_DESIGN_LOOKS = ((style.BLUE, "o"), (style.ORANGE, "s"), (style.GREEN, "^"), (style.PURPLE, "D"))


def redundancy(designs: Sequence[DesignConfig]) -> Figure:
    """Ratios of flight time (with bands) and of energy by scheme; one panel per vehicle."""
    # a panel for each vehicle, a column for each scheme, in it a mark for each calibration
    vehicles = list(dict.fromkeys(design.craft for design in designs))
    calibrations = list(dict.fromkeys(design.calibration for design in designs))
    figure = Figure(figsize=(1.4 + 3.4 * len(vehicles), 3.9), layout="constrained")
    panels = figure.subplots(1, len(vehicles), squeeze=False)[0]
    width = 0.7 / len(calibrations)
    from_paper = False
    for axes, vehicle in zip(panels, vehicles, strict=True):
        variants = [design for design in designs if design.craft == vehicle]
        finite = _finite_ratios(variants)
        top = 1.0 + 1.08 * max(0.05, max(finite) - 1.0)

        # our ratios by design and scheme, the designs side by side
        for design in variants:
            calibration = calibrations.index(design.calibration)
            look = _DESIGN_LOOKS[calibration % len(_DESIGN_LOOKS)]
            for x, name in enumerate(SCHEMES):
                _design_mark(axes, design, name, x + (calibration - (len(calibrations) - 1) / 2) * width, top, look)

        # those of the paper
        for x, name in enumerate(SCHEMES):
            printed = paper.figure("redundancy_time", vehicle=vehicle, scheme=name)
            if printed is not None:
                from_paper = True
                axes.plot([x - 0.42, x + 0.42], [printed, printed], color=style.PAPER, zorder=5)
                axes.annotate(f"{printed:.2f}", (x + 0.44, printed), va="center", fontsize=8, color=style.PAPER)
        axes.set_xticks(range(len(SCHEMES)), list(SCHEMES))
        axes.set_xlim(-0.5, len(SCHEMES) - 0.35)
        axes.set_ylim(min([1.0, *finite]) - 0.06 * (top - 1.0), top)
        axes.tick_params(axis="x", length=0)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g} ×")
        axes.grid(axis="y")
        axes.set_title(vehicle.replace("_", " "))
    panels[0].set_ylabel("against the autoencoder scheme")

    # the legend
    handles = [
        Line2D([], [], linestyle="", marker=marker, color=colour, label=f"flight time, {name}")
        for name, (colour, marker) in zip(calibrations, cycle(_DESIGN_LOOKS), strict=False)
    ]
    handles += [
        Line2D([], [], linestyle="", marker="o", color=style.GREY, fillstyle="none", label="energy (hover power)"),
        Line2D([], [], color=style.GREY, linewidth=1.8, label="band; triangle: cannot hover"),
    ]
    if from_paper:
        handles.append(Line2D([], [], color=style.PAPER, label="the paper's figure"))
    columns = min(3, 1 + len(vehicles))
    figure.legend(
        handles=handles, loc="outside upper left", ncols=columns, fontsize=8.5, columnspacing=1.2, handlelength=1.8
    )
    return figure


def _design_mark(axes: Axes, design: DesignConfig, scheme: str, x: float, top: float, look: tuple[str, str]) -> None:
    """Draw the band and the ratios of flight time and energy; what cannot hover is a triangle at the upper edge."""
    colour, marker = look
    low, high = band(design, scheme)
    axes.plot([x, x], [low, min(high, top)], color=colour, linewidth=1.8)
    if math.isinf(high):
        axes.plot(x, top, "^", color=colour, markersize=6, clip_on=False)
    axes.plot(x, min(ratio(design, scheme), top), marker, color=colour, markersize=6)
    energy_of_scheme = energy(design, scheme)
    if math.isfinite(energy_of_scheme):
        axes.plot(x, energy_of_scheme, marker, color=colour, markersize=6, fillstyle="none")


def _finite_ratios(designs: Sequence[DesignConfig]) -> list[float]:
    """All ratios of designs with which the vehicle can fly, for the scale of the axis."""
    ratios = []
    for design in designs:
        for scheme in SCHEMES:
            ratios += [*band(design, scheme), energy(design, scheme)]
    return [value for value in ratios if math.isfinite(value)]


# ---- Fig. 7: rule-based selection of the runs of a ledger whose paths are drawn, which excludes hand-picking -------

ENVIRONMENT = "dense"
MIN_SHORTENING = 0.01
"""Smallest reduction that counts as shortened, as a fraction of the golden run's flight time."""
STAGES = ("perception", "planning")
RULE = (
    "Of the activated faults of a stage with which the mission succeeds and a detector's flight does, too, the one of "
    "whose added flight time a detector saves most; where it is below 1 %, of the missions that a detector saves the "
    "one with the longest way; else, of the missions lost, that one; else the fault that adds most flight time."
)


@dataclass(frozen=True, slots=True)
class PathCase:
    """Run ids of one fault: golden run, run with the fault, and run with the fault and a detector."""

    stage: str
    environment: str
    golden: str
    fault: str
    recovered: str  # "" = no detector flew
    arm: str  # of `recovered`
    inflation: float | None  # relative increase of flight time with the fault; None = the mission failed
    recovered_inflation: float | None

    @property
    def run_ids(self) -> list[str]:
        """Ids of its runs."""
        return [run_id for run_id in (self.golden, self.fault, self.recovered) if run_id]


def path_cases(runs: Runs) -> list[PathCase]:
    """Select one case per stage by `RULE`, in Dense or else the last environment."""
    environments = runs.values("environment")
    if not environments:
        return []
    environment = environments[-1]
    if ENVIRONMENT in environments:
        environment = ENVIRONMENT
    cases = (_case(runs.where(environment=environment), stage) for stage in STAGES)
    return [case for case in cases if case is not None]


def _case(runs: Runs, stage: str) -> PathCase | None:
    """The case of a stage that `RULE` selects; None if no fault was activated in it."""
    faults = runs.where("judged", "golden_success", stage=stage, site_outcome=ACTIVATED)
    alone = faults.where(setting=FI)
    if not len(alone):
        return None

    # what a detector saves: flight time, at most what the fault adds (a false alarm can lead to another, shorter way),
    # or the mission
    with_detector = against_fi(faults).frame.filter("dr_success")
    gain = pl.col("inflation") - pl.col("dr_inflation").clip(lower_bound=0.0)
    shortened = with_detector.filter("fi_success", gain >= MIN_SHORTENING).sort(-gain, "run_id", "arm")
    saved = with_detector.filter(~pl.col("fi_success")).sort(-pl.col("distance_m"), "run_id", "arm")
    row: dict[str, Any]
    if len(shortened):
        row = shortened.row(0, named=True)
    elif len(saved):
        row = saved.row(0, named=True)
    else:  # none saves anything: the worst fault, with any detector that flew
        lost = alone.frame.filter(~pl.col("success")).sort(-pl.col("distance_m"), "run_id")
        slowest = alone.frame.sort("inflation", "run_id", descending=[True, False], nulls_last=True)
        worst = slowest
        if len(lost):
            worst = lost
        arm = next((arm for arm in faults.values("arm") if arm), "")
        row = {**worst.row(0, named=True), "dr_inflation": None, "arm": arm}

    # the flights without the fault, and with fault and detector
    arm = str(row["arm"])
    golden = runs.golden.where(arm="", world=row["world"])
    recovered = ""
    if arm:
        same_fault = faults.where(arm=arm, target=row["target"], index=row["index"])
        if len(same_fault):
            recovered = same_fault.first("run_id")
    return PathCase(
        stage,
        runs.first("environment"),
        golden.first("run_id"),
        str(row["run_id"]),
        recovered,
        arm,
        row["inflation"],
        row["dr_inflation"],
    )


# ---- Fig. 7: paths of a golden run, with a fault, and with the fault and a detector, in plan view and 3-D ----------

_MARGIN = 2.0
"""Margin around the paths (m)."""
_WIDTH = 40.0
"""Minimum displayed width across the course (m)."""
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
"""Corners of each face of a box; the bits `_UPPER` of a corner's number select the upper x, y, z."""
_UPPER = (4, 2, 1)
_LOOKS = tuple(style.FLIGHT_LOOKS.values())
"""Line styles of golden run, fault, and fault with detector."""


def trajectories(runs: Runs) -> Figure | None:
    """One row per case of `path_cases` with replayed flights; None without such cases."""
    cases = [case for case in path_cases(runs) if case.fault in runs.flights and case.golden in runs.flights]
    if not cases:
        return None
    figure = Figure(figsize=(11.0, 0.4 + 3.1 * len(cases)), layout="constrained")
    parts = figure.subfigures(len(cases), 1, squeeze=False)[:, 0]
    for part, case in zip(parts, cases, strict=True):
        run_ids = [run_id for run_id in case.run_ids if run_id in runs.flights]
        flights = [runs.flights[run_id] for run_id in run_ids]
        grid = part.add_gridspec(1, 2, width_ratios=(1, 1))
        above = part.add_subplot(grid[0, 0])
        space = part.add_subplot(grid[0, 1], projection="3d")
        _from_above(above, flights)
        _in_space(space, flights)
        for axes in (above, space):  # lines are paths, in this order, before marks
            for line, run_id in zip(axes.get_lines(), run_ids, strict=False):
                links.lines([line], links.to_run(run_id))
        part.suptitle(f"fault in {case.stage}: {_fault(flights[1])}\n{_ends(case, flights)}", fontsize=9.5)
        labels = ("golden run", "with the fault", f"with the fault and detector {case.arm}")
        for line, label in zip(above.get_lines(), labels, strict=False):
            line.set_label(label)
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper left", ncols=6)
    return figure


def _from_above(axes: Axes, flights: Sequence["Flight"]) -> None:
    """Draw obstacles, paths and events in plan view."""
    world = flights[0].world
    # paths first: `trajectories` links the first lines of the axes to the runs
    points = [positions(flight) for flight in flights]
    for path, look in zip(points, _LOOKS, strict=False):
        axes.plot(path[:, 0], path[:, 1], **look)
    # obstacles
    boxes = [
        Rectangle((low[0], low[1]), high[0] - low[0], high[1] - low[1])
        for low, high in zip(world.lower, world.upper, strict=True)
    ]
    axes.add_collection(PatchCollection(boxes, zorder=1, **style.OBSTACLE_LOOK))
    # marks: start, goal, injection, collisions, alarms
    mark: dict[str, Any] = {"linestyle": "", "zorder": 8, "markersize": 8}
    axes.plot(*world.start[:2], label="start", **mark, **style.START_MARK)
    axes.plot(*world.goal[:2], label="goal", **mark, **style.GOAL_MARK)
    star: dict[str, Any] = {**mark, **style.INJECTION_MARK, "markersize": 15, "zorder": 9}
    axes.plot(*_injection(flights[1]).T[:2], label="fault", **star)
    for path, flight, look in zip(points, flights, _LOOKS, strict=False):
        if flight.log.status is MissionStatus.COLLISION:
            end = {**mark, **style.CRASH_MARK, "color": look["color"], "markersize": 10, "zorder": 10}
            axes.plot(*path[-1, :2], label="collision", **end)
    if len(flights) > 2 and flights[2].log.alarms:
        alarms = positions(flights[2], [alarm.time_s for alarm in flights[2].log.alarms])
        axes.plot(*alarms.T[:2], label="alarm", **{**mark, **style.ALARM_MARK, "markersize": 6})
    lower, upper = _limits(flights)
    axes.set_xlim(lower[0], upper[0])
    axes.set_ylim(lower[1], upper[1])
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def _in_space(axes: Any, flights: Sequence["Flight"]) -> None:
    """Draw the obstacles near the paths, and the paths, in 3-D; heights are drawn three times as large."""
    world = flights[0].world
    lower, upper = _limits(flights)
    points = [positions(flight) for flight in flights]
    # obstacles near the paths only: all of them would hide these
    is_near = np.zeros(0, bool)
    if len(world.lower):
        is_near = near_boxes(world, np.concatenate(points))
    faces = []
    for low, high in zip(world.lower[is_near], world.upper[is_near], strict=True):
        shown_low = np.maximum(low, lower)
        shown_high = np.minimum(high, upper)
        corners = np.array([np.where(np.array(_UPPER) & corner, shown_high, shown_low) for corner in range(8)])
        faces += [corners[list(face)] for face in _FACES]
    axes.add_collection3d(Poly3DCollection(faces, alpha=0.25, **style.OBSTACLE_LOOK))

    # paths, and the injections on them
    for path, look in zip(points, _LOOKS, strict=False):
        axes.plot(*path.T, **look)
    axes.plot(
        *_injection(flights[1]).T,
        **{**style.INJECTION_MARK, "linestyle": "", "markersize": 13, "zorder": 9},
    )

    # the displayed volume, and the point of view
    axes.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    axes.zaxis.set_rotate_label(False)
    axes.set_zlabel("z (m)", rotation=90, labelpad=-2)
    for axis in (axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(2))
    extent = upper - lower
    axes.set_box_aspect((extent[0], extent[1], 3.0 * extent[2]), zoom=1.2)
    axes.view_init(elev=32, azim=-70)


def _limits(flights: Sequence["Flight"]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the displayed volume: paths, start and goal, with a margin."""
    world = flights[0].world
    points = np.concatenate([*(positions(flight) for flight in flights), world.start[None], world.goal[None]])
    points = np.clip(points, world.arena_lower - _MARGIN, world.arena_upper + _MARGIN)
    lower = points.min(axis=0) - _MARGIN
    upper = points.max(axis=0) + _MARGIN
    lower[2] = 0.0
    extra = max(0.0, _WIDTH - (upper[1] - lower[1])) / 2  # on each side, for the least width
    return lower - (0.0, extra, 0.0), upper + (0.0, extra, 0.0)


def _injection(flight: "Flight") -> np.ndarray:
    """Positions of the vehicle at the injections. Shape (n, 3)."""
    return positions(flight, [injection.time_s for injection in flight.log.injections if injection.activated])


def _fault(flight: "Flight") -> str:
    injection = flight.log.injections[0]
    bit = ""
    if injection.bit is not None:
        bit = f", bit {injection.bit}"
    return f"{injection.site}{bit} at {injection.time_s:.1f} s"


def _ends(case: PathCase, flights: Sequence["Flight"]) -> str:
    ends = []
    for flight, change in zip(flights, (None, case.inflation, case.recovered_inflation), strict=False):
        change_text = ""
        if change is not None:
            change_text = f" ({signed_percent(change)})"
        ends.append(f"{flight.log.status.words} {float(flight.log.column('time')[-1]):.1f} s{change_text}")
    words = ("golden", "fault", "detector")
    return ", ".join(f"{word}: {text}" for word, text in zip(words, ends, strict=False))


def _caption(runs: Runs) -> str:
    cases = path_cases(runs)
    faults = "; ".join(f"{case.stage}: `{case.fault}`" for case in cases)
    where = ""
    if cases:
        where = f" in {cases[0].environment}"
    title = paper.titled("Fig. 7, ", f"paths{where}, from above and in 3-D (heights drawn three times as large).")
    return f"{title(runs)} {RULE} Shown: {faults}."


def _platforms_caption(runs: Runs) -> str:
    if paper.compared(runs.campaign):
        return "Flight times on each platform; dashed: the paper's."
    return "Flight times on each platform."


CHAPTER = Chapter(
    20,
    (
        *_drawings(),
        Drawing("platforms", flight_times, _platforms_caption, general=True),
        Drawing(
            "redundancy",
            lambda _: redundancy(shipped_designs()),
            "Flight time with redundant processors over that with a detector, by the visual performance model; "
            "black: the paper's figure.",
        ),
        Drawing(
            "trajectories",
            trajectories,
            _caption,
            cases=lambda runs: [run_id for case in path_cases(runs) for run_id in case.run_ids],
        ),
    ),
)
