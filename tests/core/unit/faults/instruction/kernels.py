"""Small kernels whose every fault can be predicted."""

import math

import numpy as np

from mavfi.numerics.jit import kernel_jit


@kernel_jit
def straight(a, b, c, i, j):
    product = a * b
    total = product + c
    k = i + j
    scaled = k * 3
    return math.sqrt(total) / scaled


STRAIGHT = (1.7, -2.3, 40.25, 7, 12)


@kernel_jit
def loop(x, n):
    s = 0.5
    k = 3
    for i in range(n):
        s = s * x + i
        if s > 40.0:
            s -= 35.0
            k = k * 5 + i
        else:
            k ^= i
    return s + k


LOOP = (1.5, 23)


@kernel_jit
def fill(values, scale):
    total = 0
    for i in range(1, len(values)):
        values[i] = values[i] * scale + values[i - 1]
        if values[i] > 3.0:
            total += i
    return total


@kernel_jit
def double(values):
    for i in range(len(values)):
        values[i] = values[i] * 2.0


@kernel_jit
def counted_down(x):
    steps = 0
    while x > 0.0:
        x = x - 1.0
        steps += 1
    return steps


@kernel_jit
def raising(values, i):
    if i < 0:
        raise ValueError("negative")
    return values[i % len(values)] * 2.0


def closure(factor):
    """A kernel that encloses a value."""

    @kernel_jit
    def scaled(x):
        return x * factor

    return scaled


@kernel_jit
def solved(matrix, right):
    """Calls LAPACK."""
    return np.linalg.solve(matrix, right)
