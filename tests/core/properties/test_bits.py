import struct

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavfi.numerics import bits

ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
THRESHOLDS = st.integers(-10, 4)


@given(ANY)
def test_the_fields_are_the_leading_bits_of_the_number(value):
    (word,) = struct.unpack("<Q", struct.pack("<d", value))
    assert word >> 52 == bits.sign_field(value) << 11 | bits.exponent_field(value)


@given(FINITE, FINITE, THRESHOLDS)
def test_the_code_is_monotone(first, second, threshold):
    low, high = min(first, second), max(first, second)
    assert bits.sign_exponent_code(low, threshold) <= bits.sign_exponent_code(high, threshold)


@given(FINITE, THRESHOLDS)
def test_the_code_is_odd_and_tells_the_octave(value, threshold):
    code = bits.sign_exponent_code(value, threshold)
    assert bits.sign_exponent_code(-value, threshold) == -code
    octave = int(np.floor(np.log2(abs(value)))) if abs(value) >= 2.0**threshold else threshold - 1
    assert abs(abs(code) - (octave - threshold + 1)) <= (abs(value) > 1.0) * 1  # log2 may round up below 2**n
    assert -1035 <= code <= 1035


@given(ANY, ANY, THRESHOLDS)
def test_a_difference_of_codes_fits_in_16_bits(first, second, threshold):
    delta = bits.sign_exponent_code(first, threshold) - bits.sign_exponent_code(second, threshold)
    assert bits.saturated_int16(delta) == delta
