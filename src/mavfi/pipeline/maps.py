"""The kinds of map that kernel `octomap` can keep: a dense array, or OctoMap's octree; both hold the same occupancy."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from mavfi.kernels.perception import octomap, octree
from mavfi.kernels.perception.key_sets import KeyFrame, collect
from mavfi.kernels.perception.octomap import UpdateRule

FIRST_CAPACITY = 1 << 14
"""Nodes that an octree begins with room for; where they do not suffice, the room is doubled."""


class OccupancyMap(Protocol):
    """A map that takes scans in, and can take them back."""

    @property
    def log_odds(self) -> np.ndarray:
        """Of every voxel of the grid, 0 = unknown. Shape (size,), float32."""

    def insert(self, points: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrate a scan.

        Args:
            points: World frame (m). Shape (n, 3), float32.
            origin: Sensor, world frame (m). Shape (3,).

        Returns:
            The voxels that were updated, free ones first (int32), and their log-odds now (float32).
        """

    def mark(self) -> None:
        """Remember the map as it is."""

    def rollback(self) -> None:
        """Put the map back to the last mark."""


class DenseMap:
    """Log-odds in an array."""

    def __init__(self, frame: KeyFrame, rule: UpdateRule, max_range: float) -> None:
        self._frame, self._rule, self._range = frame, rule, max_range
        size = frame.nx * frame.ny * frame.nz
        self.log_odds = np.zeros(size, np.float32)
        self._stamp = np.zeros(size, np.int32)
        self._touched = np.zeros(size + 1, np.int32)
        self._before = np.zeros(size, np.float32)
        self._count = 0
        self._stamps = 0

    def insert(self, points: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrate a scan, and keep what the voxels held."""
        self._stamps += 1
        self._count = octomap.insert_scan(
            points, origin, self._range, self._frame, self._rule, self.log_odds, self._stamp, self._stamps,
            self._touched, self._before,
        )  # fmt: skip
        voxels = self._touched[: self._count]
        return voxels, self.log_odds[voxels]

    def mark(self) -> None:
        """Forget how to take the last scan back."""
        self._count = 0

    def rollback(self) -> None:
        """Take the last scan back; its stamp is not used again, since stamps are not taken back."""
        octomap.undo_scan(self.log_odds, self._touched, self._before, self._count)
        self._count = 0


class OctreeMap:
    """Log-odds in an octree, which takes more memory when it needs it.

    Attributes:
        tree: Its nodes.
    """

    def __init__(self, frame: KeyFrame, rule: UpdateRule, max_range: float) -> None:
        self._frame, self._rule, self._range = frame, rule, max_range
        self._size = frame.nx * frame.ny * frame.nz
        self._largest = octree.largest_tree(frame)
        self.tree = octree.new_octree(min(FIRST_CAPACITY, self._largest))
        self._marked = octree.compact_copy(self.tree)
        self._stamp = np.zeros(self._size, np.int32)
        self._touched = np.zeros(self._size + 1, np.int32)
        self._stamps = 0

    @property
    def log_odds(self) -> np.ndarray:
        """Of every voxel of the grid, 0 = unknown; looked up in the tree. Shape (size,), float32."""
        dense = np.empty(self._size, np.float32)
        octree.to_dense(self.tree, self._frame, dense)
        return dense

    def insert(self, points: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrate a scan; voxels beyond the largest tree, which only corrupted nodes can fill, are left out."""
        self._stamps += 1
        n_free, count = collect(
            points, origin, self._range, self._frame, self._stamp, self._stamps, self._touched
        )  # fmt: skip
        voxels, after = self._touched[:count], np.empty(count, np.float32)
        done = 0
        while True:
            done = octree.update_voxels(self.tree, self._frame, self._rule, voxels, n_free, done, after)
            capacity = len(self.tree.log_odds)
            if done == count or capacity >= self._largest:
                return voxels[:done], after[:done]
            larger = octree.new_octree(min(2 * capacity, self._largest))
            octree.copy_into(self.tree, larger)
            self.tree = larger

    def mark(self) -> None:
        """Keep a copy: nodes are so many and so small that a journal of changes costs more."""
        self._marked = octree.compact_copy(self.tree)

    def rollback(self) -> None:
        """Put every node back, and the memory that was taken since is as new."""
        octree.copy_into(self._marked, self.tree)


MAPS: dict[str, Callable[[KeyFrame, UpdateRule, float], OccupancyMap]] = {"dense": DenseMap, "octree": OctreeMap}
"""By `MapConfig.kind`."""
