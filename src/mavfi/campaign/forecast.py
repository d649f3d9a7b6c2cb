"""Forecast of a campaign: number of flights, wall time, and size of the ledger."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mavfi.campaign.plan import Plan, golden_done
from mavfi.campaign.shard import WHOLE, Shard
from mavfi.campaign.store import FILE, Store
from mavfi.files import is_file

ASSUMED: Mapping[tuple[str, str], tuple[float, float, float]] = {
    ("local", "state"): (0.28, 0.12, 2500.0),
    ("local", "memory"): (2.0, 0.7, 2500.0),
    ("local", "instruction"): (0.56, 0.27, 6400.0),
}
"""Wall time of a golden run and of an injected run (s), and bytes per run, by host and level: means of a study
at scale paper with two workers on two processors; level memory: means of an earlier version."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """Expected size and duration of a campaign or shard."""

    missions: int
    golden: int  # runs
    injected: int  # runs with a fault and null runs, at most
    done: int  # runs in the ledger
    measured: bool  # estimated from the runs in the ledger; otherwise from `ASSUMED`
    seconds: float | None  # remaining wall time; None = no data for such runs
    ledger_bytes: float | None  # size of the complete ledger


def forecast(plan: Plan, directory: Path, workers: int, shard: Shard = WHOLE) -> Forecast:
    """Forecast a campaign from the runs in its ledger, or from `ASSUMED` if it has none.

    Raises:
        BadInputError: The ledger is damaged.
    """
    campaign, golden = plan.campaign, plan.golden_count(shard)
    missions, total, done = shard.missions(campaign), plan.count(shard), 0
    known = ASSUMED.get((campaign.host, campaign.sampling.level))
    means = None if known is None else {True: known[0], False: known[1]}
    size, left, measured = None if known is None else known[2] * total, {True: golden, False: total - golden}, False
    if is_file(directory / FILE):
        with Store.open(directory) as store:
            walls, counts = store.wall_times(), store.counts()
        done = sum(number for _, number, _ in counts.values())
        flown = golden_done(counts)
        left = {True: golden - flown, False: total - golden - (done - flown)}
        if len(walls) == len(left):
            means, measured = {kind: wall_s / number for kind, (number, wall_s) in walls.items()}, True
            size = max(1.0, total / done) * (directory / FILE).stat().st_size
    together = max(1, min(workers, missions))
    seconds = None if means is None else sum(number * means[kind] for kind, number in left.items()) / together
    return Forecast(missions, golden, total - golden, done, measured, seconds, size)
