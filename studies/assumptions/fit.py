"""How well a reading agrees with the paper's counts: deviance of two binomial samples, by environment and cell.

Both sides are samples: the paper's of 100 golden runs and 300 runs with a fault per environment, ours with the
effective number of runs, n / design effect of worlds.  What loses golden runs besides the fault is a nuisance parameter
of each environment, fitted to the paper's golden and injection cells together.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from mavfi.analysis import published as paper
from mavfi.analysis.statistics import StratumRate, percentiles
from studies.assumptions.design import AxisValue

GOLDEN_N = 100
FAULT_N = 300
"""Runs of the paper per environment: golden, and of each setting with a fault."""
_GRID = np.linspace(0.0005, 0.9995, 1000)
"""Success rates at which a likelihood is evaluated."""
_BACKGROUNDS = np.linspace(0.70, 1.0, 61)
"""Shares of missions that the background leaves."""
_RESAMPLES = 200
_SIMULATIONS = 4000
_SEED = 20


class Counts(NamedTuple):
    """Successes among runs; both may be fractional, as effective numbers are."""

    successes: float
    n: float

    @property
    def rate(self) -> float:
        """Share of successes; NaN without runs."""
        if self.n:
            return self.successes / self.n
        return float("nan")


@dataclass(frozen=True, slots=True)
class Flights:
    """Runs of one setting in one environment, as arrays of equal length.

    Attributes:
        success: Whether the goal was reached.
        died: Whether the kernel that the fault hit died.
        seconds: Flight time (s).
        worlds: World of each run.
    """

    success: np.ndarray
    died: np.ndarray
    seconds: np.ndarray
    worlds: np.ndarray

    def plus(self, other: "Flights") -> "Flights":
        """Both together."""
        return Flights(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in self.__slots__))

    def part(self, rows: np.ndarray) -> "Flights":
        """The flights of some rows: a mask, or indices."""
        return Flights(*(getattr(self, name)[rows] for name in self.__slots__))

    def counts(self, deaths: str = "restart", limit_s: float = np.inf) -> Counts:
        """Successes and effective n.

        Args:
            deaths: "restart" counts a dead kernel as flown, "end" as a lost mission, "not_counted" not at all.
            limit_s: Time limit (s).
        """
        success = self.success & (self.seconds <= limit_s)
        worlds = self.worlds
        if deaths == "end":
            success = success & ~self.died
        if deaths == "not_counted":
            success = success[~self.died]
            worlds = worlds[~self.died]
        if not len(success):
            return Counts(0.0, 0.0)
        rate = StratumRate.of(success.astype(np.float64), np.ones(len(success)), worlds.tolist())
        return Counts(rate.rate * rate.effective, rate.effective)


class EnvironmentFlights(NamedTuple):
    """Golden runs of an environment, and runs with a fault by setting."""

    golden: Flights
    faulty: Mapping[str, Flights]

    def plus(self, other: "EnvironmentFlights") -> "EnvironmentFlights":
        """Both together; with the same settings."""
        faulty = {setting: flights.plus(other.faulty[setting]) for setting, flights in self.faulty.items()}
        return EnvironmentFlights(self.golden.plus(other.golden), faulty)

    def resampled(self, random: np.random.Generator) -> "EnvironmentFlights":
        """A bootstrap sample of worlds, each with its golden run and all its runs with a fault."""
        worlds = np.unique(self.golden.worlds)
        drawn = random.choice(worlds, len(worlds))
        parts = [self.golden, *self.faulty.values()]
        rows = [np.concatenate([np.flatnonzero(part.worlds == world) for world in drawn]) for part in parts]
        samples = [part.part(row) for part, row in zip(parts, rows, strict=True)]
        return EnvironmentFlights(samples[0], dict(zip(self.faulty, samples[1:], strict=True)))


def paper_counts(environment: str, setting: str) -> Counts:
    """The paper's successes of a cell of Table I, from its rate and number of runs."""
    n = FAULT_N
    if setting == "golden":
        n = GOLDEN_N
    return Counts(round(n * paper.figure("success", environment=environment, setting=setting)), n)


