"""Draw docs/images/trajectory.png: a minimum-snap curve before and after splitting, its speed and acceleration.

Run as `python -m examples.pictures.trajectory`.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from examples.pictures import drawing

from mavfi.kernels.planning import knots, minimum_snap, time_allocation, trajectory
from mavfi.numerics.voxels import Grid, offsets_within
from mavfi.report import style

CURVE_LIMITS = knots.CurveLimits(3.0, 4.5, 2.0, 3.5, 2.5, 4.0, 2.5, 1.5)
LIMITS = trajectory.Limits(3.0, 3.0, 3.5, 2.5, 4.0, 2.5, 3.0)
GRID = Grid(0.0, 0.0, 0.0, 2.0, 48, 24, 8)
BOXES = ((6.0, 10.0, 0.0, 6.5), (14.0, 17.0, 5.0, 12.0))
PATH = np.array(
    [[1.5, 2.0, 2.0], [5.3, 7.3, 2.0], [10.7, 7.3, 2.0], [13.5, 4.2, 2.0], [17.5, 4.2, 2.0], [22.5, 9.5, 2.0]]
)
STEP = 0.02


def blocks() -> tuple[np.ndarray, np.ndarray]:
    """Occupied voxels, and those within the checker's radius. Shape (nx, ny, nz) each."""
    occupied = np.zeros((GRID.nx, GRID.ny, GRID.nz), bool)
    for x0, x1, y0, y1 in BOXES:
        occupied[int(2 * x0) : int(2 * x1), int(2 * y0) : int(2 * y1)] = True
    narrow = np.zeros((GRID.nx, GRID.ny, GRID.nz), np.int16)
    for dx, dy, _ in offsets_within(0.6, 0.5, False):
        for x, y in np.argwhere(occupied[:, :, 0]):
            if 0 <= x + dx < GRID.nx and 0 <= y + dy < GRID.ny:
                narrow[x + dx, y + dy] = 1
    return occupied, narrow


def curve(narrow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and knots of the curve."""
    work = knots.new_work()
    free = np.zeros(GRID.size, np.int16)
    count = time_allocation.fit(narrow, free, GRID, PATH, len(PATH), np.zeros(3), np.zeros(3), CURVE_LIMITS, work)
    points = np.zeros((5000, trajectory.POINT_WIDTH))
    n = minimum_snap.sample(work.ends, work.times, count, STEP, 3.0, np.nan, 1.57, points)
    return points[:n], work.points[:count].copy()


def blends(narrow: np.ndarray) -> np.ndarray:
    """Points of the same path with rounded corners."""
    corners, line = np.zeros((trajectory.CURVE_LIMIT, 3)), np.zeros((trajectory.CURVE_LIMIT, 3))
    arc, speed = np.zeros(trajectory.CURVE_LIMIT), np.zeros(trajectory.CURVE_LIMIT)
    count = trajectory.smooth(narrow, GRID, PATH, len(PATH), LIMITS.blend, 1.0 / 3.0, corners, line)
    trajectory.speed_profile(np.zeros(GRID.size, np.int16), GRID, line, count, 0.0, LIMITS, arc, speed)
    points = np.zeros((5000, trajectory.POINT_WIDTH))
    return points[: trajectory.sample(line, count, arc, speed, STEP, 3.0, 0.0, points)]


def draw(path: Path) -> None:
    """Generate the three curves for one path, and draw them."""
    occupied, narrow = blocks()
    free = np.zeros(GRID.size, np.int16)
    before, _ = curve(free)
    after, passed = curve(narrow.reshape(-1))
    rounded = blends(narrow.reshape(-1))
    figure = plt.figure(figsize=(11, 7.2), layout="constrained")
    above, speeds, accelerations = figure.subplot_mosaic(
        [["above", "above"], ["speed", "acceleration"]], height_ratios=(1.7, 1.0)
    ).values()
    shade = np.where(occupied[:, :, 0], 2.0, narrow[:, :, 0]).T
    above.imshow(shade, origin="lower", extent=(0, GRID.nx / 2, 0, GRID.ny / 2), cmap="Greys", vmin=0.0, vmax=4.0)
    above.plot(PATH[:, 0], PATH[:, 1], "--", color="black", linewidth=1.0, label="shortcut path")
    above.plot(before[:, 0], before[:, 1], color=style.FAULT, label="first curve: leaves free space")
    above.plot(after[:, 0], after[:, 1], color=style.BLUE, label="after splitting")
    above.plot(passed[:, 0], passed[:, 1], ".", color=style.BLUE, label="its knots")
    above.set(xlabel="x (m)", ylabel="y (m)", title="dark: occupied, light: nearer than the checker's radius")
    above.legend(loc="upper left", fontsize=8)
    for points, colour, label in ((after, style.BLUE, "minimum snap"), (rounded, style.ORANGE, "blends")):
        time = STEP * np.arange(len(points))
        speeds.plot(time, np.linalg.norm(points[:, 4:7], axis=1), color=colour, label=label)
        accelerations.plot(time, np.linalg.norm(points[:, 7:10], axis=1), color=colour, linewidth=1.0)
    speeds.set(xlabel="time (s)", ylabel="speed (m/s)", ylim=(0.0, 3.2))
    accelerations.set(xlabel="time (s)", ylabel="acceleration (m/s²)", ylim=(0.0, 5.2))
    speeds.axhline(CURVE_LIMITS.speed, color="grey", linewidth=0.8)
    accelerations.axhline(CURVE_LIMITS.acceleration, color="grey", linewidth=0.8)
    speeds.legend(fontsize=8)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    draw(drawing.IMAGES / "trajectory.png")
