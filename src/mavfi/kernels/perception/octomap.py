"""OctoMap's update rule on a dense array (Hornung et al. 2013; the paper's kernel "OctoMap").

A voxel that a scan frees or hits gets the log-odds of that added, once; log-odds are float32 and clamped.  Free updates
come first.  Which voxels these are is found in `key_sets`; the map equals the library's bit for bit.
"""

from typing import NamedTuple

import numpy as np

from mavfi.kernels.perception.key_sets import KeyFrame, collect
from mavfi.numerics.elementary import log
from mavfi.numerics.jit import kernel_jit

_F32 = np.float32


class UpdateRule(NamedTuple):
    """Log-odds increments and clamps, float32 values."""

    hit: np.float32
    miss: np.float32
    clamp_min: np.float32
    clamp_max: np.float32


def log_odds(probability: float) -> np.float32:
    """Log-odds of a probability, as OctoMap stores it."""
    return np.float32(log(probability / (1.0 - probability)))


@kernel_jit
def insert_scan(
    points: np.ndarray, origin: np.ndarray, max_range: float, frame: KeyFrame, rule: UpdateRule, log_odds: np.ndarray,
    stamp: np.ndarray, scan: int, touched: np.ndarray, before: np.ndarray,
) -> int:  # fmt: skip
    """Integrate one scan.

    Args:
        points: As in `key_sets.collect`. Shape (n, 3), float32.
        origin: As in `key_sets.collect`. Shape (3,).
        max_range: m.
        frame: Grid.
        rule: Increments and clamps.
        log_odds: The map; changed. Shape (nx * ny * nz,), float32.
        stamp: Last scan that touched a voxel; changed. Same shape, int32.
        scan: Number of this scan, larger than any before.
        touched: Result: voxels that were updated, free ones first. Longer than the map, int32.
        before: Result: their log-odds before, for an undo. At least as long as the map, float32.

    Returns:
        How many voxels were updated.
    """
    n_free, count = collect(points, origin, max_range, frame, stamp, scan, touched)
    for i in range(n_free):
        voxel = touched[i]
        before[i] = log_odds[voxel]
        log_odds[voxel] = max(_F32(log_odds[voxel] + rule.miss), rule.clamp_min)
    for i in range(n_free, count):
        voxel = touched[i]
        before[i] = log_odds[voxel]
        log_odds[voxel] = min(_F32(log_odds[voxel] + rule.hit), rule.clamp_max)
    return count


@kernel_jit
def undo_scan(log_odds: np.ndarray, touched: np.ndarray, before: np.ndarray, count: int) -> None:
    """Undo the last scan. Arguments as in `insert_scan`; `count` is its result."""
    for i in range(count):
        log_odds[touched[i]] = before[i]
