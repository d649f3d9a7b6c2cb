"""One row per run: the plan, the recorded events, and the evaluation against the golden run."""

from collections.abc import Collection, Iterable
from typing import Any

import polars as pl

from mavfi.campaign.config import label_of
from mavfi.campaign.plan import RunSpec, reason_of
from mavfi.campaign.store import Run
from mavfi.faults.fault import find_level
from mavfi.mission import MissionStatus
from mavfi.outcomes import DUE, ControlErrors, control_of, effect_of, energy
from mavfi.record import AFTERMATH, INSTANT, AlarmRecord, End, FlightRecord, Injection

WHOLE_WORD = "whole_word"
ALL_BITS = "all_bits"  # population of faults with uniformly drawn bits, i.e. without strata
POPULATIONS = {
    "all": "all", "sign_exponent": "sign + exponent", "sign": "sign", "exponent": "exponent", WHOLE_WORD: "whole word",
    "mantissa": "mantissa", "length": "lengths of lists", ALL_BITS: "all bits",
}  # fmt: skip
"""Display names of populations."""
GOLDEN = "golden"
INJECTED = "injected"
NULL = "null"
"""Kinds of run."""
ACTIVATED = "activated"
NO_SITE = "no_site"
NOT_ACTIVATED = "not_activated"
"""Outcome of a planned site; `NO_SITE` = missing in the golden run, `NOT_ACTIVATED` = not reached when injected."""
KERNEL_DUE = tuple(effect.label for effect in DUE)
"""Effects on a kernel that kill its node: the node restarts, or the mission ends."""

_IS_SILENT = ~pl.col("kernel_effect").is_in(KERNEL_DUE) & (pl.col("level") != "sensor")
SILENT = (pl.col("effect") == "sdc") & _IS_SILENT
"""Whether a flight differs from its golden run and nothing has said so: no kernel died, no sensor gave no data."""
CHANGED = (pl.col("effect") == "sdc") & ~_IS_SILENT
"""Whether it differs, and something has said so."""
EFFECT_IN_WORDS = pl.when(CHANGED).then(pl.lit("changed")).otherwise(pl.col("effect"))
"""The effect on the flight, as people read it: that on the kernel stands beside it."""

_TEXT = pl.String
_INT = pl.Int64
_REAL = pl.Float64
_FLAG = pl.Boolean
SCHEMA: dict[str, Any] = {
    "run_id": _TEXT, "kind": _TEXT, "setting": _TEXT, "arm": _TEXT, "detector": _TEXT, "detector_profile": _TEXT,
    "environment": _TEXT, "seed": _INT, "world": _TEXT, "target": _TEXT, "index": _INT,
    "level": _TEXT, "stage": _TEXT, "kernel": _TEXT, "state": _TEXT, "field": _TEXT, "element": _INT, "site": _TEXT,
    "operation": _TEXT, "bit": _INT, "bit_class": _TEXT, "stratum": _TEXT, "population": _TEXT, "weight": _REAL,
    "has_site": _FLAG, "monitored": _FLAG,
    "function": _TEXT, "file": _TEXT, "line": _INT, "opcode": _TEXT, "value_class": _TEXT, "value_type": _TEXT,
    "variable": _TEXT, "replayable": _FLAG, "register": _TEXT, "symbol": _TEXT, "library": _TEXT,
    "end": _TEXT, "status": _TEXT, "success": _FLAG, "success_if_ended": _FLAG, "golden_success": _FLAG,
    "judged": _FLAG, "effect": _TEXT, "control": _TEXT, "kernel_effect": _TEXT, "kernel_effect_detail": _TEXT,
    "activated": _FLAG, "site_outcome": _TEXT, "time_s": _REAL, "before": _REAL, "after": _REAL,
    "tilt": _REAL, "attitude_error": _REAL, "velocity_error": _REAL, "yaw_rate_error": _REAL,
    "flight_time_s": _REAL, "energy_j": _REAL, "distance_m": _REAL, "replans": _INT, "time_limit_s": _REAL,
    "course_m": _REAL, "golden_flight_time_s": _REAL, "inflation": _REAL, "energy_inflation": _REAL,
    "detected_at_site": _FLAG, "detected_downstream": _FLAG, "alarm_after_s": _REAL, "alarms_total": _INT,
    "digest": _TEXT, "wall_s": _REAL, "note": _TEXT, "reason": _TEXT,
}  # fmt: skip
"""Columns of the frame and their types."""


