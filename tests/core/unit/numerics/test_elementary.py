"""Elementary functions against a library of any precision, and what the standard says of special values."""

import math
import re
import struct

import mpmath
import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.numerics import elementary
from mavfi.numerics.elementary import acos, asin, atan2, cbrt, cos, exp, log, quick_tanh, sin, tan, tanh
from mavfi.numerics.jit import uncached_copy

PRECISION = 1300  # bits: angles as large as 2^1024 need that many of pi
MANY = 1500


def error(value, function, *arguments):
    """Of a computed value, in units of its last place."""
    with mpmath.workprec(PRECISION):
        exact = function(*(mpmath.mpf(float(argument)) for argument in arguments))
        return float(abs(mpmath.mpf(value) - exact) / math.ulp(float(exact)))


def any_finite(random, count):
    """Numbers of any sign, exponent and mantissa."""
    numbers = random.integers(0, 2**64, 2 * count, dtype=np.uint64).view(np.float64)
    return numbers[np.isfinite(numbers)][:count]


def near_quarter_turns(random, count):
    return [float(mpmath.mpf(int(k)) * mpmath.pi / 2) for k in random.integers(1, 700_000, count)]


def wide(low, high):
    return lambda random, count: 10.0 ** random.uniform(low, high, count)


def between(low, high):
    return lambda random, count: random.uniform(low, high, count)


CASES = [
    *((name, numbers) for name in ("sin", "cos", "tan")
      for numbers in (between(-4.0, 4.0), between(-1e6, 1e6), between(1e6, 1e9), near_quarter_turns, any_finite)),
    ("asin", between(-1.0, 1.0)), ("acos", between(-1.0, 1.0)), ("acos", lambda *of: 1.0 - wide(-15, -1)(*of)),
    ("exp", between(-3.0, 3.0)), ("exp", between(-708.0, 709.0)),
    ("tanh", between(-3.0, 3.0)), ("tanh", wide(-9, 1.3)),
    ("log", wide(-300, 300)), ("log", between(0.5, 2.0)), ("log", lambda *of: 1.0 - wide(-9, -1)(*of)),
    ("cbrt", wide(-280, 280)),
]  # fmt: skip


@pytest.mark.parametrize(("name", "numbers"), CASES)
def test_less_than_one_unit_in_the_last_place(name, numbers):
    ours, exact = getattr(elementary, name), getattr(mpmath, name)
    given_to_it = numbers(np.random.default_rng(0), MANY)
    worst = max(given_to_it, key=lambda number: error(ours(number), exact, number))
    assert error(ours(worst), exact, worst) < 1.0, worst


@pytest.mark.parametrize("numbers", [between(-3.0, 3.0), between(-0.4, 0.4), wide(-300, 1.3)])
def test_the_quick_tangent_is_less_than_four_units_away(numbers):
    given_to_it = numbers(np.random.default_rng(0), MANY)
    assert max(error(quick_tanh(number), mpmath.tanh, number) for number in given_to_it) < 4.0


@pytest.mark.parametrize("span", [1.0, 9.0, 150.0])
def test_an_angle_of_any_vector_is_as_accurate(span):
    random = np.random.default_rng(1)
    size = 10.0 ** random.uniform(-span, span, (MANY, 2))
    vectors = size * random.choice([-1.0, 1.0], (MANY, 2))
    worst = max(vectors, key=lambda vector: error(atan2(*vector), mpmath.atan2, *vector))
    assert error(atan2(*worst), mpmath.atan2, *worst) < 1.0, worst


def same(value, other):
    return struct.pack("d", value) == struct.pack("d", other) or (math.isnan(value) and math.isnan(other))


@pytest.mark.parametrize("y", [0.0, -0.0, 1.0, -1.0, 5e-324, 1e308, math.inf, -math.inf])
@pytest.mark.parametrize("x", [0.0, -0.0, 1.0, -1.0, 5e-324, -1e308, math.inf, -math.inf])
def test_an_angle_at_the_borders_is_that_of_the_c_library(y, x):
    assert atan2(y, x) == pytest.approx(math.atan2(y, x), rel=1e-15, abs=0.0)
    assert math.copysign(1.0, atan2(y, x)) == math.copysign(1.0, math.atan2(y, x))


SPECIAL = [
    (sin, 0.0, 0.0), (sin, -0.0, -0.0), (sin, math.inf, math.nan), (cos, 0.0, 1.0), (cos, -math.inf, math.nan),
    (tan, -0.0, -0.0), (tan, math.inf, math.nan), (asin, 1.0, math.pi / 2), (asin, -1.0, -math.pi / 2),
    (asin, 1.0000000000000002, math.nan), (acos, 1.0, 0.0), (acos, -1.0, math.pi), (acos, -2.0, math.nan),
    (exp, -math.inf, 0.0), (exp, math.inf, math.inf), (exp, 710.0, math.inf), (exp, -746.0, 0.0), (exp, 0.0, 1.0),
    (tanh, math.inf, 1.0), (tanh, -math.inf, -1.0), (tanh, -0.0, -0.0), (tanh, 19.5, 1.0),
    (quick_tanh, math.inf, 1.0), (quick_tanh, -math.inf, -1.0), (quick_tanh, 0.0, 0.0), (quick_tanh, -0.0, -0.0),
    (quick_tanh, 19.5, 1.0), (log, 0.0, -math.inf), (log, -1.0, math.nan), (log, 1.0, 0.0), (log, math.inf, math.inf),
    (cbrt, 0.0, 0.0), (cbrt, -27.0, -3.0), (cbrt, math.inf, math.inf),
]  # fmt: skip


@pytest.mark.parametrize(("function", "number", "wanted"), SPECIAL)
def test_special_values(function, number, wanted):
    assert same(function(number), wanted)


@pytest.mark.parametrize("function", [sin, cos, tan, asin, acos, exp, tanh, quick_tanh, log, cbrt])
def test_not_a_number_stays_one(function):
    assert math.isnan(function(math.nan))
    assert math.isnan(atan2(math.nan, 1.0)) and math.isnan(atan2(1.0, math.nan))


@given(st.floats(5e-324, 2.3e-308))
def test_logarithms_of_denormal_numbers(number):
    assert error(log(number), mpmath.log, number) < 1.0


@given(st.floats(-745.0, -708.0))
def test_exponentials_that_are_denormal(number):
    assert abs(exp(number) - float(mpmath.exp(number))) <= 5e-324


def text_of(function, *arguments):
    """Machine code and IR; code from a cache does not show them."""
    recompiled = uncached_copy(function)
    recompiled(*arguments)
    return "".join(recompiled.inspect_asm().values()), "".join(recompiled.inspect_llvm().values())


NAMES = "|".join(["sin", "cos", "tan", "a(sin|cos|tan2?)", "exp", "tanh", "log", "pow", "cbrt", "sincos"])
CALL = re.compile(rf"call [^@]*@(llvm\.)?({NAMES})\b")


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
@pytest.mark.parametrize("function", [sin, cos, tan, asin, acos, exp, tanh, quick_tanh, log, cbrt, atan2])
def test_neither_contracted_nor_given_to_the_c_library(function):
    assembly, ir = text_of(function, *[0.5] * (2 if function is atan2 else 1))
    assert not re.search(r"fn?m(add|sub)", assembly)
    assert not CALL.search(ir)
