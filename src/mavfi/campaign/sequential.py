"""Sequential sampling: missions are flown until the success rates of a table reach a target half-width.

The bounds form a confidence sequence: with probability 95 % they contain the true rate at all sample sizes
simultaneously, so optional stopping preserves coverage.  It is the beta-binomial mixture (Robbins 1970; Howard, Ramdas,
McAuliffe and Sekhon 2021, "Time-uniform, nonparametric, nonasymptotic confidence sequences", sub-Bernoulli case).  An
observation is the share of successes of one mission in one cell, between 0 and 1: flights in one world are correlated,
worlds are independent.  For such shares the likelihood ratio remains a supermartingale, by convexity.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from mavfi.campaign.config import MOST_FAULTS, Campaign
from mavfi.campaign.plan import RunSpec
from mavfi.campaign.shard import WHOLE, Shard
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.faults.strata import HEADLINE, SIGN_EXPONENT
from mavfi.flight_record import End
from mavfi.mission import MissionStatus

ALPHA = 0.05
_PRIOR = 0.5
"""Both parameters of the beta mixture (Jeffreys): widths are similar near 0 and 1 and in between."""
_HALVINGS = 50
_RATES = 501
"""Number of rates in the search for the widest sequence."""
Cell = tuple[str, str, str]
"""Setting, target and stratum; "" = pooled."""


def log_mixture(total: Any, n: Any, rate: Any) -> Any:
    """Log likelihood ratio of the mixture against a rate; the rate is in the sequence while it is below log(1 / ALPHA).

    Args:
        total: Sum of n observations between 0 and 1; arrays broadcast.
        n: Number of observations.
        rate: Rate to test, from 0 to 1.
    """
    special = scipy.special
    mixed = special.betaln(_PRIOR + total, _PRIOR + n - total) - special.betaln(_PRIOR, _PRIOR)
    return mixed - special.xlogy(total, rate) - special.xlog1py(n - total, -np.asarray(rate))


def sequence_bounds(total: Any, n: Any) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds of the 95 % confidence sequence (arguments: see `log_mixture`); 0 and 1 for n = 0."""
    total, n = np.broadcast_arrays(np.asarray(total, np.float64), np.asarray(n, np.float64))
    mean = np.where(n > 0, total / np.maximum(n, 1), 0.5)
    return _bound(total, n, mean, 0.0), _bound(total, n, mean, 1.0)


def _bound(total: np.ndarray, n: np.ndarray, inside: np.ndarray, outside: float) -> np.ndarray:
    """Find a bound by bisection between the mean, which is in the sequence, and an end of the unit interval."""
    far = np.full_like(inside, outside)
    near = inside.astype(np.float64)
    for _ in range(_HALVINGS):
        middle = (near + far) / 2
        held = log_mixture(total, n, middle) < np.log(1 / ALPHA)
        near, far = np.where(held, middle, near), np.where(held, far, middle)
    return far  # conservative: outside the sequence


def half_width(total: Any, n: Any) -> np.ndarray:
    """Half-width of the confidence sequence; arguments: see `log_mixture`."""
    low, high = sequence_bounds(total, n)
    found: np.ndarray = (high - low) / 2
    return found


