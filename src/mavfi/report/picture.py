"""Picture of a flight in plan and side view: obstacles, map, paths, fault and alarms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.transforms import offset_copy
from scipy.spatial import cKDTree

from mavfi.mission import FLY_AWAY_MARGIN, MissionStatus
from mavfi.record import Injection
from mavfi.report import style
from mavfi.report.explain import around, is_failure
from mavfi.report.numbers import corruption, outcome

if TYPE_CHECKING:
    from mavfi.flight.host import Flight
    from mavfi.sim.environments import World

NEAR = 3.0
"""Approximate horizontal distance from the path within which the side view shows obstacles (m)."""
_MARGIN = 2.0
_SCAN_MARGIN = 5.0
"""Displayed surroundings of the paths in an arena, and in a scan (m)."""
_WIDTH = 11.0
"""Width of the figure (in)."""
_HANDLE = 0.62
_LETTER = 0.066
_ROW = 0.22
"""Approximate sizes of a legend entry: handle, letter, row (in)."""
_TITLE_SIZE = 12.0
_TITLE_LENGTH = 100
"""Size of the title (pt), and its length from which it is set smaller, to fit."""
_SIDE_STRETCH = 1.6
"""Vertical exaggeration of the side view."""


Views = tuple[tuple[Axes, int], tuple[Axes, int]]
"""Plan view and side view: axes, and index of the coordinate on the vertical axis."""


@dataclass(frozen=True, slots=True)
class _Drawn:
    """A path, or markers of one kind.

    `points`: shape (n, 3), finite; `look`: keywords of `Axes.plot`; `lift`: upward offset of the markers (pt).
    """

    label: str
    points: np.ndarray
    look: Mapping[str, Any]
    lift: float = 0.0


def draw_flight(
    path: Path, flight: Flight, golden: Flight | None = None, recovered: Flight | None = None, *, detector: str = ""
) -> Path:
    """Write the picture of `flight_figure` to a file: .png, .svg or .pdf.

    Raises:
        BadInputError: The file cannot be written.
    """
    with style.house_style():
        return style.write(flight_figure(flight, golden, recovered, detector=detector), path)


def flight_figure(
    flight: Flight, golden: Flight | None = None, recovered: Flight | None = None, *, detector: str = ""
) -> Figure:
    """Draw a flight and its map, with its golden run and the flight with the same fault and a detector, if given.

    Args:
        flight: The flight.
        golden: The golden run.
        recovered: The flight with the same fault and a detector.
        detector: Name of the detector of `recovered` or, if that is None, of `flight`; "" = none.
    """
    courses = _courses(flight, golden, recovered, detector)
    with style.house_style():
        lower, upper = _limits(flight.world, courses)
        # the legend's height decides on the layout, so all labels come first
        marks = [*_alarm_marks(recovered or flight), *_marks(flight)]
        labels = [drawn.label for drawn in (*courses, *marks)] + ["obstacle", "occupied in the map"]
        length = sum(_HANDLE + _LETTER * len(label) for label in labels)
        rows = 2
        if length < _WIDTH - 0.8:
            rows = 1
        figure, views = _axes(lower, upper, rows)
        # obstacles, the planner's map, paths and markers, from below to above
        _draw_world(views, flight.world, positions(flight))
        has_map = _draw_map(views, flight, (lower, upper))
        for axes, index in views:
            for course in courses:
                axes.plot(course.points[:, 0], course.points[:, index], **course.look)
        handles = []
        for course in courses:
            look = {key: course.look[key] for key in ("color", "linewidth", "linestyle") if key in course.look}
            handles.append(Line2D([], [], label=course.label, **look))
        handles += _draw_marks(figure, views, marks)
        _label(figure, views, flight, _endings(courses, [golden, flight, recovered]))
        _legend(figure, handles, rows, flight.world, has_map=has_map)
        for axes, index in views:
            axes.set_xlim(lower[0], upper[0])
            axes.set_ylim(lower[index], upper[index])
    return figure


def _courses(flight: Flight, golden: Flight | None, recovered: Flight | None, detector: str) -> list[_Drawn]:
    """The paths, golden run first; widths and orders keep each visible even if all of them coincide."""
    courses = []
    if golden is not None:
        courses.append(_Drawn("golden run", positions(golden), style.FLIGHT_LOOKS["golden"]))
    parts = []
    role = "golden"
    if flight.log.injections:
        parts.append("with the fault")
        role = "injected"
    if detector and recovered is None:
        parts.append(f"detector {detector}")
    label = " and ".join(parts) or "flight"
    courses.append(_Drawn(label, positions(flight), style.FLIGHT_LOOKS[role]))
    if recovered is not None:
        label = f"with the fault and detector {detector}".rstrip()
        courses.append(_Drawn(label, positions(recovered), style.FLIGHT_LOOKS["recovered"]))
    return courses


def positions(flight: Flight, times: list[float] | None = None) -> np.ndarray:
    """Finite positions of the vehicle, at all or the given instants. Shape (n, 3)."""
    points = flight.log.columns("x", "y", "z")
    if times is not None:
        points = points[np.minimum(np.searchsorted(flight.log.column("time"), times), len(points) - 1)]
    finite: np.ndarray = points[np.isfinite(points).all(axis=1)]
    return finite


def _limits(world: World, courses: list[_Drawn]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the displayed volume: the arena or, in a scan, the surroundings of the paths."""
    points = np.concatenate([course.points for course in courses] + [world.start[None], world.goal[None]])
    points = np.clip(points, world.arena_lower - FLY_AWAY_MARGIN, world.arena_upper + FLY_AWAY_MARGIN)
    low = points.min(axis=0)
    high = points.max(axis=0)
    if world.is_voxels:
        lower = np.maximum(low - _SCAN_MARGIN, world.arena_lower)
        upper = np.minimum(high + _SCAN_MARGIN, world.arena_upper)
        return lower, upper
    return np.minimum(world.arena_lower, low - _MARGIN), np.maximum(world.arena_upper, high + _MARGIN)


