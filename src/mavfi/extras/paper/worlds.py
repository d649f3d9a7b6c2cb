"""Randomization tests on the means of worlds: worlds are independent, flights within a world are not.

The null distribution comes from random signs of each world's difference, or from permutations of worlds between two
groups (Fisher's randomization test, exact for few worlds), so the tests are distribution-free.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import polars as pl
import scipy

from mavfi.analysis.measures import Measure
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import (
    Rate,
    cluster_sums,
    clustered_rate,
    draws,
    percentiles,
    resample,
)

_RESAMPLES = 9999
_SEED = 20
_MAX_ENTRIES = 1_000_000
"""Largest number of values in the samples that are in memory at once."""


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean over runs, with its 95 % interval: Wilson's of a rate, else a bootstrap of worlds; None in one world."""

    value: float
    n: int  # runs
    bounds: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class MeanDifference:
    """A difference of means, first - second, and its p value."""

    first: Mean
    second: Mean
    worlds: int  # in the test
    difference: float  # first - second, mean over worlds
    p_value: float | None  # two-sided; None = fewer than two worlds
    behind: tuple[str, ...]  # ids of the runs with a value


def within_worlds(first: Runs, second: Runs, value: pl.Expr, *, by: str = "world") -> MeanDifference | None:
    """Compare two groups of runs in the same worlds, with random signs of each world's difference.

    `by` names the column that identifies the world.  Runs with a null value are excluded; None if the groups share no
    world.
    """
    first_values = _by_world(first, value, by)
    second_values = _by_world(second, value, by)
    shared = [world for world in first_values if world in second_values]
    if not shared:
        return None
    differences = np.array([np.mean(first_values[world]) - np.mean(second_values[world]) for world in shared])
    p_value = _p_value((differences,), np.mean, "samples")
    return _difference_of(first, second, value, len(shared), float(differences.mean()), p_value)


def between_worlds(first: Runs, second: Runs, value: pl.Expr) -> MeanDifference | None:
    """Compare two groups of runs in different worlds, with worlds permuted between them; None if a group is empty."""
    first_values = _by_world(first, value)
    second_values = _by_world(second, value)
    if not first_values or not second_values:
        return None
    first_means = np.array([np.mean(values) for values in first_values.values()])
    second_means = np.array([np.mean(values) for values in second_values.values()])
    difference = float(first_means.mean() - second_means.mean())
    p_value = _p_value((first_means, second_means), _difference, "independent")
    return _difference_of(first, second, value, len(first_values) + len(second_values), difference, p_value)


def _difference_of(
    first: Runs, second: Runs, value: pl.Expr, worlds: int, difference: float, p_value: float | None
) -> MeanDifference:
    ids = (part.where(value.is_not_null()).ids for part in (first, second))
    behind = tuple(dict.fromkeys(run_id for part in ids for run_id in part))
    return MeanDifference(_mean(first, value), _mean(second, value), worlds, difference, p_value, behind)


CONTRAST = "[95 % interval]: bootstrap of worlds; p: randomization test, settings swapped in whole worlds"
"""Note below tables with contrasts."""


@dataclass(frozen=True, slots=True)
class Contrast(Rate):
    """A contrast of quantiles, e.g. a difference (`rate`), with its 95 % interval and p value; n: worlds."""

    p_value: float | None = None  # two-sided; None = fewer than two worlds


