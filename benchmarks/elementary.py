"""Speed of `numerics.elementary` against libm, called from compiled code."""

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.rows import Row
from mavfi.numerics import elementary
from mavfi.numerics.jit import kernel_jit

NUMBERS = 200_000
REPEATS = 7
RANGES = {
    "sin": (-4.0, 4.0),
    "cos": (-4.0, 4.0),
    "tan": (-1.5, 1.5),
    "asin": (-1.0, 1.0),
    "acos": (-1.0, 1.0),
    "exp": (-5.0, 0.0),
    "tanh": (-3.0, 3.0),
    "log": (0.01, 100.0),
    "cbrt": (0.001, 1.0),
    "atan2": (-5.0, 5.0),
}


def _looped(function: Any) -> Callable[[np.ndarray, np.ndarray, np.ndarray], None]:
    def loop(first: np.ndarray, second: np.ndarray, results: np.ndarray) -> None:
        for i in range(first.size):
            results[i] = function(first[i])

    def loop_of_two(first: np.ndarray, second: np.ndarray, results: np.ndarray) -> None:
        for i in range(first.size):
            results[i] = function(first[i], second[i])

    return kernel_jit(loop_of_two if function in (math.atan2, elementary.atan2) else loop)


def _third_power(number: float) -> float:
    power: float = number ** (1.0 / 3.0)
    return power


def _seconds(function: Any, low: float, high: float) -> float:
    """Minimum time of one call (s)."""
    random = np.random.default_rng(0)
    first, second = random.uniform(low, high, (2, NUMBERS))
    results = np.empty(NUMBERS)
    loop = _looped(function)
    walls = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        loop(first, second, results)
        walls.append(time.perf_counter() - start)
    return min(walls) / NUMBERS


def elementary_rows() -> list[Row]:
    """One row per function."""
    rows = []
    for name, bounds in RANGES.items():
        theirs = kernel_jit(_third_power) if name == "cbrt" else getattr(math, name)
        own, other = _seconds(getattr(elementary, name), *bounds), _seconds(theirs, *bounds)
        value = f"{1e9 * own:.1f} ns; libm {1e9 * other:.1f} ns, x {own / other:.2f}"
        rows.append(Row(f"{name}, {bounds[0]:g} to {bounds[1]:g}", value))
    return rows
