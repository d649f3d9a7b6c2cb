"""Views of alarms (false alarms, detected faults), and the overhead of detection and recovery."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.flight_views import (
    HEALS,
    SETTING,
    TOTAL,
    named_populations,
    of_states,
    watched,
)
from mavfi.analysis.measures import Measure
from mavfi.analysis.rows import ACTIVATED
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import NUMBER, PER_HOUR, SMALL, TEXT
from mavfi.analysis.views import View, register
from mavfi.extras.paper import published as paper
from mavfi.extras.paper.overheads import ALL
from mavfi.record import FlightRecord
from mavfi.states import PPC_STAGES


# ---- alarms ------------------------------------------------------------------------------------------------------
def _golden_watched(runs: Runs) -> Runs:
    return runs.golden.where(pl.col("detector") != "", end="flown")


def _kinds(own: Runs) -> str:
    kinds: Counter[str] = Counter()
    for record in own.recorded():
        kinds.update(record.alarm_counts)
    # "source/action/outcome"; the name of the setting already contains the source
    return ", ".join(f"{' '.join(kind.split('/')[1:])} {count}" for kind, count in kinds.items())


def _systematic_note(runs: Runs) -> str:
    parts = _golden_watched(runs).groups("setting", "environment").values()
    always = {(state, time_s) for own in parts for state, time_s, _ in m.systematic(own)}
    alarms = "".join(f"; {state} at {time_s:.2f} s" for state, time_s in sorted(always))
    return f"systematic: same state and instant in more than 90 % of the flights{alarms}"


def _monitored_note(runs: Runs) -> str:
    name = runs.campaign.get("monitored_set", "")
    return (
        f"monitored set {name}: the fields that the paper's detectors see; others watch more (the acceptance test "
        "every field of the states with a rule), and may catch faults outside it"
    )


def _detected(runs: Runs) -> Runs:
    own = runs.injected.where("judged", pl.col("detector") != "", site_outcome=ACTIVATED)
    in_set = pl.when(pl.col("monitored")).then(pl.lit("yes")).otherwise(pl.lit("no"))
    return named_populations(own).adding(in_monitored_set=in_set)


# ---- overhead ----------------------------------------------------------------------------------------------------
def of_stages(record: FlightRecord) -> list[Mapping[str, Any]]:
    """Modelled recomputation time by stage and in total, with the modelled compute time of the pipeline (us)."""
    recomputed = sum(record.recompute_us.values())
    compute = sum(record.compute_us.values()) - recomputed  # kernels' compute times include recomputations
    spent = {**{str(stage): record.recompute_us.get(str(stage), 0) for stage in PPC_STAGES}, ALL: recomputed}
    return [{"stage": stage, "recomputed_us": us, "pipeline_us": compute} for stage, us in spent.items()]


def _timed(own: Runs) -> Mapping[str, Any]:
    """Measured overheads of an environment, arm and stage; empty if there are none."""
    place = own.first("environment"), own.first("arm"), own.first("stage")
    rows = own.campaign.get("overheads", {}).get("rows", ())
    return next((row for row in rows if (row["environment"], row["arm"], row["stage"]) == place), {})


def _measured(*keys: str) -> Measure:
    """Sum of measured overheads, as shares of the kernels' time on this machine; see `mavfi.extras.paper.overheads`."""

    def of(own: Runs) -> float | None:
        row = _timed(own)
        return sum(row[key] for key in keys) if row else None

    name = keys[0] if len(keys) == 1 else "sum"
    return Measure(f"measured_{name}", f"{name}, measured", SMALL, of)


def _modelled(own: Runs) -> float | None:
    compute = sum(own["pipeline_us"])
    return sum(own["recomputed_us"]) / compute if compute else None


def _detection_modelled(own: Runs) -> float | None:
    """Time of the detector, as fast on the platform as on the machine that was measured / modelled compute time."""
    found: float | None = _timed(own).get("detection_modelled")
    return found


def _sum_modelled(own: Runs) -> float | None:
    detection, recovery = _detection_modelled(own), _modelled(own)
    return None if detection is None or recovery is None else detection + recovery


