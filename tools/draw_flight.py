"""Draw docs/kernels/flight.png: top view of one instant of a flight in `dense`: map, trees, path, trajectory.

Run as `make results NAME=pictures`.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.typing import LineStyleType

from mavfi.flight.compose import resolve
from mavfi.kernels.perception.clearance import KNOWN_FREE
from mavfi.mission import MissionSpec, Scenario
from mavfi.report import style
from mavfi.states import State
from tools import drawing

NUMBER = 6
"""Number of the plan shown, in the middle of the flight."""
HEIGHT = 4.0
FREE, OCCUPIED = "#EAF3FA", "#3B3B3B"


def mission() -> Scenario:
    """Environment `dense` with one RRT-Connect run per plan, so that the path belongs to the trees shown."""
    scenario = resolve(MissionSpec(environment="dense", seed=7))
    return scenario.model_copy(update={"planner": scenario.planner.model_copy(update={"restarts": 1})})


def points_of(state: State) -> np.ndarray:
    """Positions of a path's or trajectory's elements. Shape (n, 3)."""
    return np.stack([state.elements[axis] for axis in "xyz"], axis=1)


def draw_moment(axes: Axes) -> None:
    """Draw all data available at that instant."""
    scenario = mission()
    flight, tape = drawing.record(scenario)
    planner, path, time_us = drawing.planner_at(scenario, flight, tape, NUMBER)
    trajectory = next(state for t, state in tape if t >= time_us and state.spec.name == "planning.trajectory")
    clearance = drawing.clearance_map_at(scenario, flight, tape, time_us)
    drawing.draw_boxes(axes, flight.world)
    free = drawing.cube(clearance.cells, clearance.grid)[:, :, drawing.layer_of(clearance.grid, HEIGHT)] == KNOWN_FREE
    drawing.shade(axes, clearance.grid, free, FREE, order=0.5)
    drawing.shade(axes, clearance.grid, drawing.occupied_from_above(clearance), OCCUPIED)
    trees = planner.routes.search._trees  # working memory after the last search
    for which, colour in enumerate((style.SKY, style.AMBER)):
        count = trees.counts[which]
        drawing.draw_tree(axes, trees.nodes[which, :count], trees.parents[which, :count], colour, 1.3)
        axes.plot(*trees.nodes[which, :count, :2].T, ".", color=colour, markersize=4, zorder=4)
    vertices, points = points_of(path), points_of(trajectory)
    axes.plot(*vertices[:, :2].T, "o--", color=style.ORANGE, linewidth=1.3, markersize=4.5, zorder=6)
    axes.plot(*points[:, :2].T, color=style.GREEN, linewidth=2.6, alpha=0.9, zorder=5)
    track = flight.log.columns("time", "x", "y")
    flown = track[:, 0] <= 1e-6 * time_us
    axes.plot(*track[flown, 1:].T, color=style.INK, linewidth=2.0, zorder=7)
    axes.plot(*track[flown, 1:][-1], marker=(3, 0, -90), color=style.INK, markersize=11, zorder=9)
    drawing.draw_ends(axes, flight.world.start, flight.world.goal)
    axes.set_title(
        f"dense, seed {scenario.seed}, profile {scenario.autopilot.name}, {1e-6 * time_us:.1f} s: plan {NUMBER}"
    )


def legend() -> list[Line2D | Patch]:
    """Legend entries of the colours."""
    lines: tuple[tuple[str, str, LineStyleType, float], ...] = (
        ("flown", style.INK, "-", 2.0),
        ("tree from the start", style.SKY, "-", 1.3),
        ("tree from the goal", style.AMBER, "-", 1.3),
        ("path", style.ORANGE, "--", 1.3),
        ("trajectory", style.GREEN, "-", 2.6),
    )
    patches = (("obstacle", drawing.SOLID), ("map: occupied", OCCUPIED), (f"map: free at {HEIGHT:g} m", FREE))
    return [
        *(Line2D([], [], label=name, color=c, linestyle=d, linewidth=w) for name, c, d, w in lines),
        *(Patch(facecolor=colour, edgecolor=drawing.EDGE, label=name) for name, colour in patches),
    ]


def main() -> None:
    """Fly and draw."""
    with style.house_style():
        figure, axes = plt.subplots(figsize=(9.6, 5.9), layout="constrained")
        draw_moment(axes)
        drawing.from_above(axes, (0.0, 120.0), (-30.0, 30.0))
        figure.legend(handles=legend(), loc="outside lower center", ncols=4, fontsize=8.5)
        drawing.save(figure, "flight.png")


if __name__ == "__main__":
    main()
