"""Rates with intervals, and the smallest differences that a number of flights can resolve.

Results are a `Rate` or an `EventRate`, which are cells of tables and may be empty, or an `Estimate`, which has a value.

All intervals are 95 %.  Flights in one world are correlated, so worlds are the clusters of every interval: score
intervals use the effective number of flights, n / design effect (Kish 1965; Korn and Graubard 1998), bootstraps
resample whole worlds.  Bootstrap intervals have zero width if all flights end alike; intervals of weighted rates and
differences are therefore combined from score intervals by MOVER (Newcombe 1998; Zou and Donner 2008).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

CONFIDENCE = 0.95
RESAMPLES = 2000
_SEED = 20  # of the bootstrap: all intervals are deterministic
_POWER = 0.8  # power for `smallest_difference`
TAIL = (1 - CONFIDENCE) / 2  # probability outside an interval on each side
_NORMAL = NormalDist()
_Z2 = _NORMAL.inv_cdf(1 - TAIL) ** 2


@dataclass(frozen=True, slots=True)
class Rate:
    """A rate and its interval; all None without flights."""

    n: int  # flights
    rate: float | None
    low: float | None
    high: float | None
    successes: int | None = None  # None for weighted rates

    @property
    def interval(self) -> str:
        """The interval in per cent, as text: "[78.7, 98.2]"; empty if there is none."""
        if self.low is None or self.high is None:
            return ""
        return f"[{100 * self.low:.1f}, {100 * self.high:.1f}]"

    @property
    def percent(self) -> str:
        """The rate with its interval, as text: "93.3 % [78.7, 98.2]"; empty without both."""
        if self.rate is None or not self.interval:
            return ""
        return f"{100 * self.rate:.1f} % {self.interval}"

    @property
    def negative(self) -> "Rate":
        """The difference with the other sign; itself without an interval."""
        if self.rate is None or self.low is None or self.high is None:
            return self
        return replace(self, rate=-self.rate, low=-self.high, high=-self.low)


@dataclass(frozen=True, slots=True)
class EventRate:
    """Events per hour of exposure, with a two-sided interval; None without exposure."""

    events: int
    hours: float  # exposure
    per_hour: float | None
    low: float | None
    high: float | None
    upper: float | None  # one-sided upper bound

    @property
    def text(self) -> str:
        """Events per hour with the interval: "1.2 [0.1, 3.4]"; empty without exposure."""
        if self.per_hour is None:
            return ""
        return f"{self.per_hour:.1f} [{self.low:.1f}, {self.high:.1f}]"


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with the bounds of its interval or band."""

    value: float
    low: float
    high: float

    def times(self, factor: "float | Estimate") -> "Estimate":
        """The estimate scaled by a factor; the bounds of an uncertain factor widen the interval."""
        if not isinstance(factor, Estimate):
            factor = Estimate(factor, factor, factor)
        products = [bound * scale for bound in (self.low, self.high) for scale in (factor.low, factor.high)]
        return Estimate(self.value * factor.value, min(products), max(products))

    def not_negative(self) -> "Estimate":
        """The estimate of a value that cannot be negative: value and interval are cut at 0, which loses no coverage."""
        return Estimate(max(0.0, self.value), max(0.0, self.low), max(0.0, self.high))


def wilson(successes: int, n: int) -> Rate:
    """Rate of successes among n flights, with Wilson's score interval."""
    if n == 0:
        return Rate(0, None, None, None, 0)
    rate = successes / n
    return Rate(n, rate, *score_bounds(rate, n), successes)


def score_bounds(rate: float, n: float) -> tuple[float, float]:
    """Bounds of Wilson's score interval; n may be fractional."""
    centre = (n * rate + _Z2 / 2) / (n + _Z2)
    half = float(np.sqrt(_Z2 * (n * rate * (1 - rate) + _Z2 / 4))) / (n + _Z2)
    # at rates of 0 and 1 one bound is exact; the formula would miss it by a rounding error
    low = 0.0
    high = 1.0
    if rate > 0:
        low = max(0.0, centre - half)
    if rate < 1:
        high = min(1.0, centre + half)
    return low, high