def _axes(lower: np.ndarray, upper: np.ndarray, rows: int) -> tuple[Figure, Views]:
    """Create a figure with two views of equal x scale, below a legend of `rows` rows."""
    # margins, and the space between the views (in)
    left = 0.6
    right = 0.15
    top = 1.17 + _ROW * (rows - 1)
    between = 0.62
    bottom = 0.5
    # heights of the views (in) follow from the scale along x
    extent = upper - lower
    inch = (_WIDTH - left - right) / extent[0]
    plan = inch * extent[1]
    elevation = inch * extent[2] * _SIDE_STRETCH
    height = top + plan + between + elevation + bottom
    figure = Figure(figsize=(_WIDTH, height))
    width = (_WIDTH - left - right) / _WIDTH
    side = figure.add_axes((left / _WIDTH, bottom / height, width, elevation / height))
    above = figure.add_axes((left / _WIDTH, (bottom + elevation + between) / height, width, plan / height))
    return figure, ((above, 1), (side, 2))


def _draw_world(views: Views, world: World, course: np.ndarray) -> None:
    """Draw the obstacles of a world: boxes, or the solid voxels of a scan near the path."""
    if world.is_voxels:
        _draw_scan(views, world, course)
        return
    # all boxes in the plan; from the side those near the path, or they would hide each other
    all_boxes = np.ones(len(world.lower), bool)
    for (axes, index), mask in zip(views, (all_boxes, near_boxes(world, course)), strict=True):
        boxes = [
            Rectangle((low[0], low[index]), high[0] - low[0], high[index] - low[index])
            for low, high in zip(world.lower[mask], world.upper[mask], strict=True)
        ]
        axes.add_collection(PatchCollection(boxes, zorder=1, **style.OBSTACLE_LOOK))
    views[1][0].axhline(0.0, color=style.OBSTACLE_LOOK["edgecolor"], linewidth=0.8, zorder=1)


