"""OctoMap's update rule on a dense array (Hornung et al. 2013; the paper's kernel "OctoMap").

A voxel that a scan frees or hits is updated once, by the corresponding log-odds; log-odds are float32 and clamped.
Free updates come first.  `key_sets` finds these voxels; the map equals the library's bit for bit.
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
    """Log-odds of a probability, as stored by OctoMap."""
    return np.float32(log(probability / (1.0 - probability)))


@kernel_jit
def insert_scan(
    points: np.ndarray,
    origin: np.ndarray,
    max_range: float,
    frame: KeyFrame,
    rule: UpdateRule,
    log_odds: np.ndarray,
    stamp: np.ndarray,
    scan: int,
    touched: np.ndarray,
    before: np.ndarray,
) -> int:
    """Integrate one scan.

    Args:
        points: As for `key_sets.collect`. Shape (n, 3), float32.
        origin: As for `key_sets.collect`. Shape (3,).
        max_range: Range of the sensor (m).
        frame: Grid.
        rule: Increments and clamps.
        log_odds: The map; changed. Shape (nx * ny * nz,), float32.
        stamp: Last scan that updated a voxel; changed. Same shape, int32.
        scan: Number of this scan, larger than all previous ones.
        touched: Output: updated voxels, free ones first. Longer than the map, int32.
        before: Output: their previous log-odds, for an undo. At least as long as the map, float32.

    Returns:
        Number of updated voxels.
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
    """Undo the last scan. Arguments as for `insert_scan`; `count` is its return value."""
    for i in range(count):
        log_odds[touched[i]] = before[i]