def _quantile(distribution: str, probability: float, *parameters: float) -> float:
    """Quantile of a distribution of `scipy.stats`, which is in the extra `report` and takes long to import."""
    from scipy import stats

    return float(getattr(stats, distribution).ppf(probability, *parameters))


def exact_bounds(hits: float, misses: float, tail: float = TAIL) -> tuple[float, float]:
    """Interval of a proportion after Clopper and Pearson (1934), with probability `tail` outside on each side."""
    low = 0.0
    high = 1.0
    if hits > 0:
        low = _quantile("beta", tail, hits, misses + 1)
    if misses > 0:
        high = _quantile("beta", 1 - tail, hits + 1, misses)
    return low, high


def clustered_rate(success: Sequence[bool], world: Sequence[object]) -> Rate:
    """Rate with Wilson's interval for the effective number of flights; worlds are the clusters.

    With one flight per world the interval is that of `wilson`.
    """
    if not success:
        return wilson(0, 0)
    estimate = StratumRate.of(np.asarray(success, np.float64), np.ones(len(success)), world).estimate
    return Rate(len(success), float(estimate.value), estimate.low, estimate.high, sum(map(bool, success)))


@dataclass(frozen=True, slots=True)
class StratumRate:
    """A weighted rate within one stratum, and its precision."""

    rate: float
    effective: float  # number of independent flights with the same precision
    spread: np.ndarray  # contribution of each world to the error of the estimate. Shape (worlds,)

    @property
    def estimate(self) -> Estimate:
        """The rate with Wilson's interval for the effective number of flights."""
        return Estimate(self.rate, *score_bounds(self.rate, self.effective))

    @staticmethod
    def of(y: np.ndarray, weight: np.ndarray, world: Sequence[object]) -> "StratumRate":
        """Linearised ratio estimate; flights of weight 0 are excluded.

        Args:
            y: Whether each flight succeeded, 0 or 1. Shape (n,).
            weight: Weight of each flight. Shape (n,).
            world: World of each flight.
        """
        total = float(weight.sum())
        rate = float((weight * y).sum()) / total
        spread = cluster_sums(world, weight * (y - rate) / total)[:, 0]
        independent = total**2 / float((weight**2).sum())  # Kish's number: less than n for unequal weights
        if len(np.unique(y[weight > 0])) == 1:
            # all flights end alike: exactly 0 or 1, without a variance from which a design effect could be computed
            return StratumRate(round(rate), independent, spread)
        variance = float((spread**2).sum())
        if variance > 0:
            return StratumRate(rate, min(independent, rate * (1 - rate) / variance), spread)
        return StratumRate(rate, independent, spread)


def cluster_sums(clusters: Sequence[object], *columns: Sequence[float] | np.ndarray) -> np.ndarray:
    """Sums of columns by cluster, e.g. by the world of each row.

    Returns:
        Shape (clusters, columns), in order of first appearance of the clusters.
    """
    indices = {cluster: index for index, cluster in enumerate(dict.fromkeys(clusters))}
    cluster_of_row = np.array([indices[cluster] for cluster in clusters], np.int64)
    sums = np.zeros((len(indices), len(columns)))
    for number, column in enumerate(columns):
        np.add.at(sums[:, number], cluster_of_row, np.asarray(column, np.float64))
    return sums


def resample(sums: np.ndarray) -> np.ndarray:
    """Column totals of `cluster_sums`, shape (k, m), in bootstrap samples of clusters.

    Returns:
        Shape (RESAMPLES, m); deterministic.
    """
    totals: np.ndarray = draws(len(sums)) @ sums
    return totals


def draws(clusters: int) -> np.ndarray:
    """How often each cluster is in each bootstrap sample; deterministic. Shape (RESAMPLES, clusters)."""
    random = np.random.default_rng(_SEED)
    counts: np.ndarray = random.multinomial(clusters, np.full(clusters, 1 / clusters), size=RESAMPLES)
    return counts