def row_of(
    run: Run,
    record: FlightRecord,
    arm_golden: FlightRecord | None,
    reference: FlightRecord | None,
    monitored: Collection[tuple[str, str]],
) -> dict[str, Any]:
    """Compute the columns of a completed run.

    Args:
        run: The run.
        record: Its record.
        arm_golden: Golden run of the same arm, with which digests and alarms are compared.
        reference: Golden run of the same mission without a detector, with which success and flight times are compared;
            for a fault in a detector, whose false alarms are no effect of the fault, `arm_golden` takes its place.
        monitored: Monitored states and fields.
    """
    spec = run.spec
    fault = spec.fault
    if fault is not None and fault.in_detector:
        reference = arm_golden
    environment = label_of(spec.environment)
    planned: dict[str, Any] = {}
    if fault is not None:
        planned = {
            "level": fault.level,
            "site": fault.site,
            "bit": fault.bit,
            "stratum": fault.stratum,
            "weight": fault.weight,
            "bit_class": fault.bit_class,
            "has_site": fault.has_site,
            "population": ALL_BITS,
            **find_level(fault.level).columns(fault),
        }
    planned["monitored"] = (planned.get("state", ""), planned.get("field", "")) in monitored
    # later entries replace earlier ones: the defaults of golden runs come before the columns of a fault,
    # and the planned site and bit before those that the injection met
    columns = {
        "run_id": spec.run_id,
        "kind": spec.kind,
        "setting": spec.setting,
        "arm": spec.arm,
        "detector": spec.detector,
        "detector_profile": spec.detector_profile,
        "environment": environment,
        "seed": spec.seed,
        "world": f"{environment} {spec.seed}",
        "target": spec.target,
        "index": spec.index,
        "weight": 1.0,
        "has_site": False,
        "population": "all",
        **planned,
        **_happened(record, is_faulty=fault is not None, has_site=bool(planned.get("has_site"))),
        **_judged(record, arm_golden, reference, spec),
        **_controlled(record, arm_golden, spec),
        **_detected(record, arm_golden, planned.get("state", "")),
        "digest": record.digest,
        "wall_s": run.wall_s,
        "note": run.note,
    }
    if record.kernel is not None:
        columns |= {"kernel_effect": record.kernel.effect, "kernel_effect_detail": record.kernel.detail}
    if record.end is End.UNKNOWN:
        columns["reason"] = reason_of(run.note) or record.error
    return columns


_DETAILS = {
    "opcode": "opcode", "value_class": "value_class", "type": "value_type", "variable": "variable",
    "function": "function", "register": "register", "symbol": "symbol", "library": "library",
}  # fmt: skip
"""Columns by key in `Injection.details`."""


def _happened(record: FlightRecord, *, is_faulty: bool, has_site: bool) -> dict[str, Any]:
    """Columns for the injection; if there are several, for the first activated one."""
    activated = [injection for injection in record.injections if injection.activated]
    columns: dict[str, Any] = {"activated": bool(activated)}
    # outcome of the planned site; a flight that died before its end counts as activated
    if is_faulty and not has_site:
        columns["site_outcome"] = NO_SITE
    elif is_faulty and (activated or not record.flown):
        columns["site_outcome"] = ACTIVATED
    elif is_faulty:
        columns["site_outcome"] = NOT_ACTIVATED
    injections = activated or record.injections
    if injections:
        columns |= _injection(injections[0])
    return columns


def _injection(injection: Injection) -> dict[str, Any]:
    details = injection.details
    columns: dict[str, Any] = {
        "time_s": injection.time_s,
        "before": _number(injection.before),
        "after": _number(injection.after),
        "file": injection.file,
        "line": injection.line,
        "replayable": details.get("replayable"),
    }
    for key, column in _DETAILS.items():
        if details.get(key) is not None:
            columns[column] = str(details[key])
    if "path" in details:  # of a number in a call, by name
        columns["site"] = f"{details['call']}.{details['path']}"
    if injection.bit is not None:
        columns["bit"] = injection.bit
    return columns