def deviance(counts: Counts, rate: np.ndarray | float) -> np.ndarray:
    """Binomial deviance of counts from a rate; the same shape as the rate."""
    expected = np.clip(np.asarray(rate, np.float64), 1e-9, 1 - 1e-9)
    observed = counts.rate
    successes = scipy.special.rel_entr(observed, expected)
    failures = scipy.special.rel_entr(1 - observed, 1 - expected)
    result: np.ndarray = 2 * counts.n * (successes + failures)
    return result


def pair_deviance(ours: Counts, papers: Counts, background: float = 1.0) -> float:
    """Least deviance of two samples whose rates are r and background x r, over r."""
    if not ours.n:
        return float("inf")
    return float(np.min(deviance(ours, _GRID) + deviance(papers, background * _GRID)))


@dataclass(frozen=True, slots=True)
class EnvironmentFit:
    """Fit of golden and injection cell of one environment.

    Attributes:
        deviances: Least deviance for each value of the nuisance parameter.
        values: These values: share of missions that the background leaves, or time limit (s); a single one if fixed.
    """

    deviances: np.ndarray
    values: np.ndarray

    @property
    def best(self) -> float:
        """The value that fits best."""
        return float(self.values[np.argmin(self.deviances)])

    @property
    def weights(self) -> np.ndarray:
        """Relative likelihood of the values; sums to 1."""
        weights = np.exp(-(self.deviances - self.deviances.min()) / 2)
        result: np.ndarray = weights / weights.sum()
        return result


def fit_environment(environment: str, flights: EnvironmentFlights, deaths: str, losses: str) -> EnvironmentFit:
    """Fit one environment; `deaths` and `losses` as in `AxisValue`."""
    golden = paper_counts(environment, "golden")
    faulty = paper_counts(environment, "fi")
    ours = flights.faulty["fi"]
    if losses == "time_limit":
        # between any two neighbouring arrivals of golden runs, and no limit
        arrivals = np.unique(flights.golden.seconds[flights.golden.success])
        values = np.append(arrivals + 1e-6, np.inf)
        deviances = [
            pair_deviance(flights.golden.counts(limit_s=limit), golden)
            + pair_deviance(ours.counts(deaths, limit), faulty)
            for limit in values
        ]
        return EnvironmentFit(np.array(deviances), values)
    backgrounds = np.ones(1)
    if losses == "background":
        backgrounds = _BACKGROUNDS
    golden_counts = flights.golden.counts()
    counts = ours.counts(deaths)
    deviances = [
        pair_deviance(golden_counts, golden, background) + pair_deviance(counts, faulty, background)
        for background in backgrounds
    ]
    return EnvironmentFit(np.array(deviances), backgrounds)


@dataclass(frozen=True, slots=True)
class Fit:
    """Fit of a reading to the paper's eight golden and injection cells.

    Attributes:
        environments: By environment.
        parameters: Number of fitted nuisance parameters.
    """

    environments: Mapping[str, EnvironmentFit]
    parameters: int

    @property
    def deviance(self) -> float:
        """Sum over environments."""
        return float(sum(fit.deviances.min() for fit in self.environments.values()))

    @property
    def freedom(self) -> int:
        """Degrees of freedom: cells - parameters."""
        return 2 * len(self.environments) - self.parameters

    @property
    def p_value(self) -> float:
        """Probability of a larger deviance if both are samples of the same rates."""
        return float(scipy.stats.chi2.sf(self.deviance, self.freedom))

    @property
    def criterion(self) -> float:
        """Akaike's criterion, up to a constant: deviance + 2 x parameters."""
        return self.deviance + 2 * self.parameters


def fit(flights: Mapping[str, EnvironmentFlights], deaths: AxisValue, losses: AxisValue) -> Fit:
    """Fit a reading's flights, by environment of the paper, counted in this way."""
    fits = {name: fit_environment(name, part, deaths.deaths, losses.losses) for name, part in flights.items()}
    parameters = 0
    if losses.losses != "flown":
        parameters = len(fits)
    return Fit(fits, parameters)


def deviance_interval(
    flights: Mapping[str, EnvironmentFlights], deaths: AxisValue, losses: AxisValue
) -> tuple[float, float]:
    """95 % interval of a reading's deviance: bootstrap of worlds."""
    random = np.random.default_rng(_SEED)
    samples = []
    for _ in range(_RESAMPLES):
        resampled = {name: part.resampled(random) for name, part in flights.items()}
        samples.append(fit(resampled, deaths, losses).deviance)
    return percentiles(np.array(samples))