def missions_needed(target: float) -> int:
    """Number of missions after which the half-width is at most `target` for any rate."""

    def enough(n: int) -> bool:  # with few missions, a rate of 0.5 is not the widest
        return bool(half_width(n * np.linspace(0.5, 1.0, _RATES), n).max() <= target)

    low, high = 1, 2
    while not enough(high):
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def until(campaign: Campaign, target: float) -> Campaign:
    """The campaign with the most missions that a half-width can require, and its number of faults per mission.

    An environment ends earlier once all its rates are known to the half-width.

    Raises:
        BadInputError: The campaign would need more than `MOST_FAULTS` faults per target.
    """
    missions = missions_needed(target)
    faults = -(-campaign.faults * missions // campaign.missions)
    if faults > MOST_FAULTS:
        raise BadInputError(
            f"campaign {campaign.name}: half-width {target:g}: needs up to {faults} faults per target; allowed: "
            f"{MOST_FAULTS}, so a larger half-width"
        )
    return campaign.model_copy(update={"until_halfwidth": target, "missions": missions, "faults": faults})


@dataclass(slots=True)
class Precision:
    """Precision of the success rates of a campaign, from the missions in its ledger."""

    campaign: Campaign
    store: Store
    _sums: dict[str, dict[Cell, tuple[float, int]]] = field(default_factory=dict)  # total and n, by environment
    _read: dict[str, int] = field(default_factory=dict)  # missions included in the sums, by environment
    _widest: dict[str, float] = field(default_factory=dict)  # largest half-width, by environment

    @staticmethod
    def of(campaign: Campaign, store: Store, shard: Shard) -> "Precision | None":
        """The stopping rule of a campaign; None = fixed number of missions.

        Raises:
            BadInputError: The campaign is sharded: a shard has no access to the missions of the others.
        """
        if campaign.until_halfwidth is None:
            return None
        if shard != WHOLE:
            raise BadInputError(f"shard {shard}: not with until_halfwidth; allowed: the whole campaign")
        return Precision(campaign, store)

    def met(self, environment: str) -> bool:
        """Whether all rates of an environment have reached the campaign's target half-width.

        Only missions before the first incomplete one count, so the order of completion cannot bias the selection.
        """
        self._add(environment)
        return self._widest[environment] <= float(self.campaign.until_halfwidth or 0.0)

    def expected(self) -> int:
        """Estimated total number of missions, as the half-width scales with the inverse square root of their number."""
        total = 0
        for environment in self.campaign.environments:
            self._add(environment)
            ratio = self._widest[environment] / float(self.campaign.until_halfwidth or 1.0)
            flown = self._read[environment]
            total += min(self.campaign.missions, max(flown, round(max(1, flown) * ratio**2)))
        return total

    def rows(self) -> Iterator[dict[str, Any]]:
        """Environment, setting, target, stratum, n (missions), mean and bounds of each rate."""
        for environment in self.campaign.environments:
            self._add(environment)
            for (setting, target, stratum), (total, n) in self._sums[environment].items():
                low, high = sequence_bounds(total, n)
                yield {
                    "environment": environment, "setting": setting, "target": target, "stratum": stratum, "n": n,
                    "mean": total / n, "low": float(low), "high": float(high),
                }  # fmt: skip

    def _add(self, environment: str) -> None:
        sums, seeds = self._sums.setdefault(environment, {}), self.campaign.seeds
        before = read = self._read.setdefault(environment, 0)
        self._widest.setdefault(environment, 1.0)
        while read < len(seeds) and self.store.is_complete((environment, seeds[read])):
            for cell, outcomes in self._outcomes(environment, seeds[read]).items():
                total, n = sums.get(cell, (0.0, 0))
                sums[cell] = total + sum(outcomes) / len(outcomes), n + 1
            read += 1
        if read > before:
            totals, counts = np.array(list(sums.values())).T
            self._read[environment], self._widest[environment] = read, float(half_width(totals, counts).max())

    def _outcomes(self, environment: str, seed: int) -> dict[Cell, list[bool]]:
        found: dict[Cell, list[bool]] = {}
        for run in self.store.runs(done=True, world=(environment, seed)):
            cell = cell_of(self.campaign, run.spec)
            if cell is not None and run.record is not None and run.record.end is not End.UNKNOWN:
                found.setdefault(cell, []).append(run.record.status == MissionStatus.SUCCESS.label)
        return found


def cell_of(campaign: Campaign, spec: RunSpec) -> Cell | None:
    """The cell in which a run counts; None = none, e.g. null runs, and bits outside the leading stratum."""
    sampling = campaign.sampling
    if spec.kind == "null":
        return None
    if spec.fault is None:
        return spec.setting, "", ""
    strata = list(getattr(sampling, "strata", None) or ())
    apart = bool(getattr(sampling, "groups", ())) or getattr(sampling, "share", "") == "kernel"
    if HEADLINE in strata or (apart and len(strata) > 1):
        if spec.fault.stratum not in SIGN_EXPONENT:
            return None
    elif len(strata) > 1:
        return spec.setting, "", spec.fault.stratum
    return spec.setting, spec.target if apart else "", ""
