"""A consumer's copy of the map with its clearance counters, and how to take the last updates back."""

import numpy as np

from mavfi.kernels.perception import clearance
from mavfi.numerics.voxels import offsets_within
from mavfi.pipeline.kernel import PipelineConfig, map_grid
from mavfi.states import State


class Room:
    """Where there is room to fly, as far as a kernel knows from map updates.

    Attributes:
        grid: Geometry.
        cells: UNKNOWN, KNOWN_FREE or OCCUPIED. Shape (grid.size,), uint8.
        wide: > 0 = nearer than the planner's radius to an occupied voxel. Shape (grid.size,), int16.
        narrow: Same for the checker's radius.
        updates: How many map updates were taken over.
    """

    def __init__(self, config: PipelineConfig) -> None:
        self.grid = map_grid(config)
        self.cells = np.zeros(self.grid.size, np.uint8)
        self.wide = np.zeros(self.grid.size, np.int16)
        self.narrow = np.zeros(self.grid.size, np.int16)
        boxes = config.stack.distance == "boxes"
        self._wide_offsets = offsets_within(config.plan_radius, self.grid.resolution, boxes)
        self._narrow_offsets = offsets_within(config.check_radius, self.grid.resolution, boxes)
        self._journal: list[tuple[np.ndarray, np.ndarray]] = []
        self.updates = 0

    def apply(self, update: State) -> None:
        """Take a `perception.map_update` over."""
        voxels = np.ascontiguousarray(update.elements["voxel"])
        log_odds = np.ascontiguousarray(update.elements["log_odds"])
        changed_voxels = np.empty(len(voxels), np.int32)
        changed_cells = np.empty(len(voxels), np.uint8)
        count = clearance.apply_updates(
            voxels, log_odds, self.grid, self.cells, self.wide, self._wide_offsets, self.narrow, self._narrow_offsets,
            changed_voxels, changed_cells,
        )  # fmt: skip
        self._journal.append((changed_voxels[:count], changed_cells[:count]))
        self.updates += 1

    def mark(self) -> None:
        """Remember the map as it is."""
        self._journal.clear()

    def rollback(self) -> None:
        """Take back every update since the last mark."""
        for voxels, cells in reversed(self._journal):
            clearance.undo_updates(
                self.grid, self.cells, self.wide, self._wide_offsets, self.narrow, self._narrow_offsets, voxels, cells,
                len(voxels),
            )  # fmt: skip
            self.updates -= 1
        self._journal.clear()
