"""Sine, cosine and tangent: polynomials of fdlibm; argument reduction by Cody and Waite, and Payne and Hanek (1983)."""

import math

import numpy as np

from mavfi.numerics.elementary.parts import HIGH_WORD, MANTISSA, bits_of, from_bits, product_of, sum_of, two_to
from mavfi.numerics.jit import kernel_jit

_TWO_OVER_PI = 0.6366197723675814
PI_OVER_2_HIGH, PI_OVER_2_LOW = 1.5707963267948966, 6.123233995736766e-17
"""pi / 2 as a double-double."""
_PIECES = (
    1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624871116645580e-21, 8.47842766036889956997e-32,
)  # fmt: skip
"""pi / 2 in parts of 33 bits: products with integers below 2^20 are exact, except for the last part."""
_LARGE = 1.0e6
"""Limit of the reduction by these pieces (rad)."""

_WIDTH = 28
TWO_OVER_PI_DIGITS = np.array([
    0, 0, 170891318, 240010261, 44024437, 131200308, 232525238, 43358524, 70845471, 240214955, 233552982, 28779630,
    61088989, 48236105, 49193117, 26352894, 31371723, 19507006, 243802975, 86948676, 139368903, 2536543, 132387737,
    30816643, 87269193, 210001803, 199201411, 186644631, 268296281, 135261999, 18396576, 174923629, 57142514, 130746807,
    83125238, 111042538, 47665787, 180874213, 253211600, 121239434, 86584998, 201023409, 33084880, 139854640, 74434486,
    195817679, 197265839, 70655401,
])  # fmt: skip
"""Digits of 2 / pi in base 2^28, after two zeros."""
_PLACES = 7
_SINE = (
    -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04, 2.75573137070700676789e-06,
    -2.50507602534068634195e-08, 1.58969099521155010221e-10,
)  # fmt: skip
_COSINE = (
    4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05, -2.75573143513906633035e-07,
    2.08757232129817482790e-09, -1.13596475577881948265e-11,
)  # fmt: skip
_TANGENT = (
    3.33333333333334091986e-01, 1.33333333333201242699e-01, 5.39682539762260521377e-02, 2.18694882948595424599e-02,
    8.86323982359930005737e-03, 3.59207910759131235356e-03, 1.45620945432529025516e-03, 5.88041240820264096874e-04,
    2.46463134818469906812e-04, 7.81794442939557092300e-05, 7.14072491382608190305e-05, -1.85586374855275456654e-05,
    2.59073051863633712884e-05,
)  # fmt: skip


@kernel_jit
def _quarter_turns(angle: float) -> tuple[int, float, float]:
    """Argument reduction: quadrant (0 to 3) and remainder, as a double-double, of a finite angle."""
    if not abs(angle) < _LARGE:
        return _quarter_turns_of_large(angle)
    turns = math.floor(angle * _TWO_OVER_PI + 0.5)
    rest, error = sum_of(angle - turns * _PIECES[0], -turns * _PIECES[1])
    rest, error_2 = sum_of(rest, -turns * _PIECES[2])
    low = (error + error_2) - turns * _PIECES[3]
    high = rest + low
    return int(turns) & 3, high, (rest - high) + low


@kernel_jit
def _quarter_turns_of_large(angle: float) -> tuple[int, float, float]:
    """Argument reduction for |angle| >= 1 (Payne and Hanek): computes only the digits of angle * 2 / pi below 4."""
    bits = bits_of(angle)
    exponent = ((bits >> 52) & 0x7FF) - 1075 - 2
    first = exponent // _WIDTH
    shift = exponent - first * _WIDTH
    mantissa = (bits & MANTISSA) | (1 << 52)
    # mantissa * 2^shift, up to 81 bits
    low = (mantissa & ((1 << _WIDTH) - 1)) << shift
    high = ((mantissa >> _WIDTH) << shift) + (low >> _WIDTH)
    factors = (low & ((1 << _WIDTH) - 1), high & ((1 << _WIDTH) - 1), high >> _WIDTH)
    digits = np.zeros(_PLACES, np.int64)
    carry = 0
    for place in range(_PLACES - 1, -1, -1):
        at = first + 2 + place
        total = carry
        for i in range(3):
            total += factors[i] * TWO_OVER_PI_DIGITS[at + i]
        digits[place] = total & ((1 << _WIDTH) - 1)
        carry = total >> _WIDTH
    quarter = digits[0] >> (_WIDTH - 2)
    top = digits[0] & ((1 << (_WIDTH - 2)) - 1)
    if top >> (_WIDTH - 3):
        top -= 1 << (_WIDTH - 2)
        quarter += 1
    scale = two_to(2 - 2 * _WIDTH)
    rest, error = sum_of(float((top << _WIDTH) + digits[1]) * scale, float(digits[2]) * two_to(2 - 3 * _WIDTH))
    for place in range(3, _PLACES):
        error += float(digits[place]) * two_to(2 - (place + 1) * _WIDTH)
    high_rest = rest + error
    low_rest = (rest - high_rest) + error
    product, product_error = product_of(high_rest, PI_OVER_2_HIGH)
    product_error += high_rest * PI_OVER_2_LOW + low_rest * PI_OVER_2_HIGH
    result = product + product_error
    rest_of_result = (product - result) + product_error
    if angle < 0.0:
        return int(-quarter) & 3, -result, -rest_of_result
    return int(quarter) & 3, result, rest_of_result


