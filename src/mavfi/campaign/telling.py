"""The run of a campaign that says most, flown again: injected, golden, and with a detector that saves the mission."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import polars as pl

from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.plan import FI
from mavfi.campaign.replay import fly_again
from mavfi.campaign.store import Store
from mavfi.flight_record import End
from mavfi.hosts.host import Flight

_INTERESTING = 0.02  # flight time over the golden run's from which a run that succeeds is worth a picture
Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Telling:
    """A run with a fault, and the flights that it is compared with."""

    injected: Row  # its row
    saved: Row | None  # row of the same fault with a detector that brings the mission home
    flight: Flight  # of the run with the fault
    golden: Flight  # of its golden run
    recovered: Flight | None  # of `saved`


def fly_telling_run(store: Store, runs: pl.DataFrame) -> Telling | None:
    """Choose among the runs of a ledger, and fly the chosen one again with its golden run.

    Returns:
        None if no run is worth a picture.
    """
    chosen = choose(runs)
    if chosen is None:
        return None
    injected, saved = chosen
    spec = store.run(injected["run_id"]).spec
    golden = fly_again(store, replace(spec, fault=None))
    recovered = None if saved is None else fly_again(store, store.run(saved["run_id"]).spec)
    return Telling(injected, saved, fly_again(store, spec), golden, recovered)


def with_flights(runs: Runs, directory: Path, run_ids: Iterable[str]) -> Runs:
    """The runs of a ledger, with some of them flown again as whole flights.

    Raises:
        BadInputError: There is no such run, or its host cannot fly it again.
    """
    wanted = list(dict.fromkeys(run_ids))
    if not wanted:
        return runs
    with Store.open(directory) as store:
        flights = {run_id: fly_again(store, store.run(run_id).spec) for run_id in wanted}
    return replace(runs, flights={**runs.flights, **flights})


def choose(runs: pl.DataFrame) -> tuple[Row, Row | None] | None:
    """The most telling row with a fault, and the same fault with a detector where the mission succeeds.

    A run that fails and that a detector brings home comes first; then one that fails; then the slowest.
    """
    rows = runs.filter(kind="injected", judged=True, site_outcome="activated").to_dicts()
    faulty = [row for row in rows if row["setting"] == FI and row["golden_success"]]
    watched: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        if row["detector"] and row["success"]:
            watched.setdefault(_pair(row), []).append(row)
    # long flights first: there is most to see
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
    """Ids of runs that can be explained, those first that say most.

    Lost missions come first, then slower ones, then other changed flights, then masked faults; of each, one for each
    environment and target in turn.
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
    """The run with the same fault in another setting, of the rows of a ledger.

    Returns:
        Of a run without a detector, the id of one with a detector, one that succeeds where there is one; of a run with
        a detector, that without one; None where there is none.
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
    """Environment, target and number of the fault: the same in every arm."""
    return row["environment"], row["target"], row["index"]