def weighted_rate(
    success: Sequence[float], weight: Sequence[float], stratum: Sequence[str], world: Sequence[object]
) -> Rate:
    """Rate over a population from a stratified sample with different sampling densities.

    A draw's weight (`Fault.weight`) is the share of the population that its stratum represents; the rate is the sum
    over strata of the mean of weight x success, divided by the sum of the mean weights.  The interval is MOVER's:
    distances to Wilson's bounds within the strata, for the effective numbers of flights, are added like standard
    errors, with the correlation between strata that share worlds (if positive).  It is conditional on the drawn fields.
    A stratum in which all flights end alike keeps its uncertainty.
    """
    n = len(success)
    if n == 0:
        return Rate(0, None, None, None)
    y = np.asarray(success, np.float64)
    weights = np.asarray(weight, np.float64)
    # rate and share of the population by stratum; a mask is 1 for the flights of a stratum, else 0
    masks = [np.array([name == wanted for name in stratum], np.float64) for wanted in dict.fromkeys(stratum)]
    strata = [StratumRate.of(y, mask * weights, world) for mask in masks]
    shares = np.array([float((mask * weights).sum() / mask.sum()) for mask in masks])
    shares /= shares.sum()
    estimates = [each.estimate for each in strata]
    # MOVER: distances from the rates to their bounds are added like correlated standard errors
    correlation = correlation_of(np.array([each.spread for each in strata]))
    below = shares * np.array([each.value - each.low for each in estimates])
    above = shares * np.array([each.high - each.value for each in estimates])
    rate = float(shares @ np.array([each.value for each in estimates]))
    low = rate - float(np.sqrt(below @ correlation @ below))
    high = rate + float(np.sqrt(above @ correlation @ above))
    return Rate(n, rate, max(0.0, low), min(1.0, high))


