"""Arc tangent of a quotient, arc sine and arc cosine: breakpoints and polynomials of fdlibm."""

import math

from mavfi.numerics.elementary.angles import PI_OVER_2_HIGH, PI_OVER_2_LOW
from mavfi.numerics.elementary.parts import HIGH_WORD, bits_of, from_bits, product_of, two_to
from mavfi.numerics.jit import kernel_jit

_ARC = (
    3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01, -1.11111104054623557880e-01,
    9.09088713343650656196e-02, -7.69187620504482999495e-02, 6.66107313738753120669e-02, -5.83357013379057348645e-02,
    4.97687799461593236017e-02, -3.65315727442169155270e-02, 1.62858201153657823623e-02,
)  # fmt: skip
_ARC_AT = (
    (4.63647609000806093515e-01, 2.26987774529616870924e-17), (7.85398163397448278999e-01, 3.06161699786838301793e-17),
    (9.82793723247329054082e-01, 1.39033110312309984516e-17), (1.57079632679489655800e00, 6.12323399573676603587e-17),
)  # fmt: skip
"""Arc tangents of 0.5, 1, 1.5 and infinity, as double-doubles."""
_ARC_SINE = (
    1.66666666666666657415e-01, -3.25565818622400915405e-01, 2.01212532134862925881e-01, -4.00555345006794114027e-02,
    7.91534994289814532176e-04, 3.47933107596021167570e-05,
)  # fmt: skip
_ARC_SINE_BELOW = (
    -2.40339491173441421878e00, 2.02094576023350569471e00, -6.88283971605453293030e-01, 7.70381505559019352791e-02,
)  # fmt: skip


@kernel_jit
def _arc_tangent(x: float, low: float) -> tuple[float, float]:
    """Arc tangent of x + low, x >= 0, as a double-double."""
    if x < 0.4375:
        high, rest = 0.0, 0.0
    elif x < 0.6875:
        high, rest = _ARC_AT[0]
        low *= 5.0 / ((2.0 + x) * (2.0 + x))
        x = (2.0 * x - 1.0) / (2.0 + x)
    elif x < 1.1875:
        high, rest = _ARC_AT[1]
        low *= 2.0 / ((1.0 + x) * (1.0 + x))
        x = (x - 1.0) / (x + 1.0)
    elif x < 2.4375:
        high, rest = _ARC_AT[2]
        low *= 3.25 / ((1.0 + 1.5 * x) * (1.0 + 1.5 * x))
        x = (x - 1.5) / (1.0 + 1.5 * x)
    else:
        high, rest = _ARC_AT[3]
        low = low / x / x
        x = -1.0 / x
    z = x * x
    w = z * z
    even = z * (_ARC[0] + w * (_ARC[2] + w * (_ARC[4] + w * (_ARC[6] + w * (_ARC[8] + w * _ARC[10])))))
    odd = w * (_ARC[1] + w * (_ARC[3] + w * (_ARC[5] + w * (_ARC[7] + w * _ARC[9]))))
    small = (rest - x * (even + odd)) + low / (1.0 + z)
    total = high + x
    return total, ((high - total) + x) + small


@kernel_jit
def atan2(y: float, x: float) -> float:
    """Angle of the vector (x, y) (rad) in [-pi, pi], with the signs of zeros and infinities as in C."""
    if math.isnan(x) or math.isnan(y):
        return math.nan
    across, along = abs(y), abs(x)
    if across == along:  # includes both zero or both infinite
        angle, low = (0.0, 0.0) if along == 0.0 else _ARC_AT[1]
    elif across == 0.0 or along == math.inf:
        angle, low = 0.0, 0.0
    elif along == 0.0 or across == math.inf:
        angle, low = _ARC_AT[3]
    else:
        angle, low = _arc_tangent_of_quotient(across, along)
    if math.copysign(1.0, x) < 0.0:
        turned = 2.0 * PI_OVER_2_HIGH - angle
        angle, low = turned, ((2.0 * PI_OVER_2_HIGH - turned) - angle) + (2.0 * PI_OVER_2_LOW - low)
    return math.copysign(angle + low, y)


@kernel_jit
def _arc_tangent_of_quotient(y: float, x: float) -> tuple[float, float]:
    """Arc tangent of y / x, both positive and finite, as a double-double."""
    quotient = y / x
    if quotient > 1e17:
        return _ARC_AT[3]
    if quotient < 1e-17:
        return quotient, 0.0
    if x > 1e150 or x < 1e-150:  # scale by powers of two, which preserves the quotient
        scale = two_to(-600) if x > 1.0 else two_to(600)
        y, x = y * scale, x * scale
    product, error = product_of(quotient, x)
    return _arc_tangent(quotient, ((y - product) - error) / x)


@kernel_jit
def asin(value: float) -> float:
    """Arc sine (rad); NaN beyond ±1."""
    size = abs(value)
    if not size <= 1.0:
        return math.nan
    if size == 1.0:
        return math.copysign(PI_OVER_2_HIGH, value)
    if size < 0.5:
        if size < 1e-8:
            return value
        return value + value * _arc_sine_ratio(value * value)
    z = 0.5 * (1.0 - size)
    root = math.sqrt(z)
    ratio = _arc_sine_ratio(z)
    if size >= 0.975:
        angle = PI_OVER_2_HIGH - (2.0 * (root + root * ratio) - PI_OVER_2_LOW)
    else:
        high = from_bits(bits_of(root) & HIGH_WORD)
        low = (z - high * high) / (root + high)
        small = 2.0 * root * ratio - (PI_OVER_2_LOW - 2.0 * low)
        angle = 0.5 * PI_OVER_2_HIGH - (small - (0.5 * PI_OVER_2_HIGH - 2.0 * high))
    return math.copysign(angle, value)


@kernel_jit
def acos(value: float) -> float:
    """Arc cosine (rad), in [0, pi]; NaN beyond ±1."""
    size = abs(value)
    if not size <= 1.0:
        return math.nan
    if size == 1.0:
        return 0.0 if value > 0.0 else 2.0 * PI_OVER_2_HIGH
    if size < 0.5:
        if size < 1e-17:
            return PI_OVER_2_HIGH
        return PI_OVER_2_HIGH - (value - (PI_OVER_2_LOW - value * _arc_sine_ratio(value * value)))
    z = 0.5 * (1.0 - size)
    root = math.sqrt(z)
    ratio = _arc_sine_ratio(z)
    if value < 0.0:
        return 2.0 * (PI_OVER_2_HIGH - (root + (ratio * root - PI_OVER_2_LOW)))
    high = from_bits(bits_of(root) & HIGH_WORD)
    low = (z - high * high) / (root + high)
    return 2.0 * (high + (ratio * root + low))


@kernel_jit
def _arc_sine_ratio(z: float) -> float:
    """(asin(x) - x) / x for z = x * x <= 1 / 4."""
    p, q = _ARC_SINE, _ARC_SINE_BELOW
    above = z * (p[0] + z * (p[1] + z * (p[2] + z * (p[3] + z * (p[4] + z * p[5])))))
    return above / (1.0 + z * (q[0] + z * (q[1] + z * (q[2] + z * q[3]))))
