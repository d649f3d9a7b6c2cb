"""Clearance map: a consumer's copy of the map with clearance counters, and rollback of its updates."""

import numpy as np

from mavfi.kernels.perception import clearance
from mavfi.numerics.voxels import offsets_within
from mavfi.pipeline.functions import Compiled
from mavfi.pipeline.kernel import PipelineConfig, map_grid
from mavfi.pipeline.memory import ArrayChange, Changes
from mavfi.states import State


class ClearanceMap:
    """Clearance map: free space according to the map updates that a kernel has received.

    Attributes:
        grid: Geometry of the map.
        cells: UNKNOWN, KNOWN_FREE or OCCUPIED. Shape (grid.size,), uint8.
        wide: > 0 = closer to an occupied voxel than the planner's radius. Shape (grid.size,), int16.
        narrow: The same counters for the checker's radius.
        updates: Number of map updates applied.
    """

    def __init__(self, config: PipelineConfig, apply_updates: Compiled = clearance.apply_updates) -> None:
        self._apply_updates = apply_updates
        self.grid = map_grid(config)
        self.cells = np.zeros(self.grid.size, np.uint8)
        self.wide = np.zeros(self.grid.size, np.int16)
        self.narrow = np.zeros(self.grid.size, np.int16)
        boxes = config.autopilot.distance == "boxes"
        wide_offsets = offsets_within(config.plan_radius, self.grid.resolution, boxes)
        narrow_offsets = offsets_within(config.check_radius, self.grid.resolution, boxes)
        self._counters = (self.cells, self.wide, wide_offsets, self.narrow, narrow_offsets)
        self._rewindable = config.rewindable
        self._changes = Changes(self.cells)
        self._marked = 0
        self.updates = 0

    def apply(self, update: State) -> None:
        """Apply a `perception.map_update` to cells and counters."""
        voxels = update.elements["voxel"]
        log_odds = update.elements["log_odds"]
        changed_voxels = np.zeros(len(voxels), np.int32)
        changed_cells = np.zeros(len(voxels), np.uint8)
        count = self._apply_updates(voxels, log_odds, self.grid, *self._counters, changed_voxels, changed_cells)
        voxels = changed_voxels[:count].copy()
        self._changes.note(voxels, changed_cells[:count].copy(), self.cells[voxels])
        self.updates += 1

    def _put(self, voxels: np.ndarray, cells: np.ndarray) -> None:
        """Set the states of voxels, and update the counters accordingly."""
        # `undo_updates` begins with the last one
        voxels_reversed = np.ascontiguousarray(voxels[::-1])
        cells_reversed = np.ascontiguousarray(cells[::-1])
        clearance.undo_updates(self.grid, *self._counters, voxels_reversed, cells_reversed, len(voxels))

    def mark(self) -> None:
        """Save the current map for `rollback`."""
        if not self._rewindable:
            self._changes.forget()
        self._marked = len(self._changes)

    def rollback(self) -> None:
        """Undo all updates since the last mark."""
        self.updates -= len(self._changes) - self._marked
        self._changes.take_back(self._marked, self._put)

    def save(self) -> tuple[tuple[ArrayChange, ...], int, int]:
        """All changes so far, their number at the last mark, and the number of updates."""
        return self._changes.save(), self._marked, self.updates

    def restore(self, saved: tuple[tuple[ArrayChange, ...], int, int]) -> None:
        """Restore the result of `save`."""
        changes, self._marked, self.updates = saved
        cells = self._changes.restore(changes)
        flips = np.flatnonzero((self.cells == clearance.OCCUPIED) != (cells == clearance.OCCUPIED)).astype(np.int32)
        self._put(flips, cells[flips])  # counters depend on the occupied voxels alone
        self.cells[:] = cells

    def same(self, saved: tuple[tuple[ArrayChange, ...], int, int]) -> bool:
        """Whether the map, and the map after a rollback, are equal; counters are implied by the cells."""
        changes, marked, updates = saved
        revocable = len(self._changes) - self._marked
        if self.updates != updates or revocable != len(changes) - marked:
            return False
        return self._changes.same(changes, revocable)

    def arrays(self) -> dict[str, np.ndarray]:
        """Cells and counters."""
        return {"cells": self.cells, "wide": self.wide, "narrow": self.narrow}