def correlation_of(spread: np.ndarray) -> np.ndarray:
    """Correlation of estimates from their errors by world, shape (estimates, worlds); negative values are set to 0."""
    length = np.sqrt((spread**2).sum(axis=1))
    unit = spread / np.where(length > 0, length, 1.0)[:, None]
    correlation: np.ndarray = np.clip(unit @ unit.T, 0.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    return correlation


def percentiles(samples: np.ndarray) -> tuple[float, float]:
    """Central 95 % percentile interval of the finite samples; infinite if there are none."""
    finite = samples[np.isfinite(samples)]
    if len(finite) == 0:
        return float("-inf"), float("inf")
    low, high = np.quantile(finite, (TAIL, 1 - TAIL))
    return float(low), float(high)


def event_rate(events: int, hours: float) -> EventRate:
    """Rate of independent events in hours of exposure, with Garwood's exact Poisson interval."""
    if not hours > 0:
        return EventRate(events, hours, None, None, None, None)
    low = 0.0
    if events:
        low = _quantile("chi2", TAIL, 2 * events) / 2 / hours
    high = _quantile("chi2", 1 - TAIL, 2 * events + 2) / 2 / hours
    upper = _quantile("chi2", CONFIDENCE, 2 * events + 2) / 2 / hours
    return EventRate(events, hours, events / hours, low, high, upper)


def event_rate_by_flight(events: Sequence[int], hours: Sequence[float]) -> EventRate:
    """Rate of events that cluster in flights, from events and hours by flight, with a bootstrap over flights.

    The interval always includes the exact Poisson one, and equals it if there are no events.
    """
    poisson = event_rate(int(sum(events)), float(sum(hours)))
    if poisson.low is None or poisson.high is None or poisson.upper is None or not poisson.events:
        return poisson
    totals = resample(cluster_sums(range(len(events)), events, hours))
    with np.errstate(invalid="ignore", divide="ignore"):
        samples = totals[:, 0] / totals[:, 1]
    low, high = percentiles(samples)
    upper = float(np.quantile(samples[np.isfinite(samples)], CONFIDENCE))
    return replace(poisson, low=min(low, poisson.low), high=max(high, poisson.high), upper=max(upper, poisson.upper))


def smallest_difference(rate: float, first_n: int, second_n: int) -> float | None:
    """Smallest difference between two rates near `rate` that the given numbers of flights can resolve.

    Two-sided 5 % test of independent samples, normal approximation, power 80 %; pairing makes the true value somewhat
    smaller.  Rates of 0 and 1 are shifted by half a flight.  None without flights.
    """
    if min(first_n, second_n) == 0:
        return None
    margin = 0.5 / min(first_n, second_n)
    p = min(max(rate, margin), 1 - margin)
    spread = np.sqrt(p * (1 - p) * (1 / first_n + 1 / second_n))
    return float((_NORMAL.inv_cdf(1 - TAIL) + _NORMAL.inv_cdf(_POWER)) * spread)


# ---- paired comparison of settings in the same missions: McNemar's test, paired differences, and the recovery rate -


@dataclass(frozen=True, slots=True)
class Paired:
    """McNemar's exact test on pairs, with random signs of whole worlds."""

    n: int  # pairs
    first_only: int  # pairs in which only the first succeeds
    second_only: int  # pairs in which only the second succeeds
    p_value: float  # two-sided; 1 if no pair is discordant


@dataclass(frozen=True, slots=True)
class Recovery:
    """Recovery rate (method - fi) / (golden - fi) and loss (golden - fi) over pairs."""

    rate: Rate  # n: lost pairs; empty if undefined: the interval of the denominator contains 0
    loss: Estimate
    lost: int  # pairs in which golden succeeds and fi does not
    regained: int  # of these, those in which the method succeeds


def mcnemar(first: Sequence[bool], second: Sequence[bool], world: Sequence[object] | None = None) -> Paired:
    """Exact test of equal success rates of two settings, given their success in each pair.

    Pairs of one world (None = each in its own) are not independent: the signs of their differences change together
    (Fisher's randomization test).  With one pair per world it is McNemar's exact test.
    """
    pairs = list(zip(first, second, strict=True))
    first_only = sum(a and not b for a, b in pairs)
    second_only = sum(b and not a for a, b in pairs)
    worlds = range(len(pairs)) if world is None else world
    sums = cluster_sums(worlds, [float(a) - float(b) for a, b in pairs])[:, 0]
    return Paired(len(pairs), first_only, second_only, _of_random_signs([round(total) for total in sums]))


def _of_random_signs(differences: Sequence[int]) -> float:
    """Probability of a sum at least as far from 0 as the given one, if each term has a random sign."""
    chances = np.ones(1)  # of the sums -reach to reach, in steps of 1
    for size in filter(None, map(abs, differences)):
        chances = 0.5 * (np.pad(chances, (0, 2 * size)) + np.pad(chances, (2 * size, 0)))
    distance = np.abs(np.arange(len(chances)) - len(chances) // 2)
    return float(min(1.0, chances[distance >= abs(sum(differences))].sum()))


def paired_difference(
    first: Sequence[bool], second: Sequence[bool], world: Sequence[object], weight: Sequence[float] | None = None
) -> Estimate:
    """Difference of two success rates in the same missions, first - second, with MOVER's interval.

    It is the difference between the shares of pairs in which only the first and only the second succeeds.  Each share
    has Wilson's interval for the effective number of pairs; their correlation is that of multinomial shares.  Without
    discordant pairs the interval keeps the width of these two.  At least one pair is required; weights (None = equal)
    have a sum above 0.
    """
    succeeds = np.asarray(first, bool)
    other_succeeds = np.asarray(second, bool)
    weights = np.ones(len(succeeds)) if weight is None else np.asarray(weight, np.float64)
    # a and b: shares of pairs in which only the first, and only the second, succeeds
    a = StratumRate.of((succeeds & ~other_succeeds).astype(np.float64), weights, world).estimate
    b = StratumRate.of((other_succeeds & ~succeeds).astype(np.float64), weights, world).estimate
    # correlation of two shares of one multinomial sample; 1e-300 only prevents a division by 0
    odds = a.value * b.value / max((1 - a.value) * (1 - b.value), 1e-300)
    return _difference(a, b, -float(np.sqrt(min(odds, 1.0))))


def _difference(first: Estimate, second: Estimate, correlation: float) -> Estimate:
    """Difference of two correlated rates; its interval is MOVER's (Newcombe 1998; Zou and Donner 2008).

    The distances from both rates to their bounds are combined like the standard errors of the rates.
    """

    def combined(of_first: float, of_second: float) -> float:
        return float(np.sqrt(of_first**2 + of_second**2 - 2 * correlation * of_first * of_second))

    difference = first.value - second.value
    low = difference - combined(first.value - first.low, second.high - second.value)
    high = difference + combined(first.high - first.value, second.value - second.low)
    return Estimate(difference, max(-1.0, low), min(1.0, high))


def unpaired_difference(
    first: Sequence[bool], first_world: Sequence[object], second: Sequence[bool], second_world: Sequence[object]
) -> Estimate:
    """Difference of two success rates in different missions, first - second, with MOVER's interval.

    Each rate has Wilson's interval for its effective number of flights, of which at least one is required.
    """
    a = StratumRate.of(np.asarray(first, np.float64), np.ones(len(first)), first_world).estimate
    b = StratumRate.of(np.asarray(second, np.float64), np.ones(len(second)), second_world).estimate
    return replace(_difference(a, b, 0.0), value=float(a.value - b.value))


def relative_difference(
    first: Sequence[float], first_world: Sequence[object], second: Sequence[float], second_world: Sequence[object]
) -> Rate:
    """Relative difference of two means of positive values, first / second - 1; values of both may share worlds.

    The interval is that of the linearised ratio, from the contributions of worlds to its error, with Student's
    quantile for their number.  None without values; no bounds with a single world.
    """
    n = min(len(first), len(second))
    if n == 0:
        return Rate(n, None, None, None)
    worlds = [*first_world, *second_world]
    none_of_first = np.zeros(len(first))
    none_of_second = np.zeros(len(second))
    first_sums, first_counts, second_sums, second_counts = cluster_sums(
        worlds,
        np.concatenate([np.asarray(first, np.float64), none_of_second]),
        np.concatenate([none_of_first + 1.0, none_of_second]),
        np.concatenate([none_of_first, np.asarray(second, np.float64)]),
        np.concatenate([none_of_first, none_of_second + 1.0]),
    ).T
    ratio = float(first_sums.sum() / first_counts.sum() / (second_sums.sum() / second_counts.sum()))
    if len(first_sums) < 2:
        return Rate(n, ratio - 1, None, None)
    first_errors = first_sums / first_sums.sum() - first_counts / first_counts.sum()
    second_errors = second_sums / second_sums.sum() - second_counts / second_counts.sum()
    # contribution of each world to the error of the linearised ratio
    errors = ratio * (first_errors - second_errors)
    worlds_count = len(errors)
    variance = worlds_count / (worlds_count - 1) * float(errors @ errors)
    half_width = _quantile("t", 1 - TAIL, worlds_count - 1) * float(np.sqrt(variance))
    return Rate(n, ratio - 1, ratio - 1 - half_width, ratio - 1 + half_width)


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
    golden, fi, method = np.array([successes for _, *successes in pairs], bool).T
    loss = paired_difference(golden.tolist(), fi.tolist(), worlds)
    is_lost = golden & ~fi
    lost = int(is_lost.sum())
    regained = int((is_lost & method).sum())
    if loss.low <= 0:
        return Recovery(Rate(lost, None, None, None), loss, lost, regained)
    gain = float(np.mean(method.astype(np.float64) - fi))

    # Clopper and Pearson's interval for the effective number of lost pairs
    lost_worlds = [world for world, flag in zip(worlds, is_lost, strict=True) if flag]
    clustered = StratumRate.of(method[is_lost].astype(np.float64), np.ones(lost), lost_worlds)
    hits = clustered.rate * clustered.effective
    low, high = exact_bounds(hits, clustered.effective - hits)
    if np.any(fi & ~golden) or np.any((method != fi) & ~is_lost):
        # the rate is no proportion of the lost missions any more: widen by a bootstrap of worlds
        totals = resample(cluster_sums(worlds, golden, fi, method))
        with np.errstate(invalid="ignore", divide="ignore"):
            sampled_low, sampled_high = percentiles((totals[:, 2] - totals[:, 1]) / (totals[:, 0] - totals[:, 1]))
        low = min(low, sampled_low)
        high = max(high, sampled_high)
    return Recovery(Rate(lost, gain / loss.value, low, high), loss, lost, regained)
