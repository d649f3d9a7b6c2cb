"""Shapes as boxes along the axes of the world, as our collision check, camera and physics have them.

A box along the axes stays as it is.  Any other shape is covered by boxes of a cell's width, so that every point of them
is within a cell (of tilted shapes, a cell's diagonal) of the shape: a vehicle never flies through it, and at most a
cell too far around it.  An upright shape is cut into slices, a tilted one into columns.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.models.geometry import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE, Shape, half_extents
from mavfi.numerics.vectors import product

FINEST_CELL = 0.05
"""Width of slices and columns (m), unless they become too many."""
_COARSEST_CELL = 2.0
_FARTHEST = 1e5
"""Largest coordinate of a shape (m)."""
_MOST_BOXES = 4000
_SIDES = 16
"""Sides of the prism around a cylinder."""
_STRAIGHT = 1e-6
_RINGS = 4
"""Rings of vertices in each half of a sphere."""


class Boxes(NamedTuple):
    """Boxes along the axes.

    Attributes:
        lower: Lower corners (m). Shape (n, 3).
        upper: Upper corners (m). Shape (n, 3).
        cell: Width of slices and columns (m); 0 = none was cut.
    """

    lower: np.ndarray
    upper: np.ndarray
    cell: float


class _ConvexBody(NamedTuple):
    """A convex body.

    Attributes:
        vertices: In world axes (m). Shape (n, 3).
        is_box: Whether it is a box along the axes.
        is_upright: Whether it is a prism that stands upright.
    """

    vertices: np.ndarray
    is_box: bool
    is_upright: bool


def boxes_of(shapes: Sequence[Shape]) -> Boxes:
    """Boxes that cover shapes, with the finest cell for which they are not too many.

    Raises:
        BadInputError: They are too many, or a shape is no convex body of finite size.
    """
    bodies = []
    for shape in shapes:
        vertices = _vertices_of(shape)
        bodies.append(_ConvexBody(vertices, _is_along_axes(shape), _is_upright(vertices)))
    cell = FINEST_CELL
    while sum(_count(body, cell) for body in bodies) > _MOST_BOXES:
        cell *= 1.5
        if cell > _COARSEST_CELL:
            raise BadInputError(f"{len(shapes)} shapes are more than {_MOST_BOXES:,} boxes; allowed: at most so many")
    corners: list[tuple[np.ndarray, np.ndarray]] = []
    for body in bodies:
        if body.is_box:
            corners.append((body.vertices.min(axis=0), body.vertices.max(axis=0)))
        elif body.is_upright:
            corners += _slices(body.vertices, cell)
        else:
            corners += _columns(body.vertices, cell)
    lower = np.array([low for low, _ in corners]).reshape(-1, 3)
    upper = np.array([high for _, high in corners]).reshape(-1, 3)
    if all(body.is_box for body in bodies):
        cell = 0.0
    return Boxes(lower, upper, cell)


def _count(body: _ConvexBody, cell: float) -> int:
    """Number of boxes that cover a body, at most."""
    if body.is_box:
        return 1
    extent = body.vertices.max(axis=0) - body.vertices.min(axis=0)
    across = [max(1, math.ceil(float(extent[axis]) / cell - _STRAIGHT)) for axis in (0, 1)]
    if body.is_upright:
        return min(across)
    return across[0] * across[1]


def _is_along_axes(shape: Shape) -> bool:
    """Whether a shape is a box along the axes of the world."""
    return shape.kind == BOX and bool((np.abs(shape.pose.matrix) > 1.0 - _STRAIGHT).sum() == 3)


def _vertices_of(shape: Shape) -> np.ndarray:
    """Vertices, in world axes (m), of a convex body around a shape. Shape (n, 3)."""
    if shape.vertices is not None:
        local = shape.vertices
    elif shape.kind == BOX:
        local = half_extents(shape) * _SIGNS
    elif shape.kind == CYLINDER:
        radius = shape.size[0] / math.cos(math.pi / _SIDES)
        local = np.concatenate([_ring(radius, sign * 0.5 * shape.size[1]) for sign in (-1.0, 1.0)])
    elif shape.kind in (SPHERE, CAPSULE, ELLIPSOID):
        local = _rounded(shape)
    else:
        raise BadInputError(f"{shape.owner}: {shape.kind}: is no box")
    vertices: np.ndarray = product(local, shape.pose.matrix.T) + shape.pose.position
    if not (np.abs(vertices) <= _FARTHEST).all():  # NaN, too
        raise BadInputError(f"{shape.owner}: {shape.kind} beyond {_FARTHEST:g} m; allowed: finite sizes and places")
    return vertices


_SIGNS = 2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0


def _ring(radius: float, height: float) -> np.ndarray:
    """Corners of a polygon around a circle (m). Shape (_SIDES, 3)."""
    angles = [2.0 * math.pi * (n + 0.5) / _SIDES for n in range(_SIDES)]
    return np.array([(radius * math.cos(angle), radius * math.sin(angle), height) for angle in angles])


def _rounded(shape: Shape) -> np.ndarray:
    """Vertices of a body around a sphere, an ellipsoid or a capsule (m): rings, enlarged so that it is inside."""
    rings = []
    for n in range(-_RINGS, _RINGS + 1):
        angle = 0.5 * math.pi * n / _RINGS
        rings.append(_ring(math.cos(angle), math.sin(angle)))
    enlarged = 1.0 / (math.cos(math.pi / _SIDES) * math.cos(0.25 * math.pi / _RINGS))
    unit: np.ndarray = enlarged * np.concatenate(rings)
    if shape.kind == CAPSULE:
        local = unit * shape.size[0]
        local[:, 2] += np.where(local[:, 2] < 0.0, -0.5, 0.5) * shape.size[1]
        # the middle ring belongs to both ends
        middle = np.abs(unit[:, 2]) < _STRAIGHT
        return np.concatenate([local, local[middle] - [0.0, 0.0, shape.size[1]]])
    around: np.ndarray = unit * half_extents(shape)
    return around


def _is_upright(vertices: np.ndarray) -> bool:
    """Whether a body is a prism whose ends are level, and stand above each other."""
    at_bottom = vertices[:, 2] < vertices[:, 2].min() + _STRAIGHT
    at_top = vertices[:, 2] > vertices[:, 2].max() - _STRAIGHT
    return bool((at_bottom | at_top).all()) and _same_outline(vertices[at_bottom], vertices[at_top])


def _same_outline(bottom: np.ndarray, top: np.ndarray) -> bool:
    """Whether two faces stand above each other."""
    if len(bottom) != len(top):
        return False
    gaps = np.abs(bottom[:, None, :2] - top[None, :, :2]).max(axis=2)
    return bool((gaps.min(axis=1) < _STRAIGHT).all())


def _slices(vertices: np.ndarray, cell: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boxes of an upright prism, across the shorter of its extents; see `_ConvexBody`."""
    bottom = vertices[:, 2].min()
    top = vertices[:, 2].max()
    base = vertices[vertices[:, 2] < bottom + _STRAIGHT, :2]
    hull = _hull_of(base)
    if hull is None:  # without width
        return []
    outline = base[hull.vertices]
    extent = outline.max(axis=0) - outline.min(axis=0)
    along = int(np.argmin(extent))
    across = 1 - along
    count = max(1, math.ceil(extent[along] / cell - _STRAIGHT))
    edges = outline[:, along].min() + extent[along] * np.arange(count + 1) / count
    boxes = []
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        inside = _clip(_clip(outline, along, first, 1.0), along, last, -1.0)
        if not len(inside):
            continue
        low = np.empty(3)
        high = np.empty(3)
        low[along] = first
        high[along] = last
        low[across] = inside[:, across].min()
        high[across] = inside[:, across].max()
        low[2] = bottom
        high[2] = top
        boxes.append((low, high))
    return boxes


