"""Draw docs/images/octomap.png: the map of a golden flight as voxels, and as the leaves of an equivalent octree.

Run as `make results NAME=pictures`.
"""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from examples.pictures import drawing
from matplotlib.collections import PatchCollection
from matplotlib.patches import Rectangle

from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.kernels.perception.octree import DEPTH
from mavfi.mission import MissionSpec
from mavfi.report import style

HEIGHT = 3.0
WINDOW = ((7.0, 52.0), (-28.0, 17.0))


def leaves_at(tree: Any, height_key: int) -> list[tuple[int, int, int, float]]:
    """Leaves intersected by a horizontal plane: lower key x and y, edge in voxels, log-odds."""
    found = []
    todo = [(0, 0, 0, 0, 1 << DEPTH)]
    while todo:
        node, x, y, z, edge = todo.pop()
        half = edge // 2
        slots = np.flatnonzero(tree.children[node])
        if not len(slots):
            found.append((x, y, edge, float(tree.log_odds[node])))
        for slot in map(int, slots):
            corner = x + half * (slot & 1), y + half * (slot >> 1 & 1), z + half * (slot >> 2)
            if corner[2] <= height_key < corner[2] + half:
                todo.append((int(tree.children[node, slot]), *corner, half))
    return found


def draw() -> None:
    """Fly, and draw both maps side by side."""
    flight: Any = fly(resolve(MissionSpec(environment="dense", seed=7, autopilot="hardened", map="octree")))
    kernel = flight.pipeline["octomap"]
    frame, grid = kernel.frame, kernel.grid
    iz = int((HEIGHT - grid.z0) * grid.inverse)
    layer = kernel.map.log_odds.reshape(grid.nx, grid.ny, grid.nz)[:, :, iz]
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5.4), sharex=True, sharey=True, layout="constrained")
    x1, y1 = grid.x0 + grid.nx * frame.resolution, grid.y0 + grid.ny * frame.resolution
    shown = np.where(layer == 0.0, np.nan, layer).T
    picture = left.imshow(
        shown, origin="lower", extent=(grid.x0, x1, grid.y0, y1), cmap="coolwarm", vmin=-3.5, vmax=3.5
    )
    squares, values = [], []
    for kx, ky, edge, value in leaves_at(kernel.map.tree, frame.kz + iz + (1 << DEPTH - 1)):
        corner = [(k - (1 << DEPTH - 1)) * frame.resolution - frame.shift_x for k in (kx, ky)]
        squares.append(Rectangle((corner[0], corner[1]), edge * frame.resolution, edge * frame.resolution))
        values.append(value)
    leaves = PatchCollection(squares, cmap="coolwarm", edgecolor="black", linewidth=0.25)
    leaves.set_array(np.array(values))
    leaves.set_clim(-3.5, 3.5)
    right.add_collection(leaves)
    left.set(
        title=f"dense array, layer at {HEIGHT:g} m", xlim=WINDOW[0], ylim=WINDOW[1], xlabel="x (m)", ylabel="y (m)"
    )
    right.set(title=f"leaves of the octree ({kernel.map.tree.counters[3]:,} nodes in all)", xlabel="x (m)")
    for axes in (left, right):
        axes.set_aspect("equal")
    track = flight.log.columns("x", "y")
    left.plot(track[:, 0], track[:, 1], color="black", linewidth=1.2)
    figure.colorbar(picture, ax=(left, right), label="log-odds", shrink=0.85)
    drawing.save(figure, "octomap.png", drawing.IMAGES)


if __name__ == "__main__":
    with style.house_style():
        draw()
