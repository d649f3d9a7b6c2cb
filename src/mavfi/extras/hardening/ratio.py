"""Coverage: the share of silent corruptions per call that protection removes, with its interval."""

from math import hypot, inf, sqrt
from statistics import NormalDist

from mavfi.analysis.statistics import TAIL, Rate

_NORMAL = NormalDist()


def coverage(before: Rate, after: Rate, growth: float) -> Rate:
    """1 - growth x rate after / rate before, with MOVER's interval for a ratio (Donner and Zou 2012).

    Args:
        before: Rate of silent corruption per injection in plain code.
        after: The same in protected code, over all of its instructions.
        growth: Dynamic instructions of protected code / plain code: if each instruction is equally likely to be hit,
            added instructions are hit, too.  Without it each one would dilute the rate and seem to protect.

    Returns:
        Negative if the protection does harm; all None without injections or corruptions in plain code.
    """
    if not before.rate or after.rate is None:
        return Rate(after.n, None, None, None)
    low, high = ratio_bounds(after, before)
    return Rate(after.n, 1 - growth * after.rate / before.rate, 1 - growth * high, 1 - growth * low)


def ratio_bounds(above: Rate, below: Rate) -> tuple[float, float]:
    """Interval of the ratio of two independent rates, from their own intervals."""
    p, low_p, high_p = bounds_of(above)
    q, low_q, high_q = bounds_of(below)
    lower = (p * q) ** 2 - low_p * high_q * (2 * p - low_p) * (2 * q - high_q)
    upper = (p * q) ** 2 - high_p * low_q * (2 * p - high_p) * (2 * q - low_q)
    bottom, top = high_q * (2 * q - high_q), low_q * (2 * q - low_q)
    low = (p * q - sqrt(max(lower, 0.0))) / bottom if bottom > 0 else 0.0
    return max(low, 0.0), (p * q + sqrt(max(upper, 0.0))) / top if top > 0 else inf


def difference(measured: Rate, predicted: Rate) -> tuple[float, float]:
    """Interval of measured - predicted coverage (MOVER for a difference); infinite if one is not known."""
    if measured.rate is None or predicted.rate is None:
        return -inf, inf
    one, low, high = bounds_of(measured)
    other, other_low, other_high = bounds_of(predicted)
    gap = one - other
    return gap - hypot(one - low, other_high - other), gap + hypot(high - one, other - other_low)


def p_value_below(measured: Rate, predicted: Rate) -> float | None:
    """Two-sided p of equal coverages: below 0.05 where the interval of `difference` is below 0; None if not known.

    A normal approximation on the side of its upper bound; 1 if the measured coverage is not lower.
    """
    if measured.rate is None or predicted.rate is None:
        return None
    gap = measured.rate - predicted.rate
    if gap >= 0:
        return 1.0
    half = difference(measured, predicted)[1] - gap
    return 2 * _NORMAL.cdf(_NORMAL.inv_cdf(1 - TAIL) * gap / half) if half > 0 else 0.0


def bounds_of(found: Rate) -> tuple[float, float, float]:
    """Rate, and its bounds."""
    assert found.rate is not None and found.low is not None and found.high is not None  # as with any injection
    return found.rate, found.low, found.high
