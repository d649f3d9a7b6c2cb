"""Rates with intervals: what a number of flights can say, and what it cannot.

All intervals are 95 %.  Bootstraps resample whole worlds (missions), since flights of one world are alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, chi2, norm

CONFIDENCE = 0.95
RESAMPLES = 2000
_SEED = 20
_TAIL = (1 - CONFIDENCE) / 2


@dataclass(frozen=True, slots=True)
class Rate:
    """A rate and its interval; all None where there is nothing to judge.

    Attributes:
        n: Flights.
        rate: Estimate.
        low: Lower bound.
        high: Upper bound.
        successes: Flights that count; None for weighted rates.
    """

    n: int
    rate: float | None
    low: float | None
    high: float | None
    successes: int | None = None


@dataclass(frozen=True, slots=True)
class Paired:
    """McNemar's exact test on pairs.

    Attributes:
        n: Pairs.
        first_only: Pairs in which only the first succeeds.
        second_only: Pairs in which only the second succeeds.
        p_value: Two-sided; 1 where no pair is discordant.
    """

    n: int
    first_only: int
    second_only: int
    p_value: float


@dataclass(frozen=True, slots=True)
class Recovery:
    """Recovery rate (method - fi) / (golden - fi).

    Attributes:
        rate: None = undefined: the interval of the denominator contains 0.
        low: Lower bound; None where undefined.
        high: Upper bound.
        loss: golden - fi.
        loss_low: Lower bound of the loss.
        loss_high: Upper bound of the loss.
    """

    rate: float | None
    low: float | None
    high: float | None
    loss: float
    loss_low: float
    loss_high: float


@dataclass(frozen=True, slots=True)
class EventRate:
    """Events per hour of exposure, Poisson.

    Attributes:
        events: Events.
        hours: Exposure (h).
        per_hour: Estimate; None without exposure.
        low: Lower bound of the two-sided interval.
        high: Upper bound of the two-sided interval.
        upper: One-sided upper bound: what zero events still allow.
    """

    events: int
    hours: float
    per_hour: float | None
    low: float | None
    high: float | None
    upper: float | None


def wilson(successes: int, n: int) -> Rate:
    """Rate with Wilson's score interval.

    Args:
        successes: Flights that count.
        n: Flights.
    """
    if n == 0:
        return Rate(0, None, None, None, 0)
    interval = binomtest(successes, n).proportion_ci(CONFIDENCE, method="wilson")
    return Rate(n, successes / n, float(interval.low), float(interval.high), successes)


def mcnemar(first: Sequence[bool], second: Sequence[bool]) -> Paired:
    """Exact test that two settings succeed equally often in the same worlds with the same faults.

    Args:
        first: Success by pair.
        second: Success by pair, in the same order.
    """
    first_only = sum(a and not b for a, b in zip(first, second, strict=True))
    second_only = sum(b and not a for a, b in zip(first, second, strict=True))
    discordant = first_only + second_only
    p_value = float(binomtest(first_only, discordant, 0.5).pvalue) if discordant else 1.0
    return Paired(len(first), first_only, second_only, p_value)


def cluster_sums(clusters: Sequence[object], *columns: Sequence[float] | np.ndarray) -> np.ndarray:
    """Sums of columns by cluster.

    Args:
        clusters: Cluster of each row, e.g. its world.
        columns: Numbers of each row.

    Returns:
        Shape (clusters, columns), in the order in which the clusters first appear.
    """
    places = {cluster: place for place, cluster in enumerate(dict.fromkeys(clusters))}
    rows = np.array([places[cluster] for cluster in clusters], np.int64)
    sums = np.zeros((len(places), len(columns)))
    for index, column in enumerate(columns):
        np.add.at(sums[:, index], rows, np.asarray(column, np.float64))
    return sums


def resample(sums: np.ndarray) -> np.ndarray:
    """Totals of the columns in bootstrap samples of clusters.

    Args:
        sums: As of `cluster_sums`. Shape (k, m).

    Returns:
        Shape (RESAMPLES, m); the same for the same input.
    """
    k = len(sums)
    draws = np.random.default_rng(_SEED).multinomial(k, np.full(k, 1 / k), size=RESAMPLES)
    totals: np.ndarray = draws @ sums
    return totals


def weighted_rate(
    success: Sequence[float], weight: Sequence[float], stratum: Sequence[str], world: Sequence[object]
) -> Rate:
    """Rate over a population of which each stratum was sampled at its own density; clustered bootstrap interval.

    A draw's weight is the share of the population that its stratum stands for; sum over strata of the mean of
    weight x success, over the same without success.  Where all flights end alike, the interval is Wilson's.

    Args:
        success: 0 or 1 by flight.
        weight: `Fault.weight` by flight.
        stratum: By flight.
        world: By flight; flights of one world are resampled together.
    """
    n = len(success)
    if n == 0:
        return Rate(0, None, None, None)
    y, w = np.asarray(success, np.float64), np.asarray(weight, np.float64)
    names = list(dict.fromkeys(stratum))
    inside = [np.array([s == name for s in stratum], np.float64) for name in names]
    sums = cluster_sums(world, *(part for i in inside for part in (i * w * y, i * w, i)))
    rate = float(_ratio_of_means(sums.sum(axis=0)[None])[0])
    if y.min() == y.max():
        low, high = _unanimous(rate, [(float((i * w).sum()) / i.sum(), float(i.sum())) for i in inside])
    else:
        low, high = _interval(_ratio_of_means(resample(sums)))
    return Rate(n, rate, low, high)


def _unanimous(rate: float, strata: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Wilson's interval where no flight differs from the others, so that resampling shows no spread.

    Args:
        rate: 0 or 1 (up to rounding).
        strata: Weight in the population and number of flights of each.
    """
    whole = sum(weight for weight, _ in strata)
    n = 1 / sum((weight / whole) ** 2 / count for weight, count in strata)  # of as exact a sample without strata
    z2 = float(norm.ppf(1 - _TAIL)) ** 2
    return (n / (n + z2), 1.0) if rate > 0.5 else (0.0, z2 / (n + z2))


