"""`octomap_file`: a scanned building, read from an OctoMap file (`.bt` or `.ot`).

Formats: OctoMap, Hornung et al. 2013, Autonomous Robots 34; serialisation as in its OcTree class.  Both start with text
lines (id, size, res, data), followed by the nodes in depth-first order, children ordered by x, y, z bit:

- `.bt`: two bytes for each inner node, two bits for each child: unknown, occupied, free, or inner node.  The map
  contains its maximum-likelihood occupancy.
- `.ot`: for each node its log-odds as float32, further data that depend on the type of tree (`id`), e.g. a colour, and
  one byte that flags its children.
"""

import math
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

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
_NODE_BYTES = {"OcTree": 4, "1": 4, "OcTreeStamped": 4, "ColorOcTree": 7}
"""Bytes of a node's data in `.ot` files; 1 is an old name of OcTree.  Those of other types follow from `size`."""
_WITHOUT_OCCUPANCY = ("CountingOcTree", "BoundingBoxOcTree", "EcgOcTree")
_LARGEST_LOG_ODDS = 1e4
"""Larger values are no log-odds."""
SOLID = "solid"
FREE = "free"
"""What the space is taken for that a map does not know."""
_AROUND = 5.0
"""Margin of the grid around obstacles and ends where unknown space is free (m)."""
_USUAL_RESOLUTION = 0.08
"""Resolution of the pipeline's map inside a building (m)."""
_COARSEST_RESOLUTION = 5.0
"""Limit of `map_resolution` (m); an arena that is still too large is refused later."""
_LARGEST_MAP = 1 << 27
"""Voxels of the pipeline's map, at most."""
_COARSER_MAP = 1 << 26
"""The same where the resolution is ours to choose; up to 1.7 GB."""
_MAP_MARGIN = (2.0 * _AROUND + 11.0, 2.0 * _AROUND + 11.0, 6.0)
"""Margins of that map and of ours around the scan (m)."""
_TRUNCATED = -1
_TOO_DEEP = -2
_NO_LOG_ODDS = -3
_SOLID, _INNER = 2, 3
"""Kinds of children in a `.bt` file; 0 is unknown, 1 free."""
_PASSAGE = 0.2
"""Radius of the sphere that must be able to pass (m)."""
_NEAR = 1.0
"""Distance within which a region counts as near an end (m)."""
_MARGINS = (1.0, 2.0, 4.0, 8.0, 16.0, math.inf)
"""Margins of the flight box beside the ends, tried in this order (m)."""


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


class Header(NamedTuple):
    """Header of a file.

    Attributes:
        node_bytes: Bytes of a node's data in an `.ot` file; 0 = a `.bt` file.
        resolution: Edge of a voxel (m).
        size: Number of nodes; -1 = not said.
        offset: Position of the nodes in the file.
    """

    node_bytes: int
    resolution: float
    size: int
    offset: int


