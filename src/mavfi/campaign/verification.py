"""Flies a random share of a ledger's runs again, and says what follows for all of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import beta

from mavfi.campaign.replay import fly_again
from mavfi.campaign.store import Run, Store
from mavfi.errors import BadInputError
from mavfi.flight_record import FlightRecord

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Verification:
    """What came out.

    Attributes:
        runs: Done runs that can be flown again.
        flown: How many were.
        differing: Those of which another record came out.
    """

    runs: int
    flown: int
    differing: tuple[str, ...]

    @property
    def upper_bound(self) -> float:
        """Share of wrong records that is not exceeded, with 95 % confidence (Clopper and Pearson 1934, one-sided)."""
        wrong = len(self.differing)
        return 1.0 if wrong == self.flown else float(beta.ppf(CONFIDENCE, wrong + 1, self.flown - wrong))


def verify(
    directory: Path, share: float, seed: int = 0, progress: Callable[[int, int], None] | None = None
) -> Verification:  # fmt: skip
    """Fly a random share of the runs again, at least one, and compare their records byte for byte.

    Left out are runs without a flight, and those whose faults are not replayable and say so.

    Args:
        directory: Of the ledger.
        share: In (0, 1].
        seed: Of the choice.
        progress: Called with the number of runs that are done, and of all.

    Raises:
        BadInputError: No such ledger, nothing in it can be flown again, or the share is not in its range.
    """
    if not 0.0 < share <= 1.0:
        raise BadInputError(f"--share: {share}: allowed: above 0, 1 at most")
    with Store.open(directory) as store:
        runs = [run for run in store.runs(done=True) if _is_replayable(run)]
        if not runs:
            raise BadInputError(f"{directory}: no run is done that can be flown again")
        number = max(1, round(share * len(runs)))
        chosen = np.sort(np.random.default_rng(seed).choice(len(runs), number, replace=False))
        differing = []
        for done, place in enumerate(chosen):
            if progress is not None:
                progress(done, number)
            if _again(store, runs[place]) != runs[place].record:
                differing.append(runs[place].spec.run_id)
    return Verification(len(runs), number, tuple(differing))


def _is_replayable(run: Run) -> bool:
    record = run.record
    return record is not None and record.flown and all(i.details.get("replayable", True) for i in record.injections)


def _again(store: Store, run: Run) -> FlightRecord:
    """Record of the run, flown now; what a golden run counts for the draw of faults is taken as it is."""
    stored = run.record
    assert stored is not None
    now = FlightRecord.from_json(fly_again(store, run.spec).record().to_json())
    return replace(now, counts=stored.counts, acted_on=stored.acted_on)
