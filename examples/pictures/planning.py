"""Draw docs/kernels/trees.png, rrt_star.png and shortcut.png: searches on the map of a golden flight.

Run as `make results NAME=pictures`.
"""

from functools import cache

import matplotlib.pyplot as plt
import numpy as np
from examples.pictures import drawing
from matplotlib.axes import Axes

from mavfi.flight.compose import resolve
from mavfi.kernels.planning import path as paths
from mavfi.kernels.planning import rrt, rrt_connect, rrt_star
from mavfi.mission import MissionSpec
from mavfi.numerics.random import seed_generator
from mavfi.pipeline.clearance_map import ClearanceMap
from mavfi.report import style
from mavfi.sim.environments import World

ITERATIONS = 800
RANGE, GOAL_BIAS = 4.0, 0.05
NEAR = "#E4D9CC"
BUDGETS = np.arange(100, 2001, 50)
RUNS = 10
HEIGHT = 4.0


@cache
def scene() -> tuple[ClearanceMap, World]:
    """The complete world as a map: all voxels inside obstacles are occupied, as after a very long flight."""
    scenario = resolve(MissionSpec(environment="factory", seed=0))
    flight, _ = drawing.record(scenario)
    clearance = ClearanceMap(drawing.config_of(scenario, flight))
    grid, world = clearance.grid, flight.world
    solid = np.zeros((grid.nx, grid.ny, grid.nz), bool)
    corner = np.array([grid.x0, grid.y0, grid.z0])
    for low, high in zip(world.lower, world.upper, strict=True):
        first = np.maximum(np.floor((low - corner) * grid.inverse), 0).astype(int)
        last = np.ceil((high - corner) * grid.inverse).astype(int)
        solid[tuple(slice(a, b) for a, b in zip(first, last, strict=True))] = True
    update = drawing.map_update(np.flatnonzero(solid))
    clearance.apply(update)
    return clearance, world


def grown(name: str, iterations: int, seed: int) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """Trees of a planner (nodes, parents) after a number of iterations, and the path, empty if none is found."""
    clearance, world = scene()
    random, path = seed_generator(seed, 1), np.zeros((2 * rrt_connect.NODE_LIMIT, 3))
    where = clearance.wide, clearance.grid, world.start, world.goal, world.flight_lower, world.flight_upper
    if name == "rrt_connect":
        trees = rrt_connect.new_trees()
        count = rrt_connect.plan(*where, RANGE, iterations, random, trees, path)
        return [(trees.nodes[i, :n], trees.parents[i, :n]) for i, n in enumerate(trees.counts)], path[:count]
    if name == "rrt":
        tree = rrt.new_tree(iterations + 1)
        count = rrt.plan(*where, RANGE, GOAL_BIAS, iterations, random, tree, path)
        used = 1 + int(np.flatnonzero(tree.nodes.any(axis=1))[-1])
        return [(tree.nodes[:used], tree.parents[:used])], path[:count]
    star = rrt_star.new_tree(iterations + 1)
    count = rrt_star.plan(*where, 2 * RANGE, GOAL_BIAS, iterations, iterations, random, star, path)
    return [(star.nodes[: star.state[0]], star.parents[: star.state[0]])], path[:count]


def background(axes: Axes) -> None:
    """Draw obstacles and their clearance zones at one height."""
    clearance, world = scene()
    layer = drawing.layer_of(clearance.grid, HEIGHT)
    drawing.shade(axes, clearance.grid, drawing.cube(clearance.wide, clearance.grid)[:, :, layer] > 0, NEAR)
    drawing.shade(axes, clearance.grid, drawing.cube(clearance.cells, clearance.grid)[:, :, layer] == 2, style.OCCUPIED)
    drawing.draw_ends(axes, world.start, world.goal)