@kernel_jit
def _sine(x: float, low: float) -> float:
    """Sine of x + low, |x| <= pi / 4."""
    z = x * x
    w = z * z
    tail = (_SINE[1] + z * _SINE[2]) + w * ((_SINE[3] + z * _SINE[4]) + w * _SINE[5])
    cube = z * x
    return x - ((z * (0.5 * low - cube * tail) - low) - cube * _SINE[0])


@kernel_jit
def _cosine(x: float, low: float) -> float:
    """Cosine of x + low, |x| <= pi / 4."""
    z = x * x
    w = z * z
    tail = z * (_COSINE[0] + z * (_COSINE[1] + z * _COSINE[2])) + w * w * (
        _COSINE[3] + z * (_COSINE[4] + z * _COSINE[5])
    )
    half = 0.5 * z
    top = 1.0 - half
    return top + (((1.0 - top) - half) + (z * tail - x * low))


@kernel_jit
def _sine_ahead(angle: float, quarters: int) -> float:
    """Sine of an angle + quarters * pi / 2; NaN for infinities and NaN."""
    if not abs(angle) < math.inf:
        return math.nan
    quarter, x, low = _quarter_turns(angle)
    quarter += quarters
    value = _cosine(x, low) if quarter & 1 else _sine(x, low)
    return -value if quarter & 2 else value


@kernel_jit
def sin(angle: float) -> float:
    """Sine of an angle (rad); NaN for infinities and NaN."""
    return angle if abs(angle) < 1e-8 else _sine_ahead(angle, 0)


@kernel_jit
def cos(angle: float) -> float:
    """Cosine of an angle (rad); NaN for infinities and NaN."""
    return _sine_ahead(angle, 1)


@kernel_jit
def tan(angle: float) -> float:
    """Tangent of an angle (rad); NaN for infinities and NaN."""
    if not abs(angle) < math.inf:
        return math.nan
    if abs(angle) < 1e-8:
        return angle
    quarter, x, low = _quarter_turns(angle)
    return _tangent(x, low, quarter & 1)


@kernel_jit
def _tangent(x: float, low: float, inverted: int) -> float:
    """Tangent of x + low, |x| <= pi / 4, or minus its inverse."""
    near_end = abs(x) >= 0.67434
    negative = x < 0.0
    if near_end:
        if negative:
            x, low = -x, -low
        x = (0.5 * PI_OVER_2_HIGH - x) + (0.5 * PI_OVER_2_LOW - low)
        low = 0.0
    z = x * x
    w = z * z
    odd = _TANGENT[1] + w * (_TANGENT[3] + w * (_TANGENT[5] + w * (_TANGENT[7] + w * (_TANGENT[9] + w * _TANGENT[11]))))
    even = z * (
        _TANGENT[2] + w * (_TANGENT[4] + w * (_TANGENT[6] + w * (_TANGENT[8] + w * (_TANGENT[10] + w * _TANGENT[12]))))
    )
    cube = z * x
    rest = low + z * (cube * (odd + even) + low)
    rest += _TANGENT[0] * cube
    total = x + rest
    if near_end:
        side = -1.0 if inverted else 1.0
        value = side - 2.0 * (x - (total * total / (total + side) - rest))
        return -value if negative else value
    if not inverted:
        return total
    # -1 / (x + rest) with the rounding errors of sum and quotient
    high = from_bits(bits_of(total) & HIGH_WORD)
    left = rest - (high - x)
    inverse = -1.0 / total
    top = from_bits(bits_of(inverse) & HIGH_WORD)
    return top + inverse * ((1.0 + top * high) + top * left)
