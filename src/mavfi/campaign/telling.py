"""Selection of illustrative runs of a campaign, and their replay: injected, golden, and recovered by a detector."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import polars as pl

from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.mission import host_of
from mavfi.campaign.plan import FI
from mavfi.campaign.replay import flight_again
from mavfi.campaign.run import stored_campaign
from mavfi.campaign.store import Store
from mavfi.flight_record import End
from mavfi.hosts.host import Flight

_INTERESTING = 0.02  # relative increase in flight time from which a successful run is worth a picture
Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Telling:
    """An injected run and the flights for comparison."""

    injected: Row  # row of the injected run
    saved: Row | None  # row of a successful run with the same fault and a detector
    flight: Flight  # of the injected run
    golden: Flight  # of its golden run
    recovered: Flight | None  # of the run in `saved`


def fly_telling_run(store: Store, runs: pl.DataFrame) -> Telling | None:
    """Choose the most illustrative run of a ledger, and replay it with its golden run.

    Returns:
        None if `choose` finds no run, or the host leaves no flights to replay.
    """
    host = host_of(stored_campaign(store))
    chosen = choose(runs) if host.flies and host.deterministic else None
    if chosen is None:
        return None
    injected, saved = chosen
    spec = store.run(injected["run_id"]).spec
    golden = flight_again(store, replace(spec, fault=None))
    recovered = None if saved is None else flight_again(store, store.run(saved["run_id"]).spec)
    return Telling(injected, saved, flight_again(store, spec), golden, recovered)


def with_flights(runs: Runs, directory: Path, run_ids: Iterable[str]) -> Runs:
    """Return runs of a ledger with the replayed flights of selected runs added.

    Raises:
        BadInputError: A run does not exist, or its host does not support replays.
    """
    wanted = list(dict.fromkeys(run_ids))
    if not wanted:
        return runs
    with Store.open(directory) as store:
        flights = {run_id: flight_again(store, store.run(run_id).spec) for run_id in wanted}
    return replace(runs, flights={**runs.flights, **flights})


def choose(runs: pl.DataFrame) -> tuple[Row, Row | None] | None:
    """Choose the most illustrative injected run, and a successful run with the same fault and a detector, if any.

    Order of preference: a failed mission that a detector recovers, any failed mission, the largest delay.
    """
    rows = runs.filter(kind="injected", judged=True, site_outcome="activated").to_dicts()
    faulty = [row for row in rows if row["setting"] == FI and row["golden_success"]]
    watched: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        if row["detector"] and row["success"]:
            watched.setdefault(_pair(row), []).append(row)
    # long flights first: they show most
    failed = sorted((row for row in faulty if not row["success"]), key=lambda row: -(row["distance_m"] or 0.0))
    for row in failed:
        if _pair(row) in watched:
            return row, watched[_pair(row)][0]
    if failed:
        return failed[0], None
    slowest = max(faulty, key=_inflation, default=None)
    if slowest is None or _inflation(slowest) < _INTERESTING:
        return None
    faster = [row for row in watched.get(_pair(slowest), []) if _inflation(row) < _INTERESTING]
    return slowest, faster[0] if faster else None


def ordered(runs: pl.DataFrame) -> list[str]:
    """Ids of runs that can be explained, the most illustrative first.

    Lost missions come first, then delayed ones, then other changed flights, then masked faults; within each class,
    settings, environments and targets alternate.
    """
    own = runs.filter(kind="injected", judged=True, end=str(End.FLOWN), site_outcome="activated")
    lost = ~pl.col("success") & pl.col("golden_success")
    slower = pl.col("inflation").fill_null(0.0) > _INTERESTING
    own = own.with_columns(
        sort=pl.when(lost).then(0).when(slower).then(1).when(pl.col("effect") != "masked").then(2).otherwise(3)
    )
    turn = pl.int_range(pl.len()).over("sort", "setting", "environment", "target")
    found: list[str] = own.with_columns(turn=turn).sort("sort", "turn", maintain_order=True)["run_id"].to_list()
    return found


def partner(runs: pl.DataFrame, run_id: str) -> str | None:
    """Find the run with the same fault in another setting, among the rows of a ledger.

    Returns:
        Id of a run with a detector (preferably a successful one) if the given run has none, else of the run in setting
        `fi`; None if there is no such run.
    """
    (row,) = runs.filter(run_id=run_id).to_dicts()
    same = runs.filter(
        kind=row["kind"], world=row["world"], target=row["target"], index=row["index"], judged=True, end=str(End.FLOWN)
    ).filter((pl.col("detector") != "") if not row["detector"] else (pl.col("setting") == FI))
    found: list[str] = same.sort("success", descending=True, maintain_order=True)["run_id"].to_list()
    return found[0] if found else None


def _inflation(row: Row) -> float:
    return row["inflation"] or 0.0


def _pair(row: Row) -> tuple[Any, ...]:
    """Environment, target and index of the fault, which identify it in every arm."""
    return row["environment"], row["target"], row["index"]
