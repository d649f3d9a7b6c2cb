"""A map of one's own: it forgets what it has not seen for a while, as one needs where obstacles come and go.

    mavfi fly --environment sparse --seed 7 --map examples.map_forgetting:ForgettingMap

run from the folder that holds `examples`, or `map_forgetting:ForgettingMap` from within it.  An installed package can
give it a name instead: an entry point of the group `mavfi.maps`.
"""

import numpy as np

from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.kernels.perception.octomap import UpdateRule
from mavfi.pipeline.maps import DenseMap


class ForgettingMap:
    """A dense array of log-odds in which a voxel becomes unknown again after 100 scans without news (30 s and more)."""

    memory = 100

    def __init__(self, frame: KeyFrame, rule: UpdateRule, max_range: float) -> None:
        self._map = DenseMap(frame, rule, max_range)
        self._seen = np.zeros(frame.nx * frame.ny * frame.nz, np.int32)
        self._scan = 0
        self._undo: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    @property
    def log_odds(self) -> np.ndarray:
        """Of every voxel of the grid, 0 = unknown, above = occupied, below = free."""
        return self._map.log_odds

    def insert(self, points: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Called with every scan; answers the voxels that changed (int32) and their log-odds now (float32)."""
        voxels, after = self._map.insert(points, origin)
        self._scan += 1
        stale = (self._seen > 0) & (self._seen <= self._scan - self.memory)
        stale[voxels] = False
        old = np.flatnonzero(stale).astype(np.int32)
        self._undo = [(index, self.log_odds[index], self._seen[index]) for index in (voxels.copy(), old)]
        self._seen[voxels] = self._scan
        self.log_odds[old], self._seen[old] = 0.0, 0
        return np.concatenate([voxels, old]), np.concatenate([after, self.log_odds[old]])

    def mark(self) -> None:
        """Called before a scan: a recomputation may want to come back to here."""
        self._map.mark()
        self._undo = []

    def rollback(self) -> None:
        """Called when the scan since then is to be taken back."""
        for index, log_odds, seen in self._undo:
            self.log_odds[index], self._seen[index] = log_odds, seen
        self._map.rollback()  # has the last word on the voxels of the scan
        self._scan -= min(1, len(self._undo))
        self._undo = []