def draw_trees() -> None:
    """Draw each planner's trees after the same number of iterations on the same map."""
    names = {"rrt": "RRT", "rrt_connect": "RRT-Connect", "rrt_star": "RRT*"}
    figure, rows = plt.subplots(3, 1, figsize=(7.2, 11.0), sharex=True, layout="constrained")
    for axes, (name, title) in zip(rows, names.items(), strict=True):
        trees, path = grown(name, ITERATIONS, 1)
        background(axes)
        for (nodes, parents), colour in zip(trees, (style.BLUE, style.AMBER), strict=False):
            drawing.draw_tree(axes, nodes, parents, colour, 0.7)
        count = sum(len(tree) for tree, _ in trees)
        length = f"path of {paths.path_length(path, len(path)):.0f} m" if len(path) else "no path yet"
        if len(path):
            axes.plot(*path[:, :2].T, color=style.ORANGE, linewidth=2.4, zorder=6)
        drawing.from_above(axes, (0.0, 120.0), (-30.0, 30.0))
        axes.set_title(f"{title}: {count} nodes, {length}")
        axes.set_xlabel("x (m)" if axes is rows[-1] else "")
    drawing.save(figure, "trees.png")


def draw_cost() -> None:
    """Draw the length of RRT*'s path against its budget, per run; it decreases monotonically."""
    clearance, world = scene()
    figure, axes = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
    where = world.goal, world.flight_lower, world.flight_upper
    ends = []
    for seed in range(RUNS):
        tree, random = rrt_star.new_tree(int(BUDGETS[-1]) + 1), seed_generator(seed, 1)
        rrt_star.plant(tree, world.start, world.flight_lower, world.flight_upper)
        lengths, done = [], 0
        for budget in BUDGETS:
            rrt_star.grow(
                clearance.wide, clearance.grid, *where, 2 * RANGE, GOAL_BIAS, int(budget) - done, random, tree
            )
            done = int(budget)
            lengths.append(tree.costs[tree.state[1]] if tree.state[1] >= 0 else np.nan)
        axes.step(BUDGETS, lengths, where="post", color=style.BLUE, linewidth=1.0, alpha=0.6)
        ends.append(lengths[-1])
    straight = float(np.linalg.norm(world.goal - world.start))
    axes.axhline(straight, color=style.INK, linewidth=1.0, linestyle=":")
    axes.text(BUDGETS[0] + 15, straight + 0.6, "straight line, through the walls", fontsize=8.5)
    axes.set(xlabel="iterations", ylabel="length of the path (m)", xlim=(BUDGETS[0], BUDGETS[-1]))
    axes.set_ylim(0.95 * straight, None)
    axes.set_title(f"RRT*: {RUNS} runs on one map")
    axes.grid(True)
    drawing.save(figure, "rrt_star.png")


def draw_shortcut() -> None:
    """Draw the path of one RRT-Connect run before and after each kind of shortcut."""
    clearance, _ = scene()
    _, raw = grown("rrt_connect", 4000, 1)
    work, buffer = np.zeros((len(raw) + 200, 3)), np.zeros((len(raw) + 200, 3))
    work[: len(raw)] = raw
    count = paths.shortcut_greedy(clearance.wide, clearance.grid, work, len(raw))
    greedy = work[:count].copy()
    count = paths.shortcut_random(clearance.wide, clearance.grid, work, count, 80, seed_generator(1, 2), buffer)
    figure, axes = plt.subplots(figsize=(7.6, 4.6), layout="constrained")
    background(axes)
    looks = (
        ("from RRT-Connect", raw, style.SKY, "-"),
        ("greedy shortcuts", greedy, style.PURPLE, "--"),
        ("then random ones", work[:count], style.ORANGE, "-"),
    )
    for name, path, colour, dashes in looks:
        label = f"{name}: {len(path)} vertices, {paths.path_length(path, len(path)):.0f} m"
        axes.plot(*path[:, :2].T, dashes, marker=".", color=colour, linewidth=1.7, label=label, zorder=5)
    drawing.from_above(axes, (0.0, 120.0), (-30.0, 30.0))
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles[2:], labels[2:], loc="outside lower center", ncols=2, fontsize=8.5)
    drawing.save(figure, "shortcut.png")


def main() -> None:
    """Draw all pictures."""
    with style.house_style():
        draw_trees()
        draw_cost()
        draw_shortcut()


if __name__ == "__main__":
    main()
