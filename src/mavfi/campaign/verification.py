"""Verification of a ledger: replay of a random sample of its runs, and a bound on the share of wrong records."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mavfi.campaign.analysis.statistics import CONFIDENCE, exact_bounds
from mavfi.campaign.replay import fly_again
from mavfi.campaign.store import Run, Store
from mavfi.errors import BadInputError
from mavfi.flight_record import FlightRecord


@dataclass(frozen=True, slots=True)
class Verification:
    """Outcome of a verification.

    Attributes:
        runs: Replayable runs of the ledger.
        flown: Size of the sample.
        differing: Runs whose replayed record differs from the stored one.
    """

    runs: int
    flown: int
    differing: tuple[str, ...]

    @property
    def upper_bound(self) -> float:
        """One-sided upper confidence bound on the share of wrong records (Clopper and Pearson 1934)."""
        wrong = len(self.differing)
        return exact_bounds(wrong, self.flown - wrong, 1.0 - CONFIDENCE)[1]


def verify(
    directory: Path, share: float, seed: int = 0, progress: Callable[[int, int], None] | None = None
) -> Verification:  # fmt: skip
    """Replay a random sample of the runs, at least one, and compare every field of their records.

    Runs without a flight, and runs marked as not replayable, are excluded.

    Args:
        directory: Folder of the ledger.
        share: Sample size / replayable runs, in (0, 1].
        seed: Seed of the sample.
        progress: Called with the number of replayed runs and the sample size.

    Raises:
        BadInputError: The ledger is absent or has no replayable run, or the share is out of range.
    """
    if not 0.0 < share <= 1.0:
        raise BadInputError(f"--share: {share}: allowed: above 0, 1 at most")
    with Store.open(directory) as store:
        runs = [run for run in store.runs(done=True) if _is_replayable(run)]
        if not runs:
            raise BadInputError(f"{directory}: holds no replayable run")
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
    """Record of the replayed run, with the counts of a golden run, used only for drawing faults, copied."""
    stored = run.record
    assert stored is not None
    now = FlightRecord.from_json(fly_again(store, run.spec).record().to_json())
    return replace(now, counts=stored.counts, acted_on=stored.acted_on)
