"""The fields of a float64 (IEEE 754 binary64), and the 16-bit code of its sign and exponent."""

import numpy as np

from mavfi.numerics.jit import kernel_jit

MANTISSA_BITS = 52
EXPONENT_MASK = 0x7FF
EXPONENT_BIAS = 1023
INT16_MAX = 32767


@kernel_jit
def sign_field(value: float) -> int:
    """Sign bit (bit 63): 0 or 1; also set for -0.0."""
    return 1 if np.float64(value).view(np.int64) < 0 else 0


@kernel_jit
def exponent_field(value: float) -> int:
    """Biased exponent (bits 52 to 62): 0 for zeros and denormals, 2047 for infinities and NaN."""
    return int((np.float64(value).view(np.int64) >> MANTISSA_BITS) & EXPONENT_MASK)


@kernel_jit
def sign_exponent_code(value: float, threshold: int) -> int:
    """Sign and exponent of a number as a 16-bit integer (MAVFI section IV-B).

    The paper does not specify a packing.  This one is monotone in the value and continuous at zero:
    sign * max(0, E - (1023 + threshold) + 1).  Everything below 2**threshold (including ±0 and denormals) is 0, and
    each octave above adds one.  Infinities and NaN get the code one beyond the largest finite number's, with their
    sign; callers must treat them as an alarm separately.

    Args:
        value: Any float64.
        threshold: Power of two below which a number counts as zero, >= -1000.

    Returns:
        Code in ±(1025 - threshold).
    """
    octaves = exponent_field(value) - (EXPONENT_BIAS + threshold) + 1
    if not (octaves > 0):
        return 0
    return -octaves if sign_field(value) == 1 else octaves


@kernel_jit
def saturated_int16(value: int) -> int:
    """The nearest integer in ±32767."""
    if value > INT16_MAX:
        return INT16_MAX
    if value < -INT16_MAX:
        return -INT16_MAX
    return value
