"""View of the paper's Table II: compute time overhead of detection and recovery, measured, modelled and published."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis import published as paper
from mavfi.analysis.flight_views import SETTING, watched
from mavfi.analysis.measures import Measure, MeasureFactory
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import SMALL
from mavfi.analysis.views import View
from mavfi.errors import BadInputError
from mavfi.plugins import Chapter
from mavfi.record import FlightRecord
from mavfi.states import PPC_STAGES

FILE = "overheads.json"
"""Name of the file of measured overheads in the folder of a campaign."""
ALL = "all"
"""Key of the sum over all stages."""


def load(directory: Path) -> dict[str, Any]:
    """Read measured overheads from the folder of a campaign; empty if there are none.

    Raises:
        BadInputError: The file is invalid.
    """
    path = directory / FILE
    try:
        measured: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        _check_keys(measured)
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError):
        raise BadInputError(f"{path}: is not a file of measured overheads; remove it, or measure again") from None
    return measured


def _check_keys(measured: dict[str, Any]) -> None:
    """Read each key that the views need; `KeyError` or `TypeError` if one is missing, or a value has another type."""
    for key in ("processor", "missions"):
        measured[key]
    for row in measured["rows"]:
        for key in ("detection", "recovery"):
            row[key]
        hash((row["environment"], row["arm"], row["stage"]))


def of_stages(record: FlightRecord) -> list[Mapping[str, Any]]:
    """Modelled recomputation time by stage and in total, with the modelled compute time of the pipeline (us)."""
    total_us = sum(record.recompute_us.values())
    pipeline_us = sum(record.compute_us.values()) - total_us  # kernels' compute times include recomputations
    recompute_us = {str(stage): record.recompute_us.get(str(stage), 0) for stage in PPC_STAGES}
    recompute_us[ALL] = total_us
    return [
        {"stage": stage, "recomputed_us": time_us, "pipeline_us": pipeline_us}
        for stage, time_us in recompute_us.items()
    ]


def _measured_row(runs: Runs) -> Mapping[str, Any]:
    """Measured overheads of an environment, arm and stage; empty if there are none."""
    group = (runs.first("environment"), runs.first("arm"), runs.first("stage"))
    for row in runs.campaign.get("overheads", {}).get("rows", ()):
        if (row["environment"], row["arm"], row["stage"]) == group:
            return row  # type: ignore[no-any-return]
    return {}


def _measured(*keys: str) -> Measure:
    """Sum of measured overheads, as shares of the kernels' time on this machine; see `mavfi.extras.paper.overheads`."""

    def sum_of_keys(runs: Runs) -> float | None:
        row = _measured_row(runs)
        if row:
            return float(sum(row[key] for key in keys))
        return None

    name = "sum"
    if len(keys) == 1:
        name = keys[0]
    return Measure(f"measured_{name}", f"{name}, measured", SMALL, sum_of_keys)


def _modelled(runs: Runs) -> float | None:
    """Recomputations / compute time of the pipeline, both in the platform's modelled time."""
    compute = sum(runs["pipeline_us"])
    if compute:
        return float(sum(runs["recomputed_us"]) / compute)
    return None


def _detection_modelled(runs: Runs) -> float | None:
    """Time of the detector, as fast on the platform as on the machine that was measured / modelled compute time."""
    share: float | None = _measured_row(runs).get("detection_modelled")
    return share


def _sum_modelled(runs: Runs) -> float | None:
    detection = _detection_modelled(runs)
    recovery = _modelled(runs)
    if detection is None or recovery is None:
        return None
    return detection + recovery


def _papers(key: str, of_stage: str, of_all: str = "") -> MeasureFactory:
    """The paper's value for a stage, or its value for all stages if given."""

    def printed_value(runs: Runs) -> float | None:
        stage = runs.first("stage")
        name = of_stage
        if stage == ALL:
            name = of_all
        if not name or not paper.comparable(runs):
            return None
        where = {"environment": runs.first("environment"), "setting": runs.first("setting"), "stage": stage}
        printed: float | None = paper.figure(name, **where)
        return printed

    heading = "paper, sum"
    if of_stage:
        heading = "paper"
    return paper.beside(Measure(f"paper_{key}", heading, SMALL, printed_value))


def _overhead_notes(runs: Runs) -> list[str]:
    """Notes on what is divided by what, and on how it was measured."""
    # how the times were measured, and what a measurement of an earlier version lacks
    measured = runs.campaign.get("overheads", {})
    if measured:
        where = (
            f"measured: one process on {measured['processor']}, medians of {measured['missions']} golden flights per "
            "environment; time of detector / of kernels, and of repeated steps and of keeping memory for them / "
            "of kernels"
        )
    else:
        where = (
            "columns measured and detection, modelled, are empty: no measurement of these flights stored; mavfi bench "
            "overheads DIR makes one"
        )
    not_modelled = []
    if any("detection_modelled" not in row for row in measured.get("rows", ())):  # measured by an earlier version
        not_modelled = ["detection, modelled: not in this measurement; mavfi bench overheads DIR repeats it"]

    # what is divided by what
    return [
        "recovery, modelled: recomputations with the latencies of the platform / compute time of the pipeline, all "
        "flights with the detector and a fault, as the paper's",
        "detection, modelled: time of the detector, measured as below / compute time of the pipeline in these golden "
        "flights with the latencies of the platform; no latency of a detector is published, so it is taken to be as "
        "fast on the platform as here, a lower bound for a slower processor (docs/reference/models.md); the modelled "
        "computer is not charged for it",
        *not_modelled,
        where,
        "the paper does not say what its times are divided by; its figures below 0.0001 % stand as that bound; an "
        "alarm at a way-point charges the planning stage, as in the paper, but only repeats the setpoint generator, "
        "and that is what is measured",
    ]


CHAPTER = Chapter(
    20,
    (
        View(
            "overheads_as_in_the_paper",
            paper.titled("Table II: ", "compute time overhead of detection and of recovery"),
            (*SETTING, "stage"),
            (
                m.count("flights", "flights"),
                _measured("detection"),
                Measure("modelled_detection", "detection, modelled", SMALL, _detection_modelled),
                _papers("detection", "stage_detection_overhead", "detection_overhead"),
                _measured("recovery"),
                Measure("modelled", "recovery, modelled", SMALL, _modelled),
                _papers("recompute", "recompute_overhead"),
                _measured("detection", "recovery"),
                Measure("modelled_sum", "sum, modelled", SMALL, _sum_modelled),
                _papers("sum", "", "overhead"),
            ),
            where=lambda runs: runs.injected.where(pl.col("detector") != "", end="flown").exploded(of_stages),
            notes=_overhead_notes,
            applies=lambda runs: watched(runs) and runs.has_missions,
        ),
    ),
)
