import numpy as np
import pytest

from mavfi.numerics import bits

SMALLEST = 5e-324
LARGEST = np.finfo(np.float64).max


@pytest.mark.parametrize("threshold", [-3, -2, -1, 0])
def test_zeros_denormals_and_small_numbers_have_code_zero(threshold):
    below = np.nextafter(2.0**threshold, 0.0)
    for value in (0.0, -0.0, SMALLEST, -SMALLEST, 2.2e-308, below, -below):
        assert bits.sign_exponent_code(value, threshold) == 0


@pytest.mark.parametrize("threshold", [-3, 0])
def test_infinities_and_nan_get_the_code_beyond_the_largest_finite_one(threshold):
    assert bits.sign_exponent_code(LARGEST, threshold) == 1024 - threshold
    assert bits.sign_exponent_code(np.inf, threshold) == 1025 - threshold
    assert bits.sign_exponent_code(-np.inf, threshold) == threshold - 1025
    assert abs(bits.sign_exponent_code(np.nan, threshold)) == 1025 - threshold


@pytest.mark.parametrize(
    ("value", "expected"), [(0, 0), (32767, 32767), (32768, 32767), (-32768, -32767), (1 << 40, 32767)]
)
def test_differences_saturate_in_16_bits(value, expected):
    assert bits.saturated_int16(value) == expected
