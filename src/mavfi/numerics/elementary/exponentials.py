"""Exponential function, hyperbolic tangent, logarithm and cube root; polynomials of the last two from fdlibm."""

import math

from mavfi.numerics.elementary.parts import MANTISSA, bits_of, from_bits, product_of, sum_of, two_to
from mavfi.numerics.jit import kernel_jit

_LOGARITHM = (
    6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01,
    1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01,
)  # fmt: skip
_LN_2_HIGH, _LN_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_ONE_OVER_LN_2 = 1.4426950408889634
_LARGEST_EXPONENT, _SMALLEST_EXPONENT = 709.782712893384, -745.1332191019411
_INVERSE_FACTORIALS = tuple(1.0 / math.factorial(n) for n in range(3, 14))


@kernel_jit
def _exponential_less_one(x: float) -> tuple[int, float, float]:
    """Integer k and double-double E, |E| < 0.42, with exp(x) = 2^k (1 + E); |x| < 1000."""
    power = math.floor(x * _ONE_OVER_LN_2 + 0.5)
    high, low = sum_of(x - power * _LN_2_HIGH, -power * _LN_2_LOW)
    square, square_error = product_of(high, high)
    c = _INVERSE_FACTORIALS
    z = square * square
    tail = ((c[0] + high * c[1]) + square * (c[2] + high * c[3])) + z * (
        ((c[4] + high * c[5]) + square * (c[6] + high * c[7])) + z * ((c[8] + high * c[9]) + square * c[10])
    )
    total, error = sum_of(high, 0.5 * square)
    error += (low + high * low) + (0.5 * square_error + high * square * tail)
    return int(power), total, error


@kernel_jit
def exp(value: float) -> float:
    """Exponential function; infinity and zero beyond the range of float64."""
    if math.isnan(value):
        return math.nan
    if value > _LARGEST_EXPONENT:
        return math.inf
    if value < _SMALLEST_EXPONENT:
        return 0.0
    power, high, low = _exponential_less_one(value)
    total, error = sum_of(1.0, high)
    result = total + (error + low)
    half = power // 2
    return result * two_to(half) * two_to(power - half)


@kernel_jit
def tanh(value: float) -> float:
    """Hyperbolic tangent."""
    size = abs(value)
    if not size < 20.0:
        return math.nan if math.isnan(value) else math.copysign(1.0, value)
    if size < 1e-8:
        return value
    # -E / (E + 2) with E = exp(-2 |x|) - 1
    power, high, low = _exponential_less_one(-2.0 * size)
    scale = two_to(power)
    total, error = sum_of(-1.0, scale)
    total, error_2 = sum_of(total, scale * high)
    error += error_2 + scale * low
    above = total + error
    above_low = (total - above) + error
    below, below_low = sum_of(2.0, above)
    below_low += above_low
    quotient = above / below
    product, product_error = product_of(quotient, below)
    left = ((above - product) - product_error) + (above_low - quotient * below_low)
    return math.copysign(quotient + left / below, value)


@kernel_jit
def quick_tanh(value: float) -> float:
    """Hyperbolic tangent, within 4 ulp, in a third of the time of `tanh`; as bit-identical on every processor."""
    size = abs(value)
    if not size < 20.0:
        return math.nan if math.isnan(value) else math.copysign(1.0, value)
    # -E / (E + 2) with E = exp(-2 |x|) - 1 = 2^k (1 + e) - 1
    double = -2.0 * size
    power = int(double * _ONE_OVER_LN_2 - 0.5)
    x = (double - power * _LN_2_HIGH) - power * _LN_2_LOW
    square, c = x * x, _INVERSE_FACTORIALS
    z = square * square
    tail = ((c[0] + x * c[1]) + square * (c[2] + x * c[3])) + z * (
        ((c[4] + x * c[5]) + square * (c[6] + x * c[7])) + z * ((c[8] + x * c[9]) + square * c[10])
    )
    scale = two_to(power)
    less_one = scale * (x + (0.5 * square + x * square * tail)) + (scale - 1.0)
    return math.copysign(less_one / (less_one + 2.0), value)


@kernel_jit
def log(value: float) -> float:
    """Natural logarithm; minus infinity for zero, NaN below."""
    if not value > 0.0:
        return -math.inf if value == 0.0 else math.nan
    if value == math.inf:
        return value
    exponent = 0
    if value < 2.2250738585072014e-308:
        value *= 18014398509481984.0
        exponent = -54
    bits = bits_of(value)
    exponent += ((bits >> 52) & 0x7FF) - 1023
    bits = (bits & MANTISSA) | (1023 << 52)
    if bits > 0x3FF6A09E667F3BCD:  # beyond sqrt(2)
        bits -= 1 << 52
        exponent += 1
    f = from_bits(bits) - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    c = _LOGARITHM
    tail = w * (c[1] + w * (c[3] + w * c[5])) + z * (c[0] + w * (c[2] + w * (c[4] + w * c[6])))
    half = 0.5 * f * f
    k = float(exponent)
    return k * _LN_2_HIGH - ((half - (s * (half + tail) + k * _LN_2_LOW)) - f)


@kernel_jit
def cbrt(value: float) -> float:
    """Cube root; NaN, infinities and numbers below 1e-300 are returned unchanged."""
    size = abs(value)
    if not 1e-300 < size < math.inf:
        return value
    t = from_bits(bits_of(size) // 3 + (715094163 << 32))
    r = (t * t) * (t / size)
    t = t * (
        (1.87595182427177009643 + r * (-1.88497979543377169875 + r * 1.621429720105354466140))
        + ((r * r) * r) * (-0.758397934778766047437 + r * 0.145996192886612446982)
    )
    t = from_bits((bits_of(t) + 0x80000000) & ~0x3FFFFFFF)  # 23 bits: its square is exact
    r = size / (t * t)
    return math.copysign(t + t * ((r - t) / (t + t + r)), value)