def _papers(key: str, of_stage: str, of_all: str = "") -> Measure:
    """The paper's value for a stage, or its value for all stages if given."""

    def of(own: Runs) -> float | None:
        stage = own.first("stage")
        name = of_all if stage == ALL else of_stage
        if not name or not paper.comparable(own.campaign, own.first("detector_profile")):
            return None
        where = {"environment": own.first("environment"), "setting": own.first("setting"), "stage": stage}
        found: float | None = paper.figure(name, **where)
        return found

    return Measure(f"paper_{key}", "paper" if of_stage else "paper, sum", SMALL, of)


def _overhead_notes(runs: Runs) -> list[str]:
    measured = runs.campaign.get("overheads", {})
    where = (
        f"measured: one process on {measured['processor']}, medians of {measured['missions']} golden flights per "
        "environment; time of detector / of kernels, and of repeated steps and of keeping memory for them / of kernels"
        if measured
        else "columns measured and detection, modelled, are empty: no measurement of these flights stored; mavfi bench "
        "overheads DIR makes one"
    )
    lacking = any("detection_modelled" not in row for row in measured.get("rows", ()))
    return [
        "recovery, modelled: recomputations with the latencies of the platform / compute time of the pipeline, all "
        "flights with the detector and a fault, as the paper's",
        "detection, modelled: time of the detector, measured as below / compute time of the pipeline in these golden "
        "flights with the latencies of the platform; no latency of a detector is published, so it is taken to be as "
        "fast on the platform as here, a lower bound for a slower processor (docs/models.md); the modelled computer is "
        "not charged for it",
        *(["detection, modelled: not in this measurement; mavfi bench overheads DIR repeats it"] if lacking else []),
        where,
        "the paper does not say what its times are divided by; its figures below 0.0001 % stand as that bound; an "
        "alarm at a way-point charges the planning stage, as in the paper, but only repeats the setpoint generator, "
        "and that is what is measured",
    ]


register(
    View(
        "overheads_as_in_the_paper", "Table II: compute time overhead of detection and of recovery",
        (*SETTING, "stage"),
        (
            m.count("flights", "flights"), _measured("detection"),
            Measure("modelled_detection", "detection, modelled", SMALL, _detection_modelled),
            _papers("detection", "stage_detection_overhead", "detection_overhead"), _measured("recovery"),
            Measure("modelled", "recovery, modelled", SMALL, _modelled), _papers("recompute", "recompute_overhead"),
            _measured("detection", "recovery"), Measure("modelled_sum", "sum, modelled", SMALL, _sum_modelled),
            _papers("sum", "", "overhead"),
        ),
        where=lambda runs: runs.injected.where(pl.col("detector") != "", end="flown").exploded(of_stages),
        notes=_overhead_notes, applies=lambda runs: watched(runs) and runs.has_missions,
    ),
    View(
        "false_alarms", "False alarms", SETTING,
        (
            m.count("flights", "flights"), m.count("with_alarm", "with alarm", pl.col("alarms_total") > 0),
            Measure("alarms", "alarms", NUMBER, lambda own: sum(own["alarms_total"])),
            Measure("systematic", "systematic", NUMBER, lambda own: sum(n for _, _, n in m.systematic(own))),
            Measure("hours", "exposure", "number .2f h", lambda own: sum(own["flight_time_s"]) / 3600),
            Measure("per_hour", "per hour", PER_HOUR, m.alarm_rate),
            Measure("upper", "upper bound", "number .1f", lambda own: m.alarm_rate(own).upper),
            Measure("kinds", "kinds", TEXT, _kinds),
        ),
        where=_golden_watched, total=TOTAL,
        notes=lambda runs: (
            "golden flights; per hour of flight, 95 % interval: bootstrap of flights, at least as wide as Poisson's, "
            "which alone is left where there is no alarm; upper bound: one-sided 95 %", _systematic_note(runs),
        ), applies=watched,
    ),
    View(
        "detections", "Detection of activated faults", ("environment", "setting", "bits", "in_monitored_set"),
        (
            m.rate("detected", "detected", "detected_at_site"),
            m.rate("downstream", "detected downstream", "detected_downstream"),
        ),
        where=_detected,
        notes=lambda runs: (
            HEALS, _monitored_note(runs),
            "detected: alarm on the corrupted publication; with coupling inline before it is seen, so the latency is 0 "
            "by construction",
            "detected downstream: within 1 s, an alarm of a state and instant that the golden flight with the same "
            "detector has not; false alarms that the fault has shifted are among them",
        ), applies=lambda runs: of_states(runs) and watched(runs),
    ),
)  # fmt: skip
