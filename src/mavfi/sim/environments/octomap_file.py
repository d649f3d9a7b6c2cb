"""`octomap_file`: a scanned building, read from an OctoMap file (`.bt` or `.ot`).

Formats: OctoMap, Hornung et al. 2013, Autonomous Robots 34; serialisation as in its OcTree class.  Both start with text
lines (id, size, res, data), followed by the nodes in depth-first order, children ordered by x, y, z bit:

- `.bt`: two bytes for each inner node, two bits for each child: unknown, occupied, free, or inner node.  The map
  contains its maximum-likelihood occupancy.
- `.ot`: for each node its log-odds as float32, and one byte that flags its children.
"""

import math
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from mavfi.config import Vector
from mavfi.errors import BadInputError
from mavfi.files import read_file
from mavfi.numerics.jit import kernel_jit
from mavfi.sim.environments.generated import checked_number
from mavfi.sim.environments.world import Voxels, World

_DEPTH = 16
_HALF_RANGE = 1 << (_DEPTH - 1)
_MARGIN = 1
_LARGEST_GRID = 1 << 26
_LARGEST_FILE = 1 << 28
_HEADERS = {b"# Octomap OcTree binary file": False, b"# Octomap OcTree file": True}
_TRUNCATED, _TOO_DEEP = -1, -2
_SOLID, _INNER = 2, 3
"""Kinds of children in a `.bt` file; 0 is unknown, 1 free."""
_PASSAGE, _NEAR = 0.2, 1.0
_MARGINS = (1.0, 2.0, 4.0, 8.0, 16.0, math.inf)


class Leaves(NamedTuple):
    """Known leaves of an octree.

    Attributes:
        corner: Lower corner, in finest voxels from the map's least key. Shape (n, 3), int32.
        edge: Edge length, in finest voxels. Shape (n,), int32.
        occupied: Solid or free. Shape (n,), bool.
    """

    corner: np.ndarray
    edge: np.ndarray
    occupied: np.ndarray


def octomap_file(
    seed: int, path: str, start: Vector | None = None, goal: Vector | None = None, band: float = 0.9
) -> World:
    """The world of a scan, in which unobserved space is solid.

    Planners treat unknown space as free, and a forward-looking camera sees neither floor and ceiling nor the space
    behind.  So they are confined to a box around start and goal: `band` above and below, and as narrow as possible for
    a sphere of 0.2 m to pass.

    Args:
        seed: Not used: a scan is the same for every seed.
        path: File, `.bt` or `.ot`.
        start: Start (m); required.
        goal: Goal (m); required.
        band: Vertical margin of planned paths above and below start and goal (m).

    Raises:
        BadInputError: The file is absent, foreign, truncated or too large, start or goal are missing, or there is no
            path between them.
    """
    del seed
    if not isinstance(path, str):
        raise BadInputError(f"parameter 'path': {path!r}; allowed: a file ending in .bt or .ot")
    if start is None or goal is None:
        raise BadInputError(f"{path}: a scanned map has no start and goal of its own; give both")
    try:
        modified = Path(path).stat().st_mtime_ns
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read ({error.strerror})") from None
    occupied, origin, resolution = _read_grid(path, modified)
    voxels, band = Voxels(occupied, origin, resolution), checked_number("band", band, 0.1, 1000.0)
    box = _flight_box(voxels, np.array([start, goal], float), band)
    if box is None:
        raise BadInputError(
            f"{path}: no way from {start} to {goal} for a sphere of {_PASSAGE} m within {band} m of their heights"
        )
    return World(
        start=np.array(start),
        goal=np.array(goal),
        arena_lower=origin,
        arena_upper=origin + resolution * np.array(occupied.shape),
        flight_lower=box[0],
        flight_upper=box[1],
        occupied=occupied,
        origin=origin,
        resolution=resolution,
    )


