"""A world: obstacles, start and goal, and the limits of the arena."""

import hashlib
import math
from dataclasses import dataclass, field, fields
from typing import NamedTuple

import numpy as np

from mavfi.numerics.jit import kernel_jit
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
        points = np.ascontiguousarray(np.atleast_2d(points), np.float64)
        if self.is_voxels:
            return _clearance_of_voxels(points, self.occupied, self.origin, self.resolution)
        return _clearance_of_boxes(points, self.lower, self.upper)

    def digest(self) -> str:
        """SHA-256 over obstacles, start, goal and limits."""
        content = hashlib.sha256()
        for attribute in fields(self):
            value = np.asarray(getattr(self, attribute.name))
            content.update(f"{attribute.name}{value.shape}".encode() + value.tobytes())
        return content.hexdigest()


@kernel_jit
def _beyond(value: float, lower: float, upper: float) -> float:
    """Distance of a value from an interval."""
    return max(lower - value, value - upper, 0.0)


@kernel_jit
def _clearance_of_boxes(points: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    distances = np.empty(len(points))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            distances[i] = math.nan
            continue
        nearest = max(z, 0.0)
        for j in range(len(lower)):
            dx = _beyond(x, lower[j, 0], upper[j, 0])
            dy = _beyond(y, lower[j, 1], upper[j, 1])
            dz = _beyond(z, lower[j, 2], upper[j, 2])
            nearest = min(nearest, math.sqrt(dx * dx + dy * dy + dz * dz))
        distances[i] = nearest
    return distances


@kernel_jit
def _clearance_of_voxels(points: np.ndarray, occupied: np.ndarray, origin: np.ndarray, resolution: float) -> np.ndarray:
    distances = np.empty(len(points))
    for i in range(len(points)):
        distances[i] = _distance_to_voxels(points[i], occupied, origin, resolution)
    return distances


@kernel_jit
def _distance_to_voxels(point: np.ndarray, occupied: np.ndarray, origin: np.ndarray, resolution: float) -> float:
    """Searches cubic shells around the point's voxel until no farther shell can contain a nearer obstacle."""
    outside = math.inf
    for axis in range(3):
        if not math.isfinite(point[axis]):
            return math.nan
        low = point[axis] - origin[axis]
        outside = min(outside, low, occupied.shape[axis] * resolution - low)
    if outside <= 0.0:
        return 0.0
    nearest = outside
    cell = (
        int((point[0] - origin[0]) / resolution),
        int((point[1] - origin[1]) / resolution),
        int((point[2] - origin[2]) / resolution),
    )
    shell = 0
    while (shell - 1) * resolution < nearest:
        nearest = min(nearest, _nearest_in_shell(point, cell, shell, occupied, origin, resolution))
        shell += 1
    return nearest


@kernel_jit
def _nearest_in_shell(
    point: np.ndarray,
    cell: tuple[int, int, int],
    shell: int,
    occupied: np.ndarray,
    origin: np.ndarray,
    resolution: float,
) -> float:
    nearest = math.inf
    nx, ny, nz = occupied.shape
    for i in range(max(0, cell[0] - shell), min(nx, cell[0] + shell + 1)):
        for j in range(max(0, cell[1] - shell), min(ny, cell[1] + shell + 1)):
            on_face = abs(i - cell[0]) == shell or abs(j - cell[1]) == shell
            step = 1 if on_face else max(1, 2 * shell)
            first = cell[2] - shell
            for k in range(first, cell[2] + shell + 1, step):
                if k < 0 or k >= nz or not occupied[i, j, k]:
                    continue
                dx = _beyond(point[0], origin[0] + i * resolution, origin[0] + (i + 1) * resolution)
                dy = _beyond(point[1], origin[1] + j * resolution, origin[1] + (j + 1) * resolution)
                dz = _beyond(point[2], origin[2] + k * resolution, origin[2] + (k + 1) * resolution)
                nearest = min(nearest, math.sqrt(dx * dx + dy * dy + dz * dz))
    return nearest