def contrast(
    groups: Sequence[Runs], column: str, share: float, of: Callable[..., Any], *, by: str = "world"
) -> Contrast | None:
    """Contrast the quantiles of groups of runs in the same worlds.

    The interval is a bootstrap of worlds, each with its runs of all groups.  The p value is that of the difference of
    the first two groups, which are swapped in whole worlds; it holds for a maximum, too, whose bootstrap is too narrow.

    Args:
        groups: Two groups or more; runs with a null value are excluded.
        column: With the values.
        share: Of the quantile; 1 = the maximum.
        of: Contrast of the quantiles, one argument per group: numbers, or arrays of shape (samples,).
        by: Column that identifies the world.

    Returns:
        None if a group is empty.
    """
    # All runs in ascending order of the value, each with its group and world.
    parts = [group.frame.select(by, value=column, group=pl.lit(index)) for index, group in enumerate(groups)]
    rows = pl.concat(parts).drop_nulls().sort("value")
    values = rows["value"].to_numpy()
    group = rows["group"].to_numpy()
    if set(group) != set(range(len(groups))):
        return None
    world_index = {world: index for index, world in enumerate(rows[by].unique(maintain_order=True))}
    world = np.array([world_index[name] for name in rows[by]])

    def group_quantiles(counts: np.ndarray, membership: np.ndarray) -> list[np.ndarray]:
        """Quantiles of each group, by sample; `counts`: how often each run is in each sample."""
        return [quantiles(values, counts * (membership == index), share) for index in range(len(groups))]

    def swapped(signs: np.ndarray, axis: int = -1) -> np.ndarray:
        """Difference of the first two groups, exchanged in the worlds whose sign is negative."""
        del axis  # SciPy names the last one
        flipped = (np.atleast_2d(signs)[:, world] < 0) & (group < 2)
        first, second, *_ = group_quantiles(np.ones(flipped.shape, np.int32), np.where(flipped, 1 - group, group))
        difference: np.ndarray = (first - second).reshape(signs.shape[:-1])
        return difference

    # A sample may lack every world of a group: its contrast is NaN, and no part of the interval.
    with np.errstate(invalid="ignore", divide="ignore"):
        low, high = percentiles(of(*group_quantiles(draws(len(world_index))[:, world], group)))
        value = float(of(*group_quantiles(np.ones((1, len(values)), np.int32), group))[0])
    p_value = _p_value((np.ones(len(world_index)),), swapped, "samples", batch=max(1, _MAX_ENTRIES // len(values)))
    return Contrast(len(world_index), value, low, high, None, p_value)


def contrast_measure(  # noqa: PLR0913 - what `Measure` and `contrast` take
    key: str,
    heading: str,
    form: str,
    groups: Callable[[Runs], Sequence[Runs]],
    column: str,
    share: float,
    of: Callable[..., Any],
    *,
    by: str = "world",
) -> Measure:
    """A column of contrasts; `groups` maps the rows of a group to the compared ones, none = no cell."""

    def counted(runs: Runs) -> Runs:
        compared_groups = groups(runs)
        if compared_groups:
            return replace(runs, frame=pl.concat([part.frame for part in compared_groups]))
        return runs

    def cell(runs: Runs) -> Contrast | None:
        compared_groups = groups(runs)
        if compared_groups:
            return contrast(compared_groups, column, share, of, by=by)
        return None

    return Measure(key, heading, form, cell, counted=counted)


def quantiles(values: np.ndarray, counts: np.ndarray, share: float) -> np.ndarray:
    """Quantiles of samples that hold each value several times, interpolated linearly; NaN of empty samples.

    Args:
        values: In ascending order. Shape (n,).
        counts: How often each value is in each sample. Shape (samples, n).
        share: 0 to 1.

    Returns:
        Shape (samples,).
    """
    cumulative = counts.cumsum(axis=1)
    size = cumulative[:, -1]
    position = share * np.maximum(size - 1, 0)  # of the quantile in the sorted sample, fractional

    def value_at(index: np.ndarray) -> np.ndarray:
        """The value at an index of each sorted sample: the first one whose cumulative count exceeds the index."""
        value: np.ndarray = values[np.minimum((cumulative <= index[:, None]).sum(axis=1), len(values) - 1)]
        return value

    low = value_at(np.floor(position))
    high = value_at(np.ceil(position))
    interpolated = low + (position - np.floor(position)) * (high - low)
    result: np.ndarray = np.where(size > 0, interpolated, np.nan)
    return result


def _difference(first: np.ndarray, second: np.ndarray, axis: int = -1) -> np.ndarray:
    """Difference of means, the statistic of `between_worlds`."""
    difference: np.ndarray = np.mean(first, axis=axis) - np.mean(second, axis=axis)
    return difference


def _by_world(runs: Runs, value: pl.Expr, by: str = "world") -> dict[str, list[float]]:
    """Values of the runs of each world."""
    rows = runs.frame.select(by, value=value.cast(pl.Float64)).drop_nulls()
    parts = rows.partition_by(by, maintain_order=True, as_dict=True)
    return {str(world): part["value"].to_list() for (world,), part in parts.items()}


def _mean(runs: Runs, value: pl.Expr) -> Mean:
    """The mean of a value over runs, with its interval."""
    rows = runs.frame.select("world", value=value).drop_nulls()
    worlds = rows["world"].to_list()
    values = rows["value"].cast(pl.Float64).to_numpy()
    bounds = None
    if rows["world"].n_unique() > 1 and rows["value"].dtype == pl.Boolean:
        rate = clustered_rate(rows["value"].to_list(), worlds)
        bounds = (rate.low or 0.0, rate.high or 0.0)
    elif rows["world"].n_unique() > 1:
        totals = resample(cluster_sums(worlds, values, np.ones(len(values))))
        bounds = percentiles(totals[:, 0] / totals[:, 1])
    return Mean(float(values.mean()), len(values), bounds)


def _p_value(
    data: tuple[np.ndarray, ...], statistic: Callable[..., np.ndarray], kind: str, batch: int | None = None
) -> float | None:
    """Two-sided p value of a randomization test (deterministic); None with fewer than two worlds in a group."""
    if any(len(part) < 2 for part in data):
        return None
    if not any(part.any() for part in data):
        return 1.0
    result = scipy.stats.permutation_test(
        data,
        statistic,
        permutation_type=kind,
        vectorized=True,
        n_resamples=_RESAMPLES,
        batch=batch,
        rng=np.random.default_rng(_SEED),
    )
    return float(min(1.0, result.pvalue))