def _ratio_of_means(totals: np.ndarray) -> np.ndarray:
    """Columns per stratum: sum of w y, sum of w, count."""
    hit, weight, count = totals[:, 0::3], totals[:, 1::3], np.maximum(totals[:, 2::3], 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio: np.ndarray = (hit / count).sum(axis=1) / (weight / count).sum(axis=1)
    return ratio


def recovery(golden: Sequence[tuple[object, bool]], pairs: Sequence[tuple[object, bool, bool]]) -> Recovery | None:
    """Share of the lost missions that a detector brings back.

    Args:
        golden: World and success of each golden flight.
        pairs: World, success with the fault, success with fault and detector.

    Returns:
        None if there is no flight.
    """
    if not golden or not pairs:
        return None
    worlds = [world for world, _ in golden] + [world for world, _, _ in pairs]
    n_golden, n_pairs = len(golden), len(pairs)
    sums = cluster_sums(
        worlds,
        [ok for _, ok in golden] + [0.0] * n_pairs,
        [1.0] * n_golden + [0.0] * n_pairs,
        [0.0] * n_golden + [ok for _, ok, _ in pairs],
        [0.0] * n_golden + [ok for _, _, ok in pairs],
        [0.0] * n_golden + [1.0] * n_pairs,
    )
    loss, gain = (float(part[0]) for part in _loss_and_gain(sums.sum(axis=0)[None]))
    losses, gains = _loss_and_gain(resample(sums))
    loss_low, loss_high = _interval(losses)
    if loss_low <= 0 <= loss_high or loss == 0:
        return Recovery(None, None, None, loss, loss_low, loss_high)
    with np.errstate(invalid="ignore", divide="ignore"):
        low, high = _interval(gains / losses)
    return Recovery(gain / loss, low, high, loss, loss_low, loss_high)


def _loss_and_gain(totals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Golden - fi, and method - fi; NaN in the rare sample without golden flights or pairs."""
    with np.errstate(invalid="ignore", divide="ignore"):
        golden, fi, method = totals[:, 0] / totals[:, 1], totals[:, 2] / totals[:, 4], totals[:, 3] / totals[:, 4]
    return golden - fi, method - fi


def _interval(samples: np.ndarray) -> tuple[float, float]:
    finite = samples[np.isfinite(samples)]
    if len(finite) == 0:
        return float("-inf"), float("inf")
    low, high = np.quantile(finite, (_TAIL, 1 - _TAIL))
    return float(low), float(high)


def event_rate(events: int, hours: float) -> EventRate:
    """Events per hour with Garwood's exact Poisson interval.

    Args:
        events: How many.
        hours: Exposure (h).
    """
    if not hours > 0:
        return EventRate(events, hours, None, None, None, None)
    low = float(chi2.ppf(_TAIL, 2 * events)) / 2 / hours if events else 0.0
    high = float(chi2.ppf(1 - _TAIL, 2 * events + 2)) / 2 / hours
    upper = float(chi2.ppf(CONFIDENCE, 2 * events + 2)) / 2 / hours
    return EventRate(events, hours, events / hours, low, high, upper)


def smallest_difference(rate: float, first_n: int, second_n: int, power: float = 0.8) -> float | None:
    """Difference of two rates that a table cannot be expected to show if it is smaller than this.

    Two-sided 5 % test of independent samples, normal approximation; pairing makes the true figure somewhat smaller.

    Args:
        rate: Rate around which they lie; rates of 0 and 1 are taken as half a flight away from them.
        first_n: Flights of the first.
        second_n: Flights of the second.
        power: Probability with which the difference should show.
    """
    if min(first_n, second_n) == 0:
        return None
    margin = 0.5 / min(first_n, second_n)
    p = min(max(rate, margin), 1 - margin)
    spread = np.sqrt(p * (1 - p) * (1 / first_n + 1 / second_n))
    return float((norm.ppf(1 - _TAIL) + norm.ppf(power)) * spread)
