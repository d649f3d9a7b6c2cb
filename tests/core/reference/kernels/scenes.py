"""Small grids with seeded obstacles, shared by the reference and property tests."""

import numpy as np

from mavfi.numerics.voxels import Grid

GRID = Grid(-2.25, -1.75, -0.25, 2.0, 18, 14, 9)
LOWER = np.array([GRID.x0, GRID.y0, GRID.z0])
UPPER = LOWER + np.array([GRID.nx, GRID.ny, GRID.nz]) / GRID.inverse


def counter(random, share=0.1, grid=GRID):
    """Blocked voxels at random. Shape (grid.size,), int16."""
    return (random.random(grid.size) < share).astype(np.int16)


def point(random, margin=0.0):
    """A point in the grid, or up to `margin` outside (m)."""
    return random.uniform(LOWER - margin, UPPER + margin)


def smooth_points(random, count=120, period=0.02):
    """Trajectory points along a gentle curve through the grid. Shape (count, 11)."""
    t = np.linspace(0.0, 1.0, count)
    ends = [point(random) for _ in range(4)]
    weights = [(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3]
    points = np.zeros((count, 11))
    points[:, :3] = sum(w[:, None] * e for w, e in zip(weights, ends, strict=True))
    points[:, 4:7] = np.gradient(points[:, :3], period, axis=0)
    points[:, 3] = np.arctan2(points[:, 5], points[:, 4])
    points[:, 7:10] = np.gradient(points[:, 4:7], period, axis=0)
    points[:, 10] = period
    return points
