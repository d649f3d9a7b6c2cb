"""Small kernels with loops, branches, indices and stores."""

import math

import numpy as np

from mavfi.numerics.jit import kernel_jit


@kernel_jit
def mean_square(values):
    total = 0.0
    for value in values:
        total += value * value
    return total / len(values)


@kernel_jit
def walk(grid, steps, out):
    at, hits = 3, 0
    for k in range(steps.shape[0]):
        at += steps[k]
        if at < 0 or at >= grid.shape[0]:
            at = 0
        if grid[at] > 0:
            out[hits] = at
            hits += 1
    return hits


@kernel_jit
def blend(values, weights, out):
    """Several functions, mathematics, and an exception."""
    if weights.shape[0] != values.shape[0]:
        raise ValueError("lengths")
    for i in range(values.shape[0]):
        out[i] = math.sin(values[i]) * weights[i] + mean_square(values[: i + 1])
    return out.sum()


MEAN_SQUARE = (np.linspace(0.0, 1.0, 7),)
WALK = (np.array([0, 1, 0, 1, 1, 0, 0, 1], np.int32), np.array([1, 2, -4, 5, 1]), np.zeros(8, np.int64))
BLEND = (np.linspace(-1.0, 2.0, 5), np.linspace(1.0, 0.5, 5), np.zeros(5))
CASES = {"mean_square": (mean_square, MEAN_SQUARE), "walk": (walk, WALK), "blend": (blend, BLEND)}
