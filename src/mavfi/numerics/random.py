"""Random numbers with four unsigned integers in kernel memory as complete state (xoshiro256+, Blackman & Vigna 2021).

Normal deviates are drawn by inverse transform sampling (Wichura 1988, algorithm AS 241, PPND16): NumPy's generator
calls libm's exp and log1p, whose rounding depends on the CPU.
"""

import math

import numpy as np

from mavfi.numerics.elementary import log
from mavfi.numerics.jit import kernel_jit

_TWO_POW_53 = 9007199254740992.0
_SMALLEST = 0.5 / _TWO_POW_53
_CENTRE = (
    (3.3871328727963666080e0, 1.3314166789178437745e2, 1.9715909503065514427e3, 1.3731693765509461125e4,
     4.5921953931549871457e4, 6.7265770927008700853e4, 3.3430575583588128105e4, 2.5090809287301226727e3),
    (1.0, 4.2313330701600911252e1, 6.8718700749205790830e2, 5.3941960214247511077e3,
     2.1213794301586595867e4, 3.9307895800092710610e4, 2.8729085735721942674e4, 5.2264952788528545610e3),
)  # fmt: skip
"""Numerator and denominator near the median."""
_SIDES = (
    (1.42343711074968357734e0, 4.63033784615654529590e0, 5.76949722146069140550e0, 3.64784832476320460504e0,
     1.27045825245236838258e0, 2.41780725177450611770e-1, 2.27238449892691845833e-2, 7.74545014278341407640e-4),
    (1.0, 2.05319162663775882187e0, 1.67638483018380384940e0, 6.89767334985100004550e-1,
     1.48103976427480074590e-1, 1.51986665636164571966e-2, 5.47593808499534494600e-4, 1.05075007164441684324e-9),
)  # fmt: skip
_TAILS = (
    (6.65790464350110377720e0, 5.46378491116411436990e0, 1.78482653991729133580e0, 2.96560571828504891230e-1,
     2.65321895265761230930e-2, 1.24266094738807843860e-3, 2.71155556874348757815e-5, 2.01033439929228813265e-7),
    (1.0, 5.99832206555887937690e-1, 1.36929880922735805310e-1, 1.48753612908506148525e-2,
     7.86869131145613259100e-4, 1.84631831751005468180e-5, 1.42151175831644588870e-7, 2.04426310338993978564e-15),
)  # fmt: skip


def seed_generator(seed: int, *address: int) -> np.ndarray:
    """Generator state for a seed and an address (purpose, run, ...).

    Args:
        seed: Mission seed.
        address: Spawn key: one stream per purpose, so that streams are independent of each other.

    Returns:
        Shape (4,), uint64, not all zero.
    """
    state = np.random.SeedSequence(seed, spawn_key=address).generate_state(4, np.uint64)
    state[0] |= np.uint64(1)
    return state


@kernel_jit
def uniform(state: np.ndarray) -> float:
    """Next number in [0, 1); changes `state` (shape (4,), uint64)."""
    result = state[0] + state[3]
    shifted = state[1] << np.uint64(17)
    state[2] ^= state[0]
    state[3] ^= state[1]
    state[1] ^= state[2]
    state[0] ^= state[3]
    state[2] ^= shifted
    state[3] = (state[3] << np.uint64(45)) | (state[3] >> np.uint64(19))
    return np.float64(result >> np.uint64(11)) / _TWO_POW_53


@kernel_jit
def _ratio(fraction: tuple[tuple[float, ...], tuple[float, ...]], r: float) -> float:
    """Ratio of two polynomials in r, given by their coefficients."""
    above, below = fraction[0][7], fraction[1][7]
    for i in range(6, -1, -1):
        above = above * r + fraction[0][i]
        below = below * r + fraction[1][i]
    return above / below


@kernel_jit
def normal_quantile(share: float) -> float:
    """Quantile function of the standard normal distribution.

    Args:
        share: Probability, in (0, 1).
    """
    q = share - 0.5
    if abs(q) <= 0.425:
        return q * _ratio(_CENTRE, 0.180625 - q * q)
    r = math.sqrt(-log(min(share, 1.0 - share)))
    size = _ratio(_SIDES, r - 1.6) if r <= 5.0 else _ratio(_TAILS, r - 5.0)
    return size if q > 0.0 else -size


@kernel_jit
def _to_normal(numbers: np.ndarray) -> None:
    for i in range(numbers.size):
        numbers[i] = normal_quantile(max(numbers[i], _SMALLEST))


def normals(key: int, time_us: int, count: int) -> np.ndarray:
    """Standard normal deviates, a function of key and instant (us) alone. Shape (count,)."""
    stream = np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, time_us]))
    numbers: np.ndarray = stream.random(count)
    _to_normal(numbers)
    return numbers
