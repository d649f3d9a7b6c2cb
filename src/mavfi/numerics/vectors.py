"""Lengths and products without BLAS, whose rounding depends on the CPU: flights must be the same on every machine."""

import math

import numpy as np

from mavfi.numerics.jit import kernel_jit


@kernel_jit
def length(vector: np.ndarray) -> float:
    """Euclidean length of a vector of any size, summed in element order; NaN if any element is NaN."""
    total = 0.0
    for value in vector:
        total += value * value
    return math.sqrt(total)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Matrix product, each sum in the order of its terms.

    Args:
        a: Shape (n, k).
        b: Shape (k, m).

    Returns:
        Shape (n, m).
    """
    total = np.zeros((a.shape[0], b.shape[1]))
    for k in range(a.shape[1]):
        total += a[:, k, None] * b[None, k, :]
    return total
