"""Building blocks: bits of numbers, and error-free sums and products (Knuth; Dekker)."""

import numpy as np

from mavfi.numerics.jit import kernel_jit

_SPLIT = 134217729.0
MANTISSA = (1 << 52) - 1
HIGH_WORD = ~0xFFFFFFFF


@kernel_jit
def bits_of(value: float) -> int:
    """The 64 bits of a number, as an integer."""
    return int(np.float64(value).view(np.int64))


@kernel_jit
def from_bits(bits: int) -> float:
    """The number with these bits."""
    return float(np.int64(bits).view(np.float64))


@kernel_jit
def sum_of(a: float, b: float) -> tuple[float, float]:
    """Rounded sum, and its rounding error."""
    total = a + b
    other = total - a
    return total, (a - (total - other)) + (b - other)


@kernel_jit
def product_of(a: float, b: float) -> tuple[float, float]:
    """Rounded product, and its rounding error; without overflow and underflow."""
    total = a * b
    high_a = _SPLIT * a
    high_a = high_a - (high_a - a)
    high_b = _SPLIT * b
    high_b = high_b - (high_b - b)
    low_a, low_b = a - high_a, b - high_b
    return total, ((high_a * high_b - total) + high_a * low_b + low_a * high_b) + low_a * low_b


@kernel_jit
def two_to(power: int) -> float:
    """2^power, for -1022 <= power <= 1023."""
    return from_bits((power + 1023) << 52)
