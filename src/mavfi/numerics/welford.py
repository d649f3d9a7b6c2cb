"""Running mean and standard deviation: MAVFI section IV-C, equations 1 and 2.

Source: Welford 1962, after Knuth, The Art of Computer Programming, vol. 2, section 4.2.2.
"""

import math

import numpy as np

from mavfi.numerics.jit import kernel_jit


@kernel_jit
def update(count: float, mean: float, squares: float, value: float) -> tuple[float, float, float]:
    """One step of the recurrences M_k = M_(k-1) + (x_k - M_(k-1)) / k and S_k = S_(k-1) + (x_k - M_(k-1)) (x_k - M_k).

    Args:
        count: Samples so far, k - 1; 0 gives the paper's start M_1 = x_1, S_1 = 0.
        mean: M_(k-1).
        squares: S_(k-1).
        value: x_k, finite.

    Returns:
        k, M_k, S_k.
    """
    count += 1.0
    difference = value - mean
    mean += difference / count
    squares += difference * (value - mean)
    return count, mean, squares


@kernel_jit
def deviation(count: float, squares: float) -> float:
    """Standard deviation sqrt(S_k / (k - 1)); 0 for fewer than two samples."""
    if not (count >= 2.0):
        return 0.0
    return math.sqrt(squares / (count - 1.0))


@kernel_jit
def accumulate(values: np.ndarray) -> tuple[float, float, float]:
    """The recurrences over a whole sample.

    Args:
        values: Finite numbers. Shape (n,).

    Returns:
        k, M_k, S_k.
    """
    count, mean, squares = 0.0, 0.0, 0.0
    for value in values:
        count, mean, squares = update(count, mean, squares, float(value))
    return count, mean, squares
