"""Randomization tests on the means of worlds: worlds are independent, flights within a world are not.

The null distribution comes from random signs of each world's difference, or from permutations of worlds between two
groups (Fisher's randomization test, exact for few worlds), so the tests are distribution-free.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import polars as pl
import scipy

from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.statistics import cluster_sums, clustered_rate, percentiles, resample

_RESAMPLES = 9999
_SEED = 20


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean over runs, with its 95 % interval: Wilson's of a rate, else a bootstrap of worlds; None in one world."""

    value: float
    n: int  # runs
    bounds: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Difference:
    """A difference of means, first - second, and its p value."""

    first: Mean
    second: Mean
    worlds: int  # in the test
    difference: float  # first - second, mean over worlds
    p_value: float | None  # two-sided; None = fewer than two worlds
    behind: tuple[str, ...]  # ids of the runs with a value


def within_worlds(first: Runs, second: Runs, value: pl.Expr) -> Difference | None:
    """Compare two groups of runs in the same worlds, with random signs of each world's difference.

    Runs with a null value are excluded; None if the groups share no world.
    """
    one, other = _by_world(first, value), _by_world(second, value)
    shared = [world for world in one if world in other]
    if not shared:
        return None
    differences = np.array([np.mean(one[world]) - np.mean(other[world]) for world in shared])
    p_value = _p_value((differences,), np.mean, "samples")
    return _compared(first, second, value, len(shared), float(differences.mean()), p_value)


def between_worlds(first: Runs, second: Runs, value: pl.Expr) -> Difference | None:
    """Compare two groups of runs in different worlds, with worlds permuted between them; None if a group is empty."""
    one, other = _by_world(first, value), _by_world(second, value)
    if not one or not other:
        return None
    means = tuple(np.array([np.mean(values) for values in part.values()]) for part in (one, other))
    difference = float(means[0].mean() - means[1].mean())
    p_value = _p_value(means, _difference, "independent")
    return _compared(first, second, value, len(one) + len(other), difference, p_value)


def _compared(
    first: Runs, second: Runs, value: pl.Expr, worlds: int, difference: float, p_value: float | None
) -> Difference:  # fmt: skip
    ids = (part.where(value.is_not_null()).ids for part in (first, second))
    behind = tuple(dict.fromkeys(run_id for part in ids for run_id in part))
    return Difference(_mean(first, value), _mean(second, value), worlds, difference, p_value, behind)


def _difference(first: np.ndarray, second: np.ndarray, axis: int = -1) -> np.ndarray:
    difference: np.ndarray = np.mean(first, axis=axis) - np.mean(second, axis=axis)
    return difference


def _by_world(runs: Runs, value: pl.Expr) -> dict[str, list[float]]:
    rows = runs.frame.select("world", value=value.cast(pl.Float64)).drop_nulls()
    parts = rows.partition_by("world", maintain_order=True, as_dict=True)
    return {str(world): part["value"].to_list() for (world,), part in parts.items()}


def _mean(runs: Runs, value: pl.Expr) -> Mean:
    rows = runs.frame.select("world", value=value).drop_nulls()
    worlds, values = rows["world"].to_list(), rows["value"].cast(pl.Float64).to_numpy()
    bounds = None
    if rows["world"].n_unique() > 1 and rows["value"].dtype == pl.Boolean:
        rate = clustered_rate(rows["value"].to_list(), worlds)
        bounds = (rate.low or 0.0, rate.high or 0.0)
    elif rows["world"].n_unique() > 1:
        totals = resample(cluster_sums(worlds, values, np.ones(len(values))))
        bounds = percentiles(totals[:, 0] / totals[:, 1])
    return Mean(float(values.mean()), len(values), bounds)


def _p_value(data: tuple[np.ndarray, ...], statistic: Callable[..., np.ndarray], kind: str) -> float | None:
    """Two-sided p value of a randomization test (deterministic); None with fewer than two worlds in a group."""
    if any(len(part) < 2 for part in data):
        return None
    if not any(part.any() for part in data):
        return 1.0
    found = scipy.stats.permutation_test(
        data, statistic, permutation_type=kind, vectorized=True, n_resamples=_RESAMPLES,
        rng=np.random.default_rng(_SEED),
    )  # fmt: skip
    return float(min(1.0, found.pvalue))