def _number(value: object) -> float | None:
    """A value as a float; None for no value, for text, and for integers beyond the range of floats."""
    if value is None:
        return None
    try:
        return float(value)  # type: ignore[arg-type]
    except (OverflowError, ValueError):
        return None


def _succeeded(record: FlightRecord) -> bool:
    return record.status == MissionStatus.SUCCESS.label


def _judged(
    record: FlightRecord, arm_golden: FlightRecord | None, reference: FlightRecord | None, spec: RunSpec
) -> dict[str, Any]:
    """Columns for the end of the flight, its effect, and its cost against the reference."""
    success = _succeeded(record)
    died = record.kernel is not None and record.kernel.effect in KERNEL_DUE
    columns: dict[str, Any] = {
        "end": str(record.end),
        "status": record.status or str(record.end),
        "success": success,
        "success_if_ended": success and not died,
        "judged": record.end is not End.UNKNOWN,
        "golden_success": None,
        "effect": "",
    }
    if reference is not None and reference.end is not End.UNKNOWN:
        columns["golden_success"] = _succeeded(reference)
    if spec.kind != GOLDEN:
        columns["effect"] = effect_of(arm_golden, record).label
        if record.end is End.DUE and record.kernel is not None:  # a dead process: the recorded effect on the kernel
            columns["effect"] = record.kernel.effect
    # the flight itself; processes without a flight have none of it
    if record.flown:
        columns |= {
            "flight_time_s": record.flight_time_s,
            "energy_j": energy(record.energy),
            "replans": record.replans,
            "distance_m": record.distance_m,
            "time_limit_s": record.time_limit_s,
            "course_m": record.course_m,
            "alarms_total": record.alarms_total,
        }
    # cost of the fault, if both missions succeed; a program without a mission takes no flight time
    if reference is not None and reference.flown and reference.flight_time_s > 0:
        columns["golden_flight_time_s"] = reference.flight_time_s
        if success and _succeeded(reference):
            columns["inflation"] = record.flight_time_s / reference.flight_time_s - 1
            golden_energy = energy(reference.energy)
            if golden_energy > 0:
                columns["energy_inflation"] = energy(record.energy) / golden_energy - 1
    return columns


def _controlled(record: FlightRecord, arm_golden: FlightRecord | None, spec: RunSpec) -> dict[str, Any]:
    """Class of a firmware's mission, and how well it was controlled from the fault on (golden run: from the start)."""
    errors = ControlErrors.of(record)
    if errors is None:
        return {}
    columns: dict[str, Any] = {
        "tilt": errors.tilt,
        "attitude_error": errors.attitude,
        "velocity_error": errors.velocity,
        "yaw_rate_error": errors.yaw_rate,
    }
    if spec.kind != GOLDEN:
        control = control_of(arm_golden, record)
        columns["control"] = None if control is None else control.value
    return columns


def _detected(record: FlightRecord, arm_golden: FlightRecord | None, state: str) -> dict[str, Any]:
    """Whether an alarm is on the corrupted publication, and when an alarm absent in the golden run follows it."""
    instants = [injection.time_s for injection in record.injections if injection.activated]
    golden_alarms = set() if arm_golden is None else _instants_of(arm_golden.alarms)
    at_site = False
    delays = []
    for alarm in record.alarms:
        in_golden = _instants_of([alarm]) <= golden_alarms
        for time_s in instants:
            after_s = alarm.time_s - time_s
            if alarm.state == state and abs(after_s) < INSTANT:
                at_site = True
            if after_s > -INSTANT and not in_golden:
                delays.append(max(0.0, after_s))
    first = min(delays, default=None)
    return {
        "detected_at_site": at_site,
        "detected_downstream": first is not None and first <= AFTERMATH,
        "alarm_after_s": first,
    }


def _instants_of(alarms: Iterable[AlarmRecord]) -> set[tuple[str, int]]:
    """States and instants (us) of alarms."""
    return {(alarm.state, round(1e6 * alarm.time_s)) for alarm in alarms}