def _flight_box(voxels: Voxels, ends: np.ndarray, band: float) -> tuple[np.ndarray, np.ndarray] | None:
    """The narrowest box around both ends that contains a path between them; its corners (m)."""
    corner = voxels.origin + voxels.resolution * np.array(voxels.occupied.shape)
    for margin in _MARGINS:
        lower = np.maximum(voxels.origin, ends.min(axis=0) - (margin, margin, band))
        upper = np.minimum(corner, ends.max(axis=0) + (margin, margin, band))
        if (lower < upper).all() and _is_passable(voxels, ends, lower, upper):
            return lower, upper
    return None


def _is_passable(voxels: Voxels, ends: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> bool:
    """Whether a sphere can move from near the start to near the goal with its centre inside a box."""
    first = np.floor((lower - voxels.origin) / voxels.resolution).astype(int)
    last = np.ceil((upper - voxels.origin) / voxels.resolution).astype(int)
    reach = math.ceil(_PASSAGE / voxels.resolution) + 1
    around = tuple(slice(max(0, a - reach), b + reach) for a, b in zip(first, last, strict=True))
    free = np.pad(~voxels.occupied[around], reach)
    distance = ndimage.distance_transform_edt(free) * voxels.resolution
    offset = reach + first - np.maximum(0, first - reach)
    inside = tuple(slice(o, o + n) for o, n in zip(offset, last - first, strict=True))
    regions, _ = ndimage.label(distance[inside] > _PASSAGE + 0.5 * voxels.resolution, np.ones((3, 3, 3)))
    places = np.argwhere(regions > 0)
    labels = regions[tuple(places.T)]
    centres = voxels.origin + voxels.resolution * (first + places + 0.5)
    near_start, near_goal = (labels[np.linalg.norm(centres - end, axis=1) < _NEAR] for end in ends)
    return bool(np.intersect1d(near_start, near_goal).size)


@lru_cache(maxsize=2)
def _read_grid(path: str, _modified_ns: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Solid voxels, their origin (m) and resolution (m)."""
    leaves, resolution = read_octree(Path(path))
    if not len(leaves.edge):
        raise BadInputError(f"{path}: the map holds no known space")
    least = leaves.corner.min(axis=0) - _MARGIN
    shape = (leaves.corner + leaves.edge[:, None]).max(axis=0) + _MARGIN - least
    if math.prod(int(n) for n in shape) > _LARGEST_GRID:
        raise BadInputError(f"{path}: {' x '.join(map(str, shape))} voxels; allowed: {_LARGEST_GRID} at most")
    occupied = np.ones(tuple(int(n) for n in shape), np.bool_)
    _carve(leaves.corner - least.astype(np.int32), leaves.edge, leaves.occupied, occupied)
    occupied.flags.writeable = False
    return occupied, (least - _HALF_RANGE) * resolution, resolution


@kernel_jit
def _carve(corner: np.ndarray, edge: np.ndarray, solid: np.ndarray, occupied: np.ndarray) -> None:
    for n in range(len(edge)):
        if not solid[n]:
            i, j, k, size = corner[n, 0], corner[n, 1], corner[n, 2], edge[n]
            occupied[i : i + size, j : j + size, k : k + size] = False


def read_octree(path: Path) -> tuple[Leaves, float]:
    """The known leaves of a map, and its resolution (m).

    Args:
        path: File, `.bt` or `.ot`.

    Raises:
        BadInputError: The file cannot be read, is not an OctoMap OcTree, or is truncated.
    """
    content = read_file(path, _LARGEST_FILE)
    has_values, resolution, offset = _read_header(path, content)
    nodes = np.frombuffer(content, np.uint8, offset=offset)
    nothing = Leaves(np.zeros((0, 3), np.int32), np.zeros(0, np.int32), np.zeros(0, np.bool_))
    count = _parse(nodes, has_values, nothing)
    if count == _TRUNCATED:
        raise BadInputError(f"{path}: truncated: the octree does not end within the file")
    if count == _TOO_DEEP:
        raise BadInputError(f"{path}: not an octree of {_DEPTH} levels")
    leaves = Leaves(np.empty((count, 3), np.int32), np.empty(count, np.int32), np.empty(count, np.bool_))
    _parse(nodes, has_values, leaves)
    return leaves, resolution


def _read_header(path: Path, content: bytes) -> tuple[bool, float, int]:
    """Whether nodes have values, resolution, and offset of the nodes."""
    first, _, _ = content[:200].partition(b"\n")
    if first.strip() not in _HEADERS:
        raise BadInputError(f"{path}: not a map of OctoMap; allowed: an OcTree, .bt or .ot")
    values: dict[bytes, bytes] = {}
    offset = 0
    while b"data" not in values:
        end = content.find(b"\n", offset)
        if end < 0:
            raise BadInputError(f"{path}: truncated: the header has no line 'data'")
        key, _, value = content[offset:end].strip().partition(b" ")
        if not key.startswith(b"#"):
            values[key] = value.strip()
        offset = end + 1
    if values.get(b"id") != b"OcTree":
        raise BadInputError(f"{path}: id {values.get(b'id')!r}; allowed: OcTree")
    try:
        resolution = float(values[b"res"])
    except (KeyError, ValueError):
        resolution = math.nan
    if not 1e-3 <= resolution <= 100.0:
        raise BadInputError(f"{path}: res {values.get(b'res')!r}; allowed: 0.001 to 100 m")
    return _HEADERS[first.strip()], resolution, offset


@kernel_jit
def _parse(nodes: np.ndarray, has_values: bool, leaves: Leaves) -> int:
    """Traverse the nodes; store leaves up to the capacity, and return their number.

    Args:
        nodes: Bytes of the nodes. Shape (n,), uint8.
        has_values: Whether they are those of an `.ot` file.
        leaves: Output.
    """
    stack = np.zeros((8 * _DEPTH + 1, 4), np.int32)
    stack[0, 3] = _DEPTH
    top, at, count = 1, 0, 0
    while top > 0:
        top -= 1
        x, y, z, level = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        if level == 0 and not has_values:
            return _TOO_DEEP
        if at + (5 if has_values else 2) > len(nodes):
            return _TRUNCATED
        if has_values:
            log_odds = nodes[at : at + 4].copy().view(np.float32)[0]
            bits = int(nodes[at + 4])
            at += 5
            if bits == 0:
                _store(leaves, count, (x, y, z), 1 << level, not (log_odds < 0.0))
                count += 1
                continue
            if level == 0:
                return _TOO_DEEP
        else:
            bits = int(nodes[at]) | int(nodes[at + 1]) << 8
            at += 2
        half = 1 << (level - 1)
        for child in range(7, -1, -1):
            kind = 3 * (bits >> child & 1) if has_values else bits >> (2 * child) & 3
            corner = (x + (child & 1) * half, y + (child >> 1 & 1) * half, z + (child >> 2) * half)
            if kind == _INNER:
                _push(stack, top, corner, level - 1)
                top += 1
            elif kind > 0:
                _store(leaves, count, corner, half, kind == _SOLID)
                count += 1
    return count


@kernel_jit
def _push(stack: np.ndarray, top: int, corner: tuple[int, int, int], level: int) -> None:
    stack[top, 0] = corner[0]
    stack[top, 1] = corner[1]
    stack[top, 2] = corner[2]
    stack[top, 3] = level


@kernel_jit
def _store(leaves: Leaves, index: int, corner: tuple[int, int, int], edge: int, occupied: bool) -> None:
    if index < len(leaves.edge):
        leaves.corner[index, 0] = corner[0]
        leaves.corner[index, 1] = corner[1]
        leaves.corner[index, 2] = corner[2]
        leaves.edge[index] = edge
        leaves.occupied[index] = occupied