def octomap_file(
    seed: int,
    path: str,
    start: Vector | None = None,
    goal: Vector | None = None,
    band: float = 0.9,
    unknown: str = SOLID,
) -> World:
    """The world of a scan, in which unobserved space is solid, unless it is said to be free.

    Planners treat unknown space as free, and a forward-looking camera sees neither floor and ceiling nor the space
    behind.  So they are confined to a box around start and goal: `band` above and below, and as narrow as possible for
    a sphere of 0.2 m to pass.

    Args:
        seed: Not used: a scan is the same for every seed.
        path: File, `.bt` or `.ot`.
        start: Start (m); required.
        goal: Goal (m); required.
        band: Vertical margin of planned paths above and below start and goal (m).
        unknown: What space is that was not observed: solid, or free, as in maps that hold obstacles only.

    Raises:
        BadInputError: The file is absent, foreign, empty, truncated or too large, start or goal are missing, or there
            is no path between them.
    """
    # Refuse what is missing or not allowed.
    del seed
    if not isinstance(path, str):
        raise BadInputError(f"parameter 'path': {path!r}; allowed: a file ending in .bt or .ot")
    if unknown not in (SOLID, FREE):
        raise BadInputError(f"parameter 'unknown': {unknown!r}; allowed: {SOLID}, {FREE}")
    if start is None or goal is None:
        raise BadInputError(f"{path}: a scanned map has no start and goal of its own; give both")

    # The voxels, and the box in which planners may move.
    ends = np.array([start, goal], float)
    band = checked_number("band", band, 0.1, 1000.0)
    if unknown == SOLID:
        occupied, origin, resolution = _read_grid(path, _modified(path))
    else:
        occupied, origin, resolution = _grid_around(path, ends, band)
    voxels = Voxels(occupied, origin, resolution)
    box = _flight_box(voxels, ends, band)
    if box is None:
        why = ""
        if unknown == SOLID:
            why = "; unknown space counts as solid, --unknown-space free takes it as free"
        raise BadInputError(
            f"{path}: no way from {start} to {goal} for a sphere of {_PASSAGE} m within {band} m of their heights{why}"
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
    from scipy import ndimage  # in the extra `report`

    first = np.floor((lower - voxels.origin) / voxels.resolution).astype(int)
    last = np.ceil((upper - voxels.origin) / voxels.resolution).astype(int)
    reach = math.ceil(_PASSAGE / voxels.resolution) + 1

    # Distances to the nearest solid voxel, also to those just outside of the box; outside of the scan all is solid.
    around = tuple(slice(max(0, low - reach), high + reach) for low, high in zip(first, last, strict=True))
    free = np.pad(~voxels.occupied[around], reach)
    distance = ndimage.distance_transform_edt(free) * voxels.resolution

    # Connected regions of the box in which the sphere has room.
    offset = reach + first - np.maximum(0, first - reach)
    inside = tuple(slice(start, start + count) for start, count in zip(offset, last - first, strict=True))
    regions, _ = ndimage.label(distance[inside] > _PASSAGE + 0.5 * voxels.resolution, np.ones((3, 3, 3)))

    # A region must come near both ends.
    cells = np.argwhere(regions > 0)
    labels = regions[tuple(cells.T)]
    centres = voxels.origin + voxels.resolution * (first + cells + 0.5)
    near_start, near_goal = (labels[np.linalg.norm(centres - end, axis=1) < _NEAR] for end in ends)
    return bool(np.intersect1d(near_start, near_goal).size)


def _modified(path: str) -> int:
    """Time of a file's last change (ns)."""
    try:
        return Path(path).stat().st_mtime_ns
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read ({error.strerror})") from None


@lru_cache(maxsize=2)
def _leaves_of(path: str, _modified_ns: int) -> tuple[Leaves, float]:
    """See `read_octree`; a map without leaves is refused."""
    leaves, resolution = read_octree(Path(path))
    if not len(leaves.edge):
        raise BadInputError(f"{path}: the map is empty; allowed: one that holds known space")
    return leaves, resolution


def _bounds(leaves: Leaves) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of the known space, in finest voxels. Shapes (3,), int64."""
    lower = leaves.corner.min(axis=0).astype(np.int64)
    upper = (leaves.corner + leaves.edge[:, None]).max(axis=0).astype(np.int64)
    return lower, upper


@lru_cache(maxsize=2)
def _read_grid(path: str, modified_ns: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Solid voxels, their origin (m) and resolution (m), of a map in which unknown space is solid."""
    leaves, resolution = _leaves_of(path, modified_ns)
    if leaves.occupied.all():
        raise BadInputError(
            f"{path}: the map holds no free voxel ({len(leaves.edge)} occupied leaves), and unknown space counts as "
            "solid; allowed: --unknown-space free (parameter 'unknown'), or a map with free space"
        )
    lower, upper = _bounds(leaves)
    occupied = np.ones(_checked_shape(path, lower - _MARGIN, upper + _MARGIN), np.bool_)
    _carve(leaves, lower - _MARGIN, False, occupied)
    occupied.flags.writeable = False
    return occupied, (lower - _MARGIN - _HALF_RANGE) * resolution, resolution


def _grid_around(path: str, ends: np.ndarray, band: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Grid of a map in which unknown space is free: around its obstacles and both ends, with a margin."""
    leaves, resolution = _leaves_of(path, _modified(path))
    lower, upper = _bounds(leaves)
    margin = np.array([_AROUND, _AROUND, band + 1.0])
    lower = np.minimum(lower, np.floor((ends.min(axis=0) - margin) / resolution).astype(np.int64) + _HALF_RANGE)
    upper = np.maximum(upper, np.ceil((ends.max(axis=0) + margin) / resolution).astype(np.int64) + _HALF_RANGE)
    around = math.ceil(_AROUND / resolution)
    lower[:2] -= around
    upper[:2] += around
    occupied = np.zeros(_checked_shape(path, lower, upper), np.bool_)
    _carve(leaves, lower, True, occupied)
    return occupied, (lower - _HALF_RANGE) * resolution, resolution


def _checked_shape(path: str, lower: np.ndarray, upper: np.ndarray) -> tuple[int, ...]:
    """Shape of a grid between two corners; a large one is refused."""
    shape = tuple(int(n) for n in upper - lower)
    if math.prod(shape) > _LARGEST_GRID:
        raise BadInputError(f"{path}: {' x '.join(map(str, shape))} voxels; allowed: {_LARGEST_GRID} at most")
    return shape


def map_resolution_for(path: str) -> float:
    """Resolution of the pipeline's map for a scan (m): the usual one, or that of the file if its arena is too large.

    Raises:
        BadInputError: The file is none that can be read.
    """
    leaves, resolution = _leaves_of(path, _modified(path))
    lower, upper = _bounds(leaves)
    volume = float(np.prod((upper - lower) * resolution + _MAP_MARGIN))
    if volume <= _LARGEST_MAP * _USUAL_RESOLUTION**3:
        return _USUAL_RESOLUTION
    finest = (volume / _COARSER_MAP) ** (1.0 / 3.0)
    return float(min(max(resolution, math.ceil(100.0 * finest) / 100.0), _COARSEST_RESOLUTION))


@kernel_jit
def _carve(leaves: Leaves, lower: np.ndarray, value: bool, occupied: np.ndarray) -> None:
    """Set the voxels of all leaves that are occupied (`value` true) or free (false) to this value."""
    for n in range(len(leaves.edge)):
        if leaves.occupied[n] == value:
            i = leaves.corner[n, 0] - lower[0]
            j = leaves.corner[n, 1] - lower[1]
            k = leaves.corner[n, 2] - lower[2]
            size = leaves.edge[n]
            occupied[i : i + size, j : j + size, k : k + size] = value


def read_octree(path: Path) -> tuple[Leaves, float]:
    """The known leaves of a map, and its resolution (m).

    Args:
        path: File, `.bt` or `.ot`.

    Raises:
        BadInputError: The file cannot be read, is not an OctoMap OcTree, or is truncated.
    """
    content = read_file(path, _LARGEST_FILE)
    header = _read_header(path, content)
    nodes = np.frombuffer(content, np.uint8, offset=header.offset)
    nothing = Leaves(np.zeros((0, 3), np.int32), np.zeros(0, np.int32), np.zeros(0, np.bool_))
    if header.size == 0:
        raise BadInputError(
            f"{path}: the map is empty (size 0), a valid file without voxels; allowed: one that holds known space"
        )
    count = _parse(nodes, header.node_bytes, nothing)
    if count == _TRUNCATED:
        raise BadInputError(f"{path}: truncated: the octree does not end within the file")
    if count == _TOO_DEEP:
        raise BadInputError(f"{path}: not an octree of {_DEPTH} levels")
    if count == _NO_LOG_ODDS:
        raise BadInputError(f"{path}: its nodes do not start with log-odds; allowed: a tree of occupancy")
    leaves = Leaves(np.empty((count, 3), np.int32), np.empty(count, np.int32), np.empty(count, np.bool_))
    _parse(nodes, header.node_bytes, leaves)
    return leaves, header.resolution


def _read_header(path: Path, content: bytes) -> Header:
    """The header of a file, which ends with a line `data`."""
    first = content[:200].partition(b"\n")[0].strip()
    title = next((title for title in _HEADERS if first.startswith(title)), None)
    if title is None:
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
    kind = values.get(b"id", b"").decode(errors="replace")
    if not kind or kind in _WITHOUT_OCCUPANCY:
        raise BadInputError(
            f"{path}: id {kind!r}: its nodes hold no occupancy; allowed: a tree of occupancy, e.g. "
            f"{', '.join(name for name in _NODE_BYTES if name.isalpha())}"
        )
    try:
        resolution = float(values[b"res"])
    except (KeyError, ValueError):
        resolution = math.nan
    if not 1e-3 <= resolution <= 100.0:
        raise BadInputError(f"{path}: res {values.get(b'res')!r}; allowed: 0.001 to 100 m")
    size = -1
    if values.get(b"size", b"").isdigit():
        size = int(values[b"size"])
    node_bytes = 0
    if _HEADERS[title] and size != 0:
        node_bytes = _node_bytes(path, kind, size, len(content) - offset)
    return Header(node_bytes, resolution, size, offset)


def _node_bytes(path: Path, kind: str, size: int, length: int) -> int:
    """Bytes of a node's data in an `.ot` file: of a type that is not known, what is left for each of its nodes."""
    if kind in _NODE_BYTES:
        return _NODE_BYTES[kind]
    node_bytes, rest = divmod(length, max(size, 1))
    if rest or node_bytes < 5:
        raise BadInputError(
            f"{path}: id {kind!r}: {length} bytes for {size} nodes; allowed: {', '.join(_NODE_BYTES)}, or nodes of "
            "equal size that start with log-odds"
        )
    return node_bytes - 1


@kernel_jit
def _parse(nodes: np.ndarray, node_bytes: int, leaves: Leaves) -> int:
    """Traverse the nodes; store leaves up to the capacity, and return their number.

    Args:
        nodes: Bytes of the nodes. Shape (n,), uint8.
        node_bytes: See `Header`.
        leaves: Output.
    """
    has_values = node_bytes > 0
    stack = np.zeros((8 * _DEPTH + 1, 4), np.int32)
    stack[0, 3] = _DEPTH
    top, at, count = 1, 0, 0
    while top > 0:
        top -= 1
        x, y, z, level = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        if level == 0 and not has_values:
            return _TOO_DEEP
        node_size = 2
        if has_values:
            node_size = node_bytes + 1
        if at + node_size > len(nodes):
            return _TRUNCATED
        if has_values:
            log_odds = nodes[at : at + 4].copy().view(np.float32)[0]
            if abs(log_odds) > _LARGEST_LOG_ODDS:
                return _NO_LOG_ODDS
            bits = int(nodes[at + node_bytes])
            at += node_bytes + 1
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
