"""Settings against each other in the same missions: McNemar's test, paired differences, and the recovery rate.

All intervals are 95 %; worlds are the clusters, as in `mavfi.campaign.analysis.statistics`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from mavfi.campaign.analysis.statistics import Part, cluster_sums, exact_bounds, percentiles, resample, score_bounds


@dataclass(frozen=True, slots=True)
class Paired:
    """McNemar's exact test on pairs."""

    n: int  # pairs
    first_only: int  # pairs in which only the first succeeds
    second_only: int  # pairs in which only the second succeeds
    p_value: float  # two-sided; 1 where no pair is discordant


@dataclass(frozen=True, slots=True)
class Recovery:
    """Recovery rate (method - fi) / (golden - fi), and the loss, golden - fi, in pairs; with intervals."""

    rate: float | None  # None, as its bounds, where undefined: the interval of the denominator contains 0
    low: float | None
    high: float | None
    loss: float
    loss_low: float
    loss_high: float
    lost: int  # pairs in which golden succeeds and fi does not
    regained: int  # of these, those in which the method succeeds


def mcnemar(first: Sequence[bool], second: Sequence[bool]) -> Paired:
    """Exact test that two settings, given by their success in each pair, succeed equally often."""
    first_only = sum(a and not b for a, b in zip(first, second, strict=True))
    second_only = sum(b and not a for a, b in zip(first, second, strict=True))
    discordant = first_only + second_only
    p_value = float(binomtest(first_only, discordant, 0.5).pvalue) if discordant else 1.0
    return Paired(len(first), first_only, second_only, p_value)


def paired_difference(
    first: Sequence[bool], second: Sequence[bool], world: Sequence[object]
) -> tuple[float, float, float]:
    """Difference of two success rates in the same missions, first - second, with MOVER's interval: estimate, low, high.

    The difference is that of two shares: pairs in which only the first succeeds, and only the second; each has
    Wilson's interval for the effective number of pairs, and they are correlated as shares of one sample are.  Without
    discordant pairs the interval is as wide as these two allow, not 0.  There is at least one pair.
    """
    one, other = np.asarray(first, bool), np.asarray(second, bool)
    ones = np.ones(len(one))
    a, b = (Part.of(only.astype(np.float64), ones, world) for only in (one & ~other, other & ~one))
    (a_low, a_high), (b_low, b_high) = score_bounds(a.rate, a.effective), score_bounds(b.rate, b.effective)
    odds = a.rate * b.rate / max((1 - a.rate) * (1 - b.rate), 1e-300)
    together = -float(np.sqrt(min(odds, 1.0)))
    difference = a.rate - b.rate
    return (
        difference,
        max(-1.0, difference - _added(a.rate - a_low, b_high - b.rate, together)),
        min(1.0, difference + _added(a_high - a.rate, b.rate - b_low, together)),
    )


def _added(one: float, other: float, correlation: float) -> float:
    """Length of a difference's arm from the arms of its parts."""
    return float(np.sqrt(one**2 + other**2 - 2 * correlation * one * other))


def recovery(pairs: Sequence[tuple[object, bool, bool, bool]]) -> Recovery | None:
    """Share of the lost missions that a detector brings back; None if there is no pair.

    Pairs are world, success without a fault, with the fault, with fault and method.  Where the method only brings back
    what fi alone has lost, the rate is a share of these pairs: Clopper and Pearson's exact interval, for the effective
    number of pairs (Korn and Graubard 1998).  Where other pairs differ too, it is widened to hold the clustered
    bootstrap's interval.
    """
    if not pairs:
        return None
    worlds = [world for world, *_ in pairs]
    golden, fi, method = (np.array([bool(pair[place]) for pair in pairs]) for place in (1, 2, 3))
    loss, loss_low, loss_high = paired_difference(golden.tolist(), fi.tolist(), worlds)
    lost = golden & ~fi
    counts = int(lost.sum()), int((lost & method).sum())
    if loss_low <= 0:
        return Recovery(None, None, None, loss, loss_low, loss_high, *counts)
    gain = float(np.mean(method.astype(np.float64) - fi))
    low, high = _exact(method[lost], [world for world, is_lost in zip(worlds, lost, strict=True) if is_lost])
    if np.any(fi & ~golden) or np.any((method != fi) & ~lost):
        totals = resample(cluster_sums(worlds, golden, fi, method))
        with np.errstate(invalid="ignore", divide="ignore"):
            from_samples = percentiles((totals[:, 2] - totals[:, 1]) / (totals[:, 0] - totals[:, 1]))
        low, high = min(low, from_samples[0]), max(high, from_samples[1])
    return Recovery(gain / loss, low, high, loss, loss_low, loss_high, *counts)


def _exact(success: np.ndarray, world: Sequence[object]) -> tuple[float, float]:
    """Clopper and Pearson's interval for the effective number of flights."""
    part = Part.of(success.astype(np.float64), np.ones(len(success)), world)
    hits = part.rate * part.effective
    return exact_bounds(hits, part.effective - hits)
