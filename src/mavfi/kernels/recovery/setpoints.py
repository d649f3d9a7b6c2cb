"""Commands of the degraded modes."""

import math

from mavfi.numerics.jit import kernel_jit

GAIN = 1.0
"""Commanded speed / distance to the target (1/s)."""


@kernel_jit
def distance(x: float, y: float, z: float, to_x: float, to_y: float, to_z: float) -> float:
    """Distance between two positions (m)."""
    return math.sqrt((to_x - x) ** 2 + (to_y - y) ** 2 + (to_z - z) ** 2)


@kernel_jit
def closing_rate(away: float, largest: float) -> float:
    """Commanded speed / distance to the target (1/s): `GAIN`, less where the speed would exceed its limit.

    Args:
        away: Distance to the target (m).
        largest: Limit on the speed (m/s).
    """
    return min(GAIN * away, largest) / away if away > 0.0 else 0.0
