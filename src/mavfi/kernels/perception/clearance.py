"""A consumer's clearance map: known and occupied voxels, and voxels too close to an occupied one.

Map updates arrive as (voxel, log-odds).  Counters over balls of offsets are updated incrementally, so that a clearance
query is one array read.  Every change is journalled, so that a stage can be recomputed from the same memory.
"""

import numpy as np

from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import Grid

UNKNOWN = 0
KNOWN_FREE = 1
OCCUPIED = 2


@kernel_jit
def _reach(offsets: np.ndarray) -> int:
    """Largest offset along an axis."""
    reach = 0
    for i in range(offsets.shape[0]):
        reach = max(reach, max(abs(offsets[i, 0]), max(abs(offsets[i, 1]), abs(offsets[i, 2]))))
    return reach


@kernel_jit
def _move(counter: np.ndarray, grid: Grid, voxel: int, offsets: np.ndarray, reach: int, step: int) -> None:
    """Add `step` to the counters around a voxel; `reach` is the largest of the offsets."""
    ix = voxel // (grid.ny * grid.nz)
    iy = (voxel // grid.nz) % grid.ny
    iz = voxel % grid.nz
    margin = min(min(ix, grid.nx - 1 - ix), min(min(iy, grid.ny - 1 - iy), min(iz, grid.nz - 1 - iz)))
    if margin >= reach:  # the whole ball is inside the grid
        for i in range(offsets.shape[0]):
            counter[voxel + (offsets[i, 0] * grid.ny + offsets[i, 1]) * grid.nz + offsets[i, 2]] += step
        return
    for i in range(offsets.shape[0]):
        x = ix + offsets[i, 0]
        y = iy + offsets[i, 1]
        z = iz + offsets[i, 2]
        if 0 <= x < grid.nx and 0 <= y < grid.ny and 0 <= z < grid.nz:
            counter[(x * grid.ny + y) * grid.nz + z] += step


@kernel_jit
def set_cell(
    grid: Grid,
    cells: np.ndarray,
    wide: np.ndarray,
    wide_offsets: np.ndarray,
    wide_reach: int,
    narrow: np.ndarray,
    narrow_offsets: np.ndarray,
    narrow_reach: int,
    voxel: int,
    value: int,
) -> None:
    """Set the state of a voxel, and update both counters if its occupancy changes.

    Arguments as for `apply_updates`; reaches are those of the offsets.
    """
    was = cells[voxel]
    cells[voxel] = value
    if (was == OCCUPIED) != (value == OCCUPIED):
        step = 1 if value == OCCUPIED else -1
        _move(wide, grid, voxel, wide_offsets, wide_reach, step)
        _move(narrow, grid, voxel, narrow_offsets, narrow_reach, step)


@kernel_jit
def apply_updates(
    voxels: np.ndarray,
    log_odds: np.ndarray,
    grid: Grid,
    cells: np.ndarray,
    wide: np.ndarray,
    wide_offsets: np.ndarray,
    narrow: np.ndarray,
    narrow_offsets: np.ndarray,
    journal_voxels: np.ndarray,
    journal_cells: np.ndarray,
) -> int:
    """Apply a map update.

    Args:
        voxels: Flat indices; those outside the grid are skipped. Shape (n,), int32.
        log_odds: > 0 = occupied, else free; NaN counts as free. Shape (n,), float32.
        grid: Geometry.
        cells: UNKNOWN, KNOWN_FREE or OCCUPIED; changed. Shape (grid.size,), uint8.
        wide: Counter over the planner's ball; changed. Shape (grid.size,), int16.
        wide_offsets: Offsets of the planner's ball. Shape (k, 3).
        narrow: Counter over the checker's ball; changed. Same shape as `wide`.
        narrow_offsets: Offsets of the checker's ball. Shape (k, 3).
        journal_voxels: Output: voxels whose cell changed, in order. Shape (>= n,), int32.
        journal_cells: Output: their previous cell. Shape (>= n,), uint8.

    Returns:
        Number of changed cells.
    """
    wide_reach, narrow_reach = _reach(wide_offsets), _reach(narrow_offsets)
    changed = 0
    for i in range(voxels.shape[0]):
        voxel = voxels[i]
        if voxel < 0 or voxel >= cells.shape[0]:
            continue
        value = OCCUPIED if log_odds[i] > 0.0 else KNOWN_FREE
        if cells[voxel] != value:
            journal_voxels[changed] = voxel
            journal_cells[changed] = cells[voxel]
            changed += 1
            set_cell(grid, cells, wide, wide_offsets, wide_reach, narrow, narrow_offsets, narrow_reach, voxel, value)
    return changed


@kernel_jit
def undo_updates(
    grid: Grid,
    cells: np.ndarray,
    wide: np.ndarray,
    wide_offsets: np.ndarray,
    narrow: np.ndarray,
    narrow_offsets: np.ndarray,
    journal_voxels: np.ndarray,
    journal_cells: np.ndarray,
    count: int,
) -> None:
    """Undo the last `apply_updates`; arguments as there, `count` is its return value."""
    wide_reach, narrow_reach = _reach(wide_offsets), _reach(narrow_offsets)
    for i in range(count - 1, -1, -1):
        set_cell(
            grid,
            cells,
            wide,
            wide_offsets,
            wide_reach,
            narrow,
            narrow_offsets,
            narrow_reach,
            journal_voxels[i],
            journal_cells[i],
        )
