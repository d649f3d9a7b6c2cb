"""Shared functions of the pictures: recorded flights, replay of kernels, maps, worlds, files."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

from mavfi.flight.compose import pipeline_config
from mavfi.flight.fly import fly
from mavfi.flight.host import Flight
from mavfi.kernels.perception.clearance import OCCUPIED
from mavfi.mission import Scenario
from mavfi.numerics.voxels import Grid
from mavfi.pipeline.clearance_map import ClearanceMap
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.planning import MotionPlanner
from mavfi.report import style
from mavfi.sim.camera import pixel_directions
from mavfi.sim.environments import World
from mavfi.states import State, new_state

DOCS = Path(__file__).parents[2] / "docs"
FOLDER = DOCS / "kernels"
IMAGES = DOCS / "images"
_DOTS_PER_INCH = 110
LARGEST_FILE = 120_000
"""Maximum size of a picture (bytes)."""

Tape = list[tuple[int, State]]
"""Every publication of a flight with its instant (us)."""


def record(scenario: Scenario) -> tuple[Flight, Tape]:
    """A golden flight, and all its publications."""
    tape: Tape = []
    flight = fly(scenario, recorders=[lambda state, time_us: tape.append((time_us, state.copy()))])
    return flight, tape


def config_of(scenario: Scenario, flight: Flight) -> PipelineConfig:
    """The pipeline's configuration of a flight."""
    return pipeline_config(scenario, flight.world, pixel_directions(scenario.camera))


def clearance_map_at(scenario: Scenario, flight: Flight, tape: Tape, time_us: int) -> ClearanceMap:
    """The clearance map of a consumer at an instant."""
    clearance = ClearanceMap(config_of(scenario, flight))
    for when, state in tape:
        if when <= time_us and state.spec.name == "perception.map_update":
            clearance.apply(state)
    return clearance


def planner_at(scenario: Scenario, flight: Flight, tape: Tape, number: int) -> tuple[Any, State, int]:
    """The planner after its n-th plan (from 1), replayed as by the host; the path, and its instant (us).

    Raises:
        ValueError: There are fewer plans, or a replayed path differs from the flight's.
    """
    planner = MotionPlanner(config_of(scenario, flight))
    found: State | None = None
    waiting: State | None = None
    plans = 0
    for time_us, state in tape:
        if state.spec.name == "planning.path":
            plans += 1
            if found is None or not found.same_bits(state):
                raise ValueError(f"plan {plans} is not that of the flight")
            if plans == number:
                return planner, found, time_us
            due, found = waiting, None
            waiting = None
            if due is not None and planner.receive(due, time_us):
                found = planner.step(time_us)[0]
        elif state.spec.name in planner.reads and planner.receive(state, time_us):
            if found is None:
                found = planner.step(time_us)[0]
            else:
                waiting = state
    raise ValueError(f"there are {plans} plans, not {number}")


def map_update(occupied: np.ndarray) -> State:
    """A map update that marks voxels (flat indices) as occupied."""
    update = new_state("perception.map_update", len(occupied))
    update.elements["voxel"] = occupied
    update.elements["log_odds"] = 1.0
    return update


def draw_boxes(axes: Axes, world: World, index: int = 1) -> None:
    """Draw obstacles from above (index 1) or from the side (index 2)."""
    patches = [
        Rectangle((low[0], low[index]), high[0] - low[0], high[index] - low[index])
        for low, high in zip(world.lower, world.upper, strict=True)
    ]
    axes.add_collection(PatchCollection(patches, zorder=1, **style.OBSTACLE_LOOK))


def cube(values: np.ndarray, grid: Grid) -> np.ndarray:
    """View of a flat grid array in three dimensions."""
    return values.reshape(grid.nx, grid.ny, grid.nz)


def layer_of(grid: Grid, height: float) -> int:
    """Layer of voxels at a height (m)."""
    return int((height - grid.z0) * grid.inverse)


def shade(axes: Axes, grid: Grid, cells: np.ndarray, colour: str, *, alpha: float = 1.0, order: float = 2.0) -> None:
    """Colour the cells (nx, ny) that are true, seen from above."""
    x1, y1 = grid.x0 + grid.nx * grid.resolution, grid.y0 + grid.ny * grid.resolution
    axes.imshow(
        np.where(cells, 1.0, np.nan).T,
        origin="lower",
        extent=(grid.x0, x1, grid.y0, y1),
        zorder=order,
        alpha=alpha,
        cmap=ListedColormap([colour]),
        interpolation="nearest",
    )


def occupied_from_above(clearance: ClearanceMap, height: tuple[float, float] = (1.0, 9.0)) -> np.ndarray:
    """Columns with a known occupied voxel between two heights (m). Shape (nx, ny)."""
    low, high = (layer_of(clearance.grid, z) for z in height)
    seen: np.ndarray = (cube(clearance.cells, clearance.grid)[:, :, low:high] == OCCUPIED).any(axis=2)
    return seen


def draw_tree(axes: Axes, nodes: np.ndarray, parents: np.ndarray, colour: str, width: float = 0.8) -> None:
    """Draw the edges of a search tree from above. Shapes (n, 3), (n,)."""
    edges = [(nodes[parent, :2], node[:2]) for node, parent in zip(nodes, parents, strict=True) if parent >= 0]
    axes.add_collection(LineCollection(edges, colors=colour, linewidths=width, zorder=4))


def draw_ends(axes: Axes, start: np.ndarray, goal: np.ndarray) -> None:
    """Draw start and goal from above."""
    look: dict[str, Any] = {"linestyle": "", "markeredgecolor": "white", "markersize": 8, "zorder": 9}
    axes.plot(start[0], start[1], label="start", **style.START_MARK, **look)
    axes.plot(goal[0], goal[1], label="goal", **style.GOAL_MARK, **look)


def from_above(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Set up axes for a top view (m)."""
    axes.set(xlim=x, ylim=y, xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal")


def save(figure: Figure, name: str, folder: Path = FOLDER) -> None:
    """Write a picture, by default to docs/kernels.

    Raises:
        ValueError: The file is too large for the repository.
    """
    drawn = BytesIO()
    figure.savefig(drawn, dpi=_DOTS_PER_INCH)
    with Image.open(drawn) as image:
        compress(image, folder / name)


def compress(image: Image.Image, path: Path) -> None:
    """Write a PNG with a small palette, which shrinks the file, and without the metadata of its writer.

    Raises:
        ValueError: The file is too large for the repository.
    """
    image.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(path, "PNG", optimize=True)
    size = path.stat().st_size
    if size > LARGEST_FILE:
        raise ValueError(f"{path}: {size:,} bytes; allowed: {LARGEST_FILE:,}")