def near_boxes(world: World, course: np.ndarray) -> np.ndarray:
    """Mask of the boxes within about `NEAR` of the path, horizontally. Shape (boxes,), bool."""
    points = course[:: max(1, len(course) // 500), :2]
    below = world.lower[:, None, :2] - points[None]
    beyond = points[None] - world.upper[:, None, :2]
    distance = np.linalg.norm(np.maximum(np.maximum(below, beyond), 0.0), axis=2)
    near: np.ndarray = distance.min(axis=1, initial=np.inf) < NEAR + 1.0
    return near


def _draw_scan(views: Views, world: World, course: np.ndarray) -> None:
    """Draw solid voxels at the median flight height (plan view) and along the path (side view)."""
    # slices of voxels: three layers around the median height; from the side, the row of the path at each x
    shape = np.array(world.occupied.shape)
    end = world.origin + shape * world.resolution
    cells = np.clip(((course - world.origin) / world.resolution).astype(int), 0, shape - 1)
    middle = int(np.median(cells[:, 2]))
    plan = np.asarray(world.occupied[:, :, max(0, middle - 1) : middle + 2].any(axis=2))
    columns = np.arange(shape[0])
    order = np.argsort(cells[:, 0], kind="stable")
    rows = np.interp(columns, cells[order, 0], cells[order, 1]).round().astype(int)
    elevation: np.ndarray = world.occupied[columns, rows, :]
    for (axes, index), solid in zip(views, (plan, elevation), strict=True):
        extent = (world.origin[0], end[0], world.origin[index], end[index])
        _shade(axes, solid, extent, style.OBSTACLE, 1)


def _shade(
    axes: Axes,
    cells: np.ndarray,
    extent: tuple[float, float, float, float],
    colour: str,
    order: int,
    alpha: float = 1.0,
) -> None:
    """Colour the cells that are true; shape (columns, rows)."""
    image = np.zeros((cells.shape[1], cells.shape[0], 4))
    image[..., :3] = to_rgb(colour)
    image[..., 3] = alpha * cells.T
    axes.imshow(image, origin="lower", extent=extent, interpolation="nearest", aspect="auto", zorder=order)


def _draw_map(views: Views, flight: Flight, limits: tuple[np.ndarray, np.ndarray]) -> bool:
    """Draw the occupied voxels of the planner's final map; return whether there are any."""
    from mavfi.kernels.perception.clearance import OCCUPIED

    clearance: Any = getattr(flight.pipeline.get("planner"), "clearance_map", None)
    if clearance is None:
        return False
    # centres of the occupied voxels within the limits
    grid = clearance.grid
    ix, iy, iz = np.nonzero(clearance.cells.reshape(grid.nx, grid.ny, grid.nz) == OCCUPIED)
    corner = np.array([grid.x0, grid.y0, grid.z0])
    shape = np.array([grid.nx, grid.ny, grid.nz])
    centres = corner + (np.stack([ix, iy, iz], axis=1) + 0.5) * grid.resolution
    lower, upper = limits
    centres = centres[((centres > lower) & (centres < upper)).all(axis=1)]
    # those shown in each view
    course = positions(flight)[::10]
    if flight.world.is_voxels:  # slices as for the world: the full map of a corridor would hide everything
        from_above = centres[np.abs(centres[:, 2] - np.median(course[:, 2])) < 1.5 * grid.resolution]
        from_side = centres[_distance(centres, course) < grid.resolution]
    else:
        from_above = centres[centres[:, 2] > grid.resolution]  # without the ground, which would hide everything as well
        from_side = from_above[_distance(from_above, course) < NEAR]
    # projections
    end = corner + shape * grid.resolution
    for (axes, index), points in zip(views, (from_above, from_side), strict=True):
        projection = np.zeros((shape[0], shape[index]), bool)
        cells = ((points - corner) * grid.inverse).astype(int)
        projection[cells[:, 0], cells[:, index]] = True
        _shade(axes, projection, (corner[0], end[0], corner[index], end[index]), style.OCCUPIED, 2, alpha=0.55)
    return len(centres) > 0


def _distance(points: np.ndarray, course: np.ndarray) -> np.ndarray:
    """Horizontal distance of points from a path (m). Shapes (n, 3), (k, 3) -> (n,)."""
    if len(course) == 0 or len(points) == 0:
        return np.full(len(points), np.inf)
    distance: np.ndarray = cKDTree(course[:, :2]).query(points[:, :2])[0]
    return distance


def _marks(flight: Flight) -> list[_Drawn]:
    """Markers of start, goal, injections, and the end of a failed flight."""
    log = flight.log
    world = flight.world
    marks = [
        _Drawn("start", world.start[None], {**style.START_MARK, "markersize": 9}),
        _Drawn("goal", world.goal[None], {**style.GOAL_MARK, "markersize": 9}),
    ]
    times = [injection.time_s for injection in log.injections if injection.activated]
    if times:
        look = {**style.INJECTION_MARK, "markersize": 17}
        marks.append(_Drawn("fault", positions(flight, times), look))
    if log.status is not MissionStatus.SUCCESS:
        look = {**style.CRASH_MARK, "color": style.FAULT, "markersize": 12}
        marks.append(_Drawn(log.status.words, positions(flight)[-1:], look))
    return marks


def _alarm_marks(flight: Flight) -> list[_Drawn]:
    """Markers of alarms: filled within a second of the injection, otherwise hollow."""
    near, others = around(flight.log)
    look = {**style.ALARM_MARK, "markersize": 9}
    marks = []
    if others:
        points = positions(flight, [alarm.time_s for alarm in others])
        label = "other alarm" if near else "alarm"
        marks.append(_Drawn(label, points, look | {"color": "white"}, lift=14.0))
    if near:
        points = positions(flight, [alarm.time_s for alarm in near])
        marks.append(_Drawn("alarm at the fault", points, look, lift=14.0))
    return marks


def _draw_marks(figure: Figure, views: Views, marks: list[_Drawn]) -> list[Line2D]:
    """Draw markers in both views; return their legend entries."""
    handles = []
    for mark in marks:
        look: dict[str, Any] = {"linestyle": "", "markeredgecolor": "white", "markeredgewidth": 1.0, **mark.look}
        for axes, index in views:
            lifted = offset_copy(axes.transData, figure, y=mark.lift, units="points")
            axes.plot(mark.points[:, 0], mark.points[:, index], zorder=9, clip_on=False, transform=lifted, **look)
        handles.append(Line2D([], [], label=mark.label, **{**look, "markersize": 0.7 * look["markersize"] + 1.5}))
    return handles


def _label(figure: Figure, views: Views, flight: Flight, title: str) -> None:
    """Write the title, what is flown with which fault, the axes, and what each view shows."""
    (above, _), (side, _) = views
    scenario = flight.log.meta["scenario"]
    height = figure.get_figheight()
    # title, and below it the mission and the fault
    size = min(_TITLE_SIZE, _TITLE_SIZE * _TITLE_LENGTH / len(title))
    figure.text(0.6 / _WIDTH, 1 - 0.24 / height, title, fontsize=size, fontweight="bold", va="center")
    below = f"{scenario['environment']['name']} · seed {scenario['seed']} · autopilot {scenario['stack']['name']}"
    faults = []
    for injection in flight.log.injections:
        if injection.activated:
            faults.append(_fault(injection))
    if faults:
        below = f"{below}   ·   {faults[0]}"
    if len(faults) > 1:  # one line has no room for several
        below = f"{below}, and {len(faults) - 1} more"
    figure.text(0.6 / _WIDTH, 1 - 0.49 / height, below, va="center", color=style.GREY)
    # axes, and what each view shows
    above.set_ylabel("y (m)")
    side.set_ylabel("z (m)")
    side.set_xlabel("x (m)")
    above.text(0, 1.012, "from above", transform=above.transAxes, color=style.GREY, va="bottom")
    shown = "along the path" if flight.world.is_voxels else "obstacles near the path"
    heights = f"from the side: {shown}; heights × {_SIDE_STRETCH:g}"
    side.text(0, 1.02, heights, transform=side.transAxes, color=style.GREY, va="bottom")


def _fault(injection: Injection) -> str:
    """An activated injection in a few words: what fails, when, and the value before and after."""
    what = corruption(injection) or injection.details.get("model", "")
    site = f"{injection.site}, {what}".removesuffix(", ")
    if (
        is_failure([injection]) and "operation" not in injection.details
    ):  # it changes each value a little, or much, from now on
        return f"{site}, from {injection.time_s:.2f} s"
    return f"{site} at {injection.time_s:.2f} s: {outcome(injection, digits=4)}"


def _endings(courses: list[_Drawn], flights: list[Flight | None]) -> str:
    """How each flight ended, by its label in the legend."""
    endings = []
    for course, flight in zip(courses, (flight for flight in flights if flight is not None), strict=True):
        status = flight.log.status
        ending = "goal" if status is MissionStatus.SUCCESS else status.words
        endings.append(f"{course.label}: {ending} at {flight.log.column('time')[-1]:.1f} s")
    return " · ".join(endings)


def _legend(figure: Figure, handles: list[Any], rows: int, world: World, *, has_map: bool) -> None:
    """Draw the legend above both views."""
    obstacle = "solid" if world.is_voxels else "obstacle"
    handles = [*handles, Patch(label=obstacle, **style.OBSTACLE_LOOK)]
    if has_map:
        handles.append(Patch(facecolor=style.OCCUPIED, alpha=0.55, label="occupied in the map"))
    height = figure.get_figheight()
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.6 / _WIDTH, 1 - 0.66 / height),
        ncols=-(-len(handles) // rows),
        fontsize=8.5,
        handlelength=1.6,
        columnspacing=1.3,
        borderpad=0,
        handletextpad=0.6,
        borderaxespad=0,
    )
