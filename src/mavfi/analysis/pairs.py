"""Paired comparison of settings in the same missions: McNemar's test, paired differences, and the recovery rate.

All intervals are 95 %; worlds are the clusters, as in `mavfi.analysis.statistics`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavfi.analysis.statistics import Part, cluster_sums, exact_bounds, percentiles, resample, score_bounds


@dataclass(frozen=True, slots=True)
class Paired:
    """McNemar's exact test on pairs, with random signs of whole worlds."""

    n: int  # pairs
    first_only: int  # pairs in which only the first succeeds
    second_only: int  # pairs in which only the second succeeds
    p_value: float  # two-sided; 1 if no pair is discordant


@dataclass(frozen=True, slots=True)
class Recovery:
    """Recovery rate (method - fi) / (golden - fi) and loss (golden - fi) over pairs, with intervals."""

    rate: float | None  # None, like its bounds, if undefined: the interval of the denominator contains 0
    low: float | None
    high: float | None
    loss: float
    loss_low: float
    loss_high: float
    lost: int  # pairs in which golden succeeds and fi does not
    regained: int  # of these, those in which the method succeeds


def mcnemar(first: Sequence[bool], second: Sequence[bool], world: Sequence[object] | None = None) -> Paired:
    """Exact test of equal success rates of two settings, given their success in each pair.

    Pairs of one world (None = each in its own) are not independent: the signs of their differences change together
    (Fisher's randomization test).  With one pair per world it is McNemar's exact test.
    """
    pairs = list(zip(first, second, strict=True))
    first_only, second_only = sum(a and not b for a, b in pairs), sum(b and not a for a, b in pairs)
    worlds = range(len(pairs)) if world is None else world
    sums = cluster_sums(worlds, [float(a) - float(b) for a, b in pairs])[:, 0]
    return Paired(len(pairs), first_only, second_only, _of_random_signs([round(one) for one in sums]))


def _of_random_signs(differences: Sequence[int]) -> float:
    """Probability of a sum at least as far from 0 as the given one, if each term has a random sign."""
    chances = np.ones(1)  # of the sums -reach to reach, in steps of 1
    for size in filter(None, map(abs, differences)):
        chances = 0.5 * (np.pad(chances, (0, 2 * size)) + np.pad(chances, (2 * size, 0)))
    distance = np.abs(np.arange(len(chances)) - len(chances) // 2)
    return float(min(1.0, chances[distance >= abs(sum(differences))].sum()))


def paired_difference(
    first: Sequence[bool], second: Sequence[bool], world: Sequence[object], weight: Sequence[float] | None = None
) -> tuple[float, float, float]:
    """Difference of two success rates in the same missions, first - second, with MOVER's interval: estimate, low, high.

    It is the difference between the shares of pairs in which only the first and only the second succeeds.  Each share
    has Wilson's interval for the effective number of pairs; their correlation is that of multinomial shares.  Without
    discordant pairs the interval keeps the width of these two.  At least one pair is required; weights (None = equal)
    have a sum above 0.
    """
    one, other = np.asarray(first, bool), np.asarray(second, bool)
    weights = np.ones(len(one)) if weight is None else np.asarray(weight, np.float64)
    a, b = (Part.of(only.astype(np.float64), weights, world) for only in (one & ~other, other & ~one))
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
    """Distance from a difference to its bound, from the corresponding distances of its two terms (MOVER)."""
    return float(np.sqrt(one**2 + other**2 - 2 * correlation * one * other))


def recovery(pairs: Sequence[tuple[object, bool, bool, bool]]) -> Recovery | None:
    """Recovery rate of a method, the share of lost missions that it recovers; None without pairs.

    Pairs contain the world and the success without a fault, with the fault, and with fault and method.  If the method
    only recovers missions lost in fi, the rate is a proportion of these: Clopper and Pearson's exact interval for the
    effective number of pairs (Korn and Graubard 1998).  If other pairs differ too, the interval is widened to include
    that of the clustered bootstrap.
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
