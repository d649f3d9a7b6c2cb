"""Single runs of a campaign: their list, the most illustrative ones, pairs, and their flights."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import polars as pl

from mavfi.analysis.rows import ACTIVATED, EFFECT_IN_WORDS
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import NUMBER, SIGNED, TEXT, Column, Table
from mavfi.campaign.plan import FI
from mavfi.campaign.store import Store
from mavfi.record import End

_COLUMNS = (
    Column("number", "#", NUMBER),
    Column("run_id", "run"),
    Column("status", "status"),
    Column("effect", "effect"),
    Column("flight_time_s", "time", "number .1f s"),
    Column("alarms_total", "alarms", NUMBER),
    Column("inflation", "against golden", SIGNED),
    Column("bit", "bit", NUMBER),
    Column("site", "site"),
    Column("site_outcome", "injection"),
    Column("kernel_effect", "kernel"),
    Column("reason", "reason", TEXT),
)
_USUAL: dict[str, set[object]] = {
    "flight_time_s": {0.0},
    "alarms_total": {0},
    "kernel_effect": {""},
    "site_outcome": {"", ACTIVATED},
    "reason": {""},
}
"""Values of columns that are hidden if they have no others."""


def listing(runs: Runs, *, failed: bool = False, in_words: bool = False) -> Table:
    """List runs in plan order, with their numbers in it.  CSV and JSON contain all columns of the frame.

    `failed` selects missions that did not succeed, and runs that could not be judged; with `in_words` effects are
    those that people read, see `EFFECT_IN_WORDS`.
    """
    listed = replace(runs, frame=runs.frame.with_row_index("number", offset=1))
    if in_words:
        listed = listed.adding(effect=EFFECT_IN_WORDS)
    if failed:
        listed = listed.where(~pl.col("success"))
    frame = listed.frame
    empty = [key for key, usual in _USUAL.items() if set(frame[key]) <= usual]
    shown = [column for column in _COLUMNS if column.key not in empty]
    names = {column.key for column in shown}
    hidden = [Column(name, name, TEXT, hidden=True) for name in frame.columns if name not in names]
    columns = (*shown, *hidden)
    rows = frame.select(column.key for column in columns).rows()
    title = f"{len(listed)} of {len(runs)} runs"
    planned = runs.campaign.get("total")
    if runs.campaign.get("done") != planned:
        title = f"{title} flown so far, {planned} planned"
    return Table("runs", title, columns, rows)


_NOTICEABLE_DELAY = 0.02  # relative increase in flight time from which a successful run is worth a picture


def with_flights(runs: Runs, directory: Path, run_ids: Iterable[str]) -> Runs:
    """Return runs of a ledger with the replayed flights of selected runs added.

    Raises:
        BadInputError: A run does not exist, or its host does not support replays.
    """
    from mavfi.campaign.replay import flight_again

    wanted = list(dict.fromkeys(run_ids))
    if not wanted:
        return runs
    with Store.open(directory) as store:
        flights = {run_id: flight_again(store, store.run(run_id).spec) for run_id in wanted}
    return replace(runs, flights={**runs.flights, **flights})


def ordered(runs: pl.DataFrame) -> list[str]:
    """Ids of runs that can be explained, the most illustrative first.

    Lost missions come first, then delayed ones, then other changed flights, then masked faults; within each class,
    settings, environments and targets alternate.
    """
    explainable = runs.filter(kind="injected", judged=True, end=str(End.FLOWN), site_outcome="activated")
    lost = ~pl.col("success") & pl.col("golden_success")
    slower = pl.col("inflation").fill_null(0.0) > _NOTICEABLE_DELAY
    changed = pl.col("effect") != "masked"
    classified = explainable.with_columns(
        sort=pl.when(lost).then(0).when(slower).then(1).when(changed).then(2).otherwise(3)
    )
    # runs are numbered within each class, setting, environment and target: sorted by that, these alternate
    turn = pl.int_range(pl.len()).over("sort", "setting", "environment", "target")
    in_turns = classified.with_columns(turn=turn).sort("sort", "turn", maintain_order=True)
    run_ids: list[str] = in_turns["run_id"].to_list()
    return run_ids


def partner(runs: pl.DataFrame, run_id: str) -> str | None:
    """Find the run with the same fault in another setting, among the rows of a ledger.

    Returns:
        Id of a run with a detector (preferably a successful one) if the given run has none, else of the run in setting
        `fi`; None if there is no such run.
    """
    (row,) = runs.filter(run_id=run_id).to_dicts()
    same_fault = runs.filter(
        kind=row["kind"], world=row["world"], target=row["target"], index=row["index"], judged=True, end=str(End.FLOWN)
    )
    if row["detector"]:
        partners = same_fault.filter(setting=FI)
    else:
        partners = same_fault.filter(pl.col("detector") != "")
    if partners.is_empty():
        return None
    return str(partners.sort("success", descending=True, maintain_order=True)["run_id"][0])
