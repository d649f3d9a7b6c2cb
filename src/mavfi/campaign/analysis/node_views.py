"""Views of trials on external nodes: effects of one-bit faults in registers."""

from collections.abc import Mapping
from typing import Any

import polars as pl

from mavfi.campaign.analysis import measures as m
from mavfi.campaign.analysis.measures import Measure
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.table import NUMBER
from mavfi.campaign.analysis.views import View, has, register
from mavfi.flight_record import FlightRecord

_EFFECTS = {"masked": "masked", "sdc": "SDC", "crash": "crash", "hang": "hang"}
_INTERVALS = "per cent, [95 % interval, Wilson], count; a crash or a hang is a detected error (DUE)"
_REPEAT = (
    "the instant of an injection is the machine's, not the seed's: a trial cannot be repeated bit for bit, and the "
    "digest is that of this ledger"
)
_MOST = 12
_JUDGED = pl.col("effect") != "unknown"


def _of_registers(runs: Runs) -> bool:
    return has(runs.injected, level="register", kernel="")


def _trials(runs: Runs) -> Runs:
    names = {"general": "general + flags", "fp": "XMM, YMM"}
    return runs.injected.where(level="register").adding(registers=pl.col("target").replace(names))


def _endings_note(runs: Runs) -> list[str]:
    crashed = (
        _trials(runs).where(effect="crash").frame["kernel_effect_detail"].value_counts().sort("kernel_effect_detail")
    )
    signals = ", ".join(f"{name} {count}" for name, count in crashed.rows())
    return [f"crashes: {signals}"] if signals else []


def _stopped_note(runs: Runs) -> list[str]:
    held = sorted(
        injection.details["stopped_us"]
        for record in _trials(runs).recorded()
        for injection in record.injections
        if "stopped_us" in injection.details
    )
    return [f"the process stood still for {held[len(held) // 2] / 1000:.1f} ms (median)"] if held else []


def _places(runs: Runs) -> Runs:
    """Trials with column `function`: the injected function, or its library if the function has no symbol."""
    own = _trials(runs).where(pl.col("symbol") + pl.col("library") != "", pl.col("time_s").is_not_null())
    function = pl.col("symbol").str.replace(r"\+[^+]*$", "")
    library = pl.col("library").str.split("/").list.last()
    named = pl.when(pl.col("symbol").str.contains("+", literal=True)).then(function).otherwise(pl.lit(""))
    return own.adding(function=pl.when(named == "").then(library).otherwise(named))


def _difference(record: FlightRecord) -> list[Mapping[str, Any]]:
    """The first differing number in the node's outputs, as at most one row."""
    differences = record.extra.get("differences", ())
    if not differences or not record.injections:
        return []
    injection, first = record.injections[0], differences[0]
    return [{
        "injected": f"{injection.details.get('register', injection.site)} bit {injection.bit}",
        "instruction": str(injection.details.get("instruction", "")), "output": first["field"],
        "golden_value": str(first["before"]), "value": str(first["after"]),
        "differing": f"{record.extra['differing']} of {record.extra['asked']}",
    }]  # fmt: skip


register(
    View(
        "register_effects", "What one bit in a register does", ("registers",),
        (
            Measure("n", "trials", NUMBER, lambda own: len(own.where(_JUDGED))),
            *(m.wilson_rate(key, heading, pl.col("effect") == key, _JUDGED) for key, heading in _EFFECTS.items()),
            m.count("unknown", "not judged", effect="unknown"),
        ),
        where=_trials, total=("registers", "in all"),
        notes=lambda runs: (_INTERVALS, *_endings_note(runs), *_stopped_note(runs), _REPEAT), applies=_of_registers,
    ),
    View(
        "register_functions", "By function", ("function",),
        (
            m.count("n", "trials"),
            *(m.count(effect, heading, effect=effect) for effect, heading in _EFFECTS.items()),
        ),
        where=_places, limit=_MOST, largest="n", applies=_of_registers,
    ),
    View(
        "register_corruptions", "Silent corruptions", ("run_id",),
        tuple(
            m.first(column, heading)
            for column, heading in (
                ("injected", "injected"), ("instruction", "instruction"), ("output", "number in the output"),
                ("golden_value", "golden"), ("value", "was"), ("differing", "outputs that differ"),
            )
        ),
        where=lambda runs: _trials(runs).exploded(_difference), headings=("run",), applies=_of_registers,
    ),
)  # fmt: skip