class PointsDifference(NamedTuple):
    """A difference in percentage points, with its 95 % interval."""

    points: float
    low: float
    high: float


def lost_points(flights: EnvironmentFlights, setting: str = "fi", deaths: str = "restart") -> PointsDifference:
    """Golden success - success of a setting, in points, with a bootstrap of worlds."""
    random = np.random.default_rng(_SEED)

    def points(sample: EnvironmentFlights) -> float:
        return 100 * (sample.golden.counts().rate - sample.faulty[setting].counts(deaths).rate)

    samples = np.array([points(flights.resampled(random)) for _ in range(_RESAMPLES)])
    return PointsDifference(points(flights), *percentiles(samples[np.isfinite(samples)]))


# ---- prediction of cells that were not fitted ------------------------------------------------------------------------
class PredictedCell(NamedTuple):
    """A cell of the paper's Table I beside what a frozen reading predicts for it.

    Attributes:
        paper: The paper's success rate.
        mean: Predicted success rate.
        low: Lower bound of the 95 % prediction interval of the paper's rate.
        high: Upper bound.
        ours: Success rate of our runs, before the background.
        n: Number of our runs.
    """

    paper: float
    mean: float
    low: float
    high: float
    ours: float
    n: int


@dataclass(frozen=True, slots=True)
class Judgement:
    """A frozen reading judged on the detector cells.

    Attributes:
        cells: By environment and setting.
        deviance: Of the paper's counts from the predicted rates.
        p_value: Probability of a larger deviance under the prediction.
    """

    cells: Mapping[tuple[str, str], PredictedCell]
    deviance: float
    p_value: float


def judge(
    frozen: Fit,
    flights: Mapping[str, EnvironmentFlights],
    deaths: AxisValue,
    losses: AxisValue,
    settings: Mapping[str, str],
) -> Judgement:
    """Compare the paper's detector cells with what a frozen reading predicts for as many runs as the paper flew.

    The prediction includes the uncertainty of the nuisance parameters, as far as the fitted cells leave them open, that
    of our rates, and that of the paper's samples.

    Args:
        frozen: Fit of the reading.
        flights: Fresh flights, by environment.
        deaths: How dead kernels are counted.
        losses: What loses golden runs.
        settings: Setting of our runs, by setting of the paper.
    """
    random = np.random.default_rng(_SEED)
    cells = {}
    observed = []
    simulated = []
    for environment, part in flights.items():
        fitted = frozen.environments[environment]
        nuisance = random.choice(fitted.values, _SIMULATIONS, p=fitted.weights)
        for papers, setting in settings.items():
            target = paper_counts(environment, papers)
            ours = part.faulty[setting]
            rates = _sampled_rates(ours, deaths.deaths, losses.losses, nuisance, random)
            replicas = random.binomial(int(target.n), rates) / target.n
            mean = float(rates.mean())
            low, high = percentiles(replicas)
            cells[environment, papers] = PredictedCell(
                target.rate, mean, low, high, ours.counts(deaths.deaths).rate, len(ours.success)
            )
            observed.append(float(deviance(target, mean)))
            simulated.append([float(deviance(Counts(rate * target.n, target.n), mean)) for rate in replicas])
    total = np.sum(simulated, axis=0)
    # a p value of simulations counts the observation itself
    exceeding = int(np.sum(total >= sum(observed)))
    return Judgement(cells, sum(observed), (exceeding + 1) / (_SIMULATIONS + 1))


def _sampled_rates(
    flights: Flights, deaths: str, losses: str, nuisance: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Success rates that are compatible with our runs (Jeffreys' posterior), one for each value of the nuisance."""
    if losses == "time_limit":
        by_limit = {limit: flights.counts(deaths, limit) for limit in np.unique(nuisance)}
        successes = np.array([by_limit[limit].successes for limit in nuisance])
        n = np.array([by_limit[limit].n for limit in nuisance])
        return random.beta(successes + 0.5, n - successes + 0.5)
    counts = flights.counts(deaths)
    rates = random.beta(counts.successes + 0.5, counts.n - counts.successes + 0.5, len(nuisance))
    result: np.ndarray = nuisance * rates
    return result
