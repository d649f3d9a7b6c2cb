"""A world: obstacles, start and goal, and the limits of the arena."""

import hashlib
import math
from dataclasses import dataclass, field, fields
from typing import NamedTuple

import numpy as np

from mavfi.numerics.vectors import length


class Voxels(NamedTuple):
    """The solid voxels of a world, for compiled code; an empty grid in a world of boxes.

    The only class of this name: Numba dispatches slowly when two named tuples share a name.
    """

    occupied: np.ndarray
    origin: np.ndarray
    resolution: float


def _no_boxes() -> np.ndarray:
    return np.zeros((0, 3))


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """One world, in the frame ENU with z up (m).  Its arrays are read-only.

    Obstacles are either boxes in a world with ground at z = 0, or the voxels of a scan.  Everything outside the voxel
    grid is solid.

    Attributes:
        start: Start of the mission. Shape (3,).
        goal: Goal of the mission. Shape (3,).
        arena_lower: Lower corner of the arena: extent of the map and reference of the fly-away rule. Shape (3,).
        arena_upper: Upper corner of the arena. Shape (3,).
        flight_lower: Lower corner of the volume that planners may use. Shape (3,).
        flight_upper: Upper corner of the volume that planners may use. Shape (3,).
        lower: Lower corners of the boxes. Shape (n, 3).
        upper: Upper corners of the boxes. Shape (n, 3).
        occupied: Solid voxels. Shape (nx, ny, nz), bool; (0, 0, 0) in a world of boxes.
        origin: Lower corner of voxel (0, 0, 0). Shape (3,).
        resolution: Edge of a voxel.
    """

    start: np.ndarray
    goal: np.ndarray
    arena_lower: np.ndarray
    arena_upper: np.ndarray
    flight_lower: np.ndarray
    flight_upper: np.ndarray
    lower: np.ndarray = field(default_factory=_no_boxes)
    upper: np.ndarray = field(default_factory=_no_boxes)
    occupied: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 0), np.bool_))
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    resolution: float = 1.0

    @property
    def course(self) -> float:
        """Distance from start to goal (m)."""
        return length(self.goal - self.start)

    def __post_init__(self) -> None:
        for attribute in fields(self):
            value = getattr(self, attribute.name)
            if attribute.name == "resolution":
                continue
            wanted = np.bool_ if attribute.name == "occupied" else np.float64
            array: np.ndarray = np.ascontiguousarray(value, wanted).view()
            array.flags.writeable = False
            object.__setattr__(self, attribute.name, array)

    @property
    def is_voxels(self) -> bool:
        """Whether the obstacles are voxels."""
        return self.occupied.size > 0

    @property
    def voxels(self) -> Voxels:
        """Its voxels for compiled code."""
        return Voxels(self.occupied, self.origin, self.resolution)

    def clearance(self, points: np.ndarray) -> np.ndarray:
        """True distance to the nearest obstacle, or to the ground in a world of boxes.

        Args:
            points: World frame (m). Shape (n, 3).

        Returns:
            Distance (m), 0 inside an obstacle, NaN for a point that is not finite. Shape (n,).
        """
        return np.array([self._clearance(point) for point in np.atleast_2d(np.asarray(points, np.float64))])

    def _clearance(self, point: np.ndarray) -> float:
        if not np.isfinite(point).all():
            return math.nan
        if self.is_voxels:
            return _clearance_of_voxels(point - self.origin, self.occupied, self.resolution)
        return _clearance_of_boxes(point, self.lower, self.upper)

    def digest(self) -> str:
        """SHA-256 over obstacles, start, goal and limits."""
        content = hashlib.sha256()
        for attribute in fields(self):
            value = np.asarray(getattr(self, attribute.name))
            content.update(f"{attribute.name}{value.shape}".encode() + value.tobytes())
        return content.hexdigest()


def _clearance_of_boxes(point: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    gaps = np.maximum(np.maximum(lower - point, point - upper), 0.0)
    distances = np.sqrt(np.square(gaps).sum(axis=1))
    return float(min(distances.min(initial=math.inf), max(point[2], 0.0)))


def _clearance_of_voxels(point: np.ndarray, occupied: np.ndarray, resolution: float) -> float:
    """Searches larger and larger cubes around a point, given from the grid's lower corner, until one has an obstacle.

    Everything outside the grid is solid.
    """
    to_edge = float(min(point.min(), (np.array(occupied.shape) * resolution - point).min()))
    if to_edge <= 0.0:
        return 0.0
    reach = 4.0 * resolution
    while True:
        first = np.maximum(((point - reach) / resolution).astype(int), 0)
        last = ((point + reach) / resolution).astype(int) + 1
        cube = occupied[first[0] : last[0], first[1] : last[1], first[2] : last[2]]
        lower = (first + np.argwhere(cube)) * resolution
        gaps = np.maximum(np.maximum(lower - point, point - lower - resolution), 0.0)
        nearest = min(to_edge, float(np.sqrt(np.square(gaps).sum(axis=1)).min(initial=math.inf)))
        if nearest <= reach:
            return nearest
        reach *= 2.0
