"""The list of runs of a page, stored by column; text columns are dictionary-encoded."""

from collections.abc import Mapping
from typing import Any

import polars as pl

from mavfi.analysis.runs import Runs

FILTERS = {
    "folder": "ledger", "environment": "environment", "setting": "arm", "status": "status", "effect": "effect",
    "level": "level", "stage": "stage", "place": "kernel or state", "field": "field", "bit": "bit",
    "bit_class": "bit class",
}  # fmt: skip
"""Filter columns with their labels."""
NUMBERS = {"flight_time_s": 2, "inflation": 4, "alarms_total": 0, "time_s": 3}
"""Numeric columns with their number of decimals."""


def run_list(ledgers: Mapping[str, Runs]) -> dict[str, Any]:
    """Ids and the columns in `FILTERS` and `NUMBERS` of all runs; `ledgers` is keyed by folder."""
    frames = [runs.frame.with_columns(folder=pl.lit(folder)) for folder, runs in ledgers.items()]
    frame = pl.concat(frames).with_columns(
        place=pl.when(pl.col("state") != "").then(pl.col("state")).otherwise(pl.col("kernel")),
        status=pl.col("status").str.replace_all("_", " "),
        bit=pl.col("bit").cast(pl.String).fill_null(""),
    )
    texts = {name: _coded(frame[name]) for name in FILTERS}
    numbers = {name: _rounded(frame[name], digits) for name, digits in NUMBERS.items()}
    return {"ids": frame["run_id"].to_list(), "texts": texts, "numbers": numbers, "filters": FILTERS}


def _coded(column: pl.Series) -> dict[str, Any]:
    values = column.unique(maintain_order=True).to_list()
    places = {value: place for place, value in enumerate(values)}
    return {"values": values, "codes": [places[value] for value in column]}


def _rounded(column: pl.Series, digits: int) -> list[float | None]:
    return [None if value is None else round(value, digits) if digits else int(value) for value in column]
