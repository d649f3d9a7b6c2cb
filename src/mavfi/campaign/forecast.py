"""How many flights a campaign would need, how long they would take, and how large its ledger would be."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mavfi.campaign.plan import Plan, golden_done
from mavfi.campaign.shard import WHOLE, Shard
from mavfi.campaign.store import FILE, Store

ASSUMED: Mapping[tuple[str, str], tuple[float, float, float]] = {
    ("local", "state"): (1.0, 0.5, 2500.0),
    ("local", "memory"): (2.0, 0.7, 2500.0),
    ("local", "instruction"): (4.0, 2.0, 5000.0),
}
"""Wall time of a golden run and of one with a fault (s), and bytes per run, by host and level: means of the shipped
campaigns with two workers on two processors."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """What is to be expected of a campaign, or of a shard."""

    missions: int
    golden: int  # runs
    injected: int  # runs with a fault and null runs, at most
    done: int  # runs that are in the ledger
    measured: bool  # from the runs in the ledger; otherwise assumed
    seconds: float | None  # wall time that is left; None = nothing is known of such runs
    ledger_bytes: float | None  # of the whole ledger


def forecast(plan: Plan, directory: Path, workers: int, shard: Shard = WHOLE) -> Forecast:
    """Forecast a campaign from the runs in its ledger, or, where there is none, from `ASSUMED`.

    Raises:
        BadInputError: The ledger is damaged.
    """
    campaign, golden = plan.campaign, plan.golden_count(shard)
    missions, total, done = shard.missions(campaign), plan.count(shard), 0
    known = ASSUMED.get((campaign.host, campaign.sampling.level))
    means = None if known is None else {True: known[0], False: known[1]}
    size, left, measured = None if known is None else known[2] * total, {True: golden, False: total - golden}, False
    if (directory / FILE).is_file():
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