def _columns(vertices: np.ndarray, cell: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boxes of a convex body in any position: columns over square cells."""
    hull = _hull_of(vertices)
    if hull is None:  # flat
        return [(vertices.min(axis=0), vertices.max(axis=0))]
    faces = vertices[hull.simplices]
    low = vertices.min(axis=0)
    high = vertices.max(axis=0)
    nx, ny = (max(1, math.ceil((high[axis] - low[axis]) / cell - _STRAIGHT)) for axis in (0, 1))
    xs = low[0] + (high[0] - low[0]) * np.arange(nx + 1) / nx
    ys = low[1] + (high[1] - low[1]) * np.arange(ny + 1) / ny
    bottom = np.full((nx, ny), np.inf)
    top = np.full((nx, ny), -np.inf)
    for face in faces:
        for i in range(*_range(face[:, 0], xs)):
            strip = _clip(_clip(face, 0, xs[i], 1.0), 0, xs[i + 1], -1.0)
            if not len(strip):
                continue
            for j in range(*_range(strip[:, 1], ys)):
                part = _clip(_clip(strip, 1, ys[j], 1.0), 1, ys[j + 1], -1.0)
                if len(part):
                    bottom[i, j] = min(bottom[i, j], part[:, 2].min())
                    top[i, j] = max(top[i, j], part[:, 2].max())
    boxes = []
    for i, j in np.argwhere(top > bottom + _STRAIGHT):
        boxes.append((np.array([xs[i], ys[j], bottom[i, j]]), np.array([xs[i + 1], ys[j + 1], top[i, j]])))
    return boxes


def _range(values: np.ndarray, edges: np.ndarray) -> tuple[int, int]:
    """Numbers of the first cell that values reach, and of the one after the last."""
    first = int(np.searchsorted(edges, values.min(), side="right")) - 1
    last = int(np.searchsorted(edges, values.max(), side="left"))
    return max(0, first), min(len(edges) - 1, max(last, first + 1))


def _clip(polygon: np.ndarray, axis: int, value: float, side: float) -> np.ndarray:
    """Part of a convex polygon above (`side` 1) or below (-1) a value of a coordinate. Shape (n, 2 or 3)."""
    if not len(polygon):
        return polygon
    distance = side * (polygon[:, axis] - value)
    if (distance >= 0.0).all():
        return polygon
    points = []
    for n in range(len(polygon)):
        after = (n + 1) % len(polygon)
        if distance[n] >= 0.0:
            points.append(polygon[n])
        if (distance[n] >= 0.0) != (distance[after] >= 0.0):
            share = distance[n] / (distance[n] - distance[after])
            points.append(polygon[n] + share * (polygon[after] - polygon[n]))
    return np.array(points).reshape(-1, polygon.shape[1])


def _hull_of(points: np.ndarray) -> Any | None:  # noqa: ANN401 - scipy's ConvexHull
    """Convex hull of points; None = they lie in a plane, or on a line."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        return ConvexHull(points)
    except QhullError:
        return None
