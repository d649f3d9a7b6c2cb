"""Fig. 7: paths of a golden run, with a fault, and with the fault and a detector, in plan view and 3-D."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

from mavfi.analysis.runs import Runs
from mavfi.extras.paper.cases import RULE, Case, path_cases
from mavfi.mission import MissionStatus
from mavfi.plugins import Chapter
from mavfi.report import links, style
from mavfi.report.figures import Drawing
from mavfi.report.numbers import signed_percent
from mavfi.report.picture import near_boxes, positions

if TYPE_CHECKING:
    from mavfi.flight.host import Flight

_SOLID, _EDGE = "#D4D4D4", "#9A9A9A"
_MARGIN = 2.0
"""Margin around the paths (m)."""
_WIDTH = 40.0
"""Minimum displayed width across the course (m)."""
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
"""Corners of each face of a box; the bits of a corner's number select x, y, z."""
_LOOKS: tuple[dict[str, Any], ...] = (
    {"color": style.SKY, "linewidth": 5.0, "zorder": 4},
    {"color": style.ORANGE, "linewidth": 2.4, "zorder": 5},
    {"color": style.GREEN, "linewidth": 1.5, "linestyle": (0, (4, 2)), "zorder": 6},
)
"""Line styles of golden run, fault, and fault with detector: wide to narrow, so that coinciding paths are visible."""


def trajectories(runs: Runs) -> Figure | None:
    """One row per case of `path_cases` with replayed flights; None without such cases."""
    cases = [case for case in path_cases(runs) if case.fault in runs.flights and case.golden in runs.flights]
    if not cases:
        return None
    figure = Figure(figsize=(11.0, 0.4 + 3.1 * len(cases)), layout="constrained")
    parts = figure.subfigures(len(cases), 1, squeeze=False)[:, 0]
    for part, case in zip(parts, cases, strict=True):
        flown = [name for name in (case.golden, case.fault, case.recovered) if name in runs.flights]
        flights = [runs.flights[name] for name in flown]
        grid = part.add_gridspec(1, 2, width_ratios=(1, 1))
        above, space = part.add_subplot(grid[0, 0]), part.add_subplot(grid[0, 1], projection="3d")
        _from_above(above, flights)
        _in_space(space, flights)
        for axes in (above, space):  # lines are paths, in this order, before marks
            for line, run_id in zip(axes.get_lines(), flown, strict=False):
                links.lines([line], links.to_run(run_id))
        part.suptitle(f"fault in {case.stage}: {_fault(flights[1])}\n{_ends(case, flights)}", fontsize=9.5)
        labels = ("golden run", "with the fault", f"with the fault and detector {case.arm}")
        for line, label in zip(above.get_lines(), labels, strict=False):
            line.set_label(label)
    handles, shown = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, shown, loc="outside upper left", ncols=6)
    return figure


def _from_above(axes: Axes, flights: Sequence["Flight"]) -> None:
    world, points = flights[0].world, [positions(flight) for flight in flights]
    for path, look in zip(points, _LOOKS, strict=False):
        axes.plot(path[:, 0], path[:, 1], **look)
    boxes = [
        Rectangle((low[0], low[1]), high[0] - low[0], high[1] - low[1])
        for low, high in zip(world.lower, world.upper, strict=True)
    ]
    axes.add_collection(PatchCollection(boxes, facecolor=_SOLID, edgecolor=_EDGE, linewidth=0.5, zorder=1))
    mark: dict[str, Any] = {"linestyle": "", "color": style.INK, "zorder": 8, "markersize": 8}
    axes.plot(*world.start[:2], marker="o", label="start", **mark)
    axes.plot(*world.goal[:2], marker="s", label="goal", **mark)
    place = _injection(flights[1])
    star: dict[str, Any] = {**mark, "color": style.AMBER, "markeredgecolor": style.INK, "markersize": 15, "zorder": 9}
    axes.plot(*place.T[:2], marker="*", label="injection", **star)
    for path, flight, look in zip(points, flights, _LOOKS, strict=False):
        if flight.log.status is MissionStatus.COLLISION:
            end = {**mark, "color": look["color"], "markeredgecolor": "white", "markersize": 10}
            axes.plot(*path[-1, :2], marker="X", label="collision", **end)
    if len(flights) > 2 and flights[2].log.alarms:
        alarms = positions(flights[2], [alarm.time_s for alarm in flights[2].log.alarms])
        axes.plot(*alarms.T[:2], marker="v", label="alarm", **{**mark, "color": style.PURPLE, "markersize": 6})
    lower, upper = _limits(flights)
    axes.set_xlim(lower[0], upper[0])
    axes.set_ylim(lower[1], upper[1])
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def _in_space(axes: Any, flights: Sequence["Flight"]) -> None:
    world, lower, upper = flights[0].world, *_limits(flights)
    points = [positions(flight) for flight in flights]
    shown = near_boxes(world, np.concatenate(points)) if len(world.lower) else np.zeros(0, bool)
    faces = []
    for low, high in zip(world.lower[shown], world.upper[shown], strict=True):
        low, high = np.maximum(low, lower), np.minimum(high, upper)
        corners = np.array([[high[axis] if corner >> (2 - axis) & 1 else low[axis] for axis in range(3)]
                            for corner in range(8)])  # fmt: skip
        faces += [corners[list(face)] for face in _FACES]
    axes.add_collection3d(Poly3DCollection(faces, facecolors=_SOLID, edgecolors=_EDGE, linewidths=0.4, alpha=0.25))
    for path, look in zip(points, _LOOKS, strict=False):
        axes.plot(*path.T, **look)
    axes.plot(*_injection(flights[1]).T, marker="*", linestyle="", color=style.AMBER, markeredgecolor=style.INK,
              markersize=13, zorder=9)  # fmt: skip
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
    lower, upper = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    lower[2] = 0.0
    more = max(0.0, _WIDTH - (upper[1] - lower[1])) / 2
    return lower - (0.0, more, 0.0), upper + (0.0, more, 0.0)


def _injection(flight: "Flight") -> np.ndarray:
    """Positions of the vehicle at the injections. Shape (n, 3)."""
    return positions(flight, [injection.time_s for injection in flight.log.injections if injection.activated])


def _fault(flight: "Flight") -> str:
    injection = flight.log.injections[0]
    bit = "" if injection.bit is None else f", bit {injection.bit}"
    return f"{injection.site}{bit} at {injection.time_s:.1f} s"


def _ends(case: Case, flights: Sequence["Flight"]) -> str:
    ends = []
    for flight, change in zip(flights, (None, case.inflation, case.recovered_inflation), strict=False):
        more = "" if change is None else f" ({signed_percent(change)})"
        ends.append(f"{flight.log.status.words} {float(flight.log.column('time')[-1]):.1f} s{more}")
    words = ("golden", "fault", "detector")
    return ", ".join(f"{word}: {text}" for word, text in zip(words, ends, strict=False))


def _ids(runs: Runs) -> list[str]:
    cases = path_cases(runs)
    return [run_id for case in cases for run_id in (case.golden, case.fault, case.recovered) if run_id]


def _caption(runs: Runs) -> str:
    cases = path_cases(runs)
    shown = "; ".join(f"{case.stage}: `{case.fault}`" for case in cases)
    where = f" in {cases[0].environment}" if cases else ""
    return f"Fig. 7, paths{where}, from above and in 3-D (heights drawn three times as large). {RULE} Shown: {shown}."


TRAJECTORIES = Chapter(50, (Drawing("trajectories", trajectories, _caption, cases=_ids),))
