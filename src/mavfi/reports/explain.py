"""What a fault did, step by step, against the golden twin."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.campaign.plan import RunSpec
from mavfi.campaign.replay import golden_twin
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.flight_log import FlightLog
from mavfi.reports.watch import Difference, first_difference, fly_watched

LEFT = 0.1
"""Distance from the twin, at the same instant, from which a flight counts as having left its path (m)."""


@dataclass(frozen=True, slots=True)
class Departure:
    """How far a flight went from its twin, at equal instants.

    Attributes:
        time_s: When it was first farther than `LEFT`; None if never.
        position: Where it was then (m); None if never.
        largest_m: Largest distance while both flew.
        largest_s: When.
    """

    time_s: float | None
    position: tuple[float, float, float] | None
    largest_m: float
    largest_s: float


@dataclass(frozen=True, slots=True)
class Explanation:
    """A run and its golden twin, both flown again.

    Attributes:
        spec: The run.
        log: Its flight of now.
        twin: The golden flight of now, with the same detector.
        same: Whether the digest is the stored one.
        first: First published value that differs; None = masked.
        departure: How the paths part.
    """

    spec: RunSpec
    log: FlightLog
    twin: FlightLog
    same: bool
    first: Difference | None
    departure: Departure


def explain(directory: Path, run_id: str) -> Explanation:
    """Fly a run and its golden twin again, and compare all that was published.

    Args:
        directory: Where the ledger is.
        run_id: The run, or an unambiguous beginning of its id.

    Raises:
        BadInputError: No such campaign or run, a run without a fault, or one that left no flight.
        SpecMismatchError: The detector's model is no longer the one that the run flew with.
    """
    with Store.open(directory) as store:
        run = store.run(run_id)
        twin = golden_twin(store, run.spec)
        if twin is None:
            raise BadInputError(f"{directory}: run {run.spec.run_id}: has no fault to explain; allowed: runs with one")
        if run.record is None or "digest" not in run.record:
            raise BadInputError(f"{directory}: run {run.spec.run_id}: left no flight to explain")
        golden, injected = fly_watched(store, twin.spec), fly_watched(store, run.spec)
    log = injected.flight.log
    return Explanation(
        run.spec, log, golden.flight.log, log.digest() == run.record["digest"],
        first_difference(golden.publications, injected.publications), departure(golden.flight.log, log),
    )  # fmt: skip


def departure(golden: FlightLog, injected: FlightLog) -> Departure:
    """How far two flights were apart at equal instants, while both flew."""
    count = min(len(golden.rows), len(injected.rows))
    apart = injected.columns("x", "y", "z")[:count] - golden.columns("x", "y", "z")[:count]
    distance = np.linalg.norm(apart, axis=1)
    distance = np.where(np.isfinite(distance), distance, np.inf)
    farthest = int(np.argmax(distance))
    time = injected.column("time")
    left = np.flatnonzero(distance > LEFT)
    if len(left) == 0:
        return Departure(None, None, float(distance[farthest]), float(time[farthest]))
    x, y, z = (float(value) for value in injected.columns("x", "y", "z")[left[0]])
    return Departure(float(time[left[0]]), (x, y, z), float(distance[farthest]), float(time[farthest]))


def to_json(found: Explanation) -> dict[str, Any]:
    """Plain data."""
    first = found.first
    return {
        "run_id": found.spec.run_id, "setting": found.spec.setting, "environment": found.spec.environment,
        "seed": found.spec.seed, "same_digest": found.same, "injections": found.log.injections,
        "first_difference": None if first is None else {
            "time_s": 1e-6 * first.time_us, "state": first.state, "field": first.field, "golden": first.golden,
            "injected": first.injected,
        },
        "left_path": {
            "threshold_m": LEFT, "time_s": found.departure.time_s, "position": found.departure.position,
            "largest_m": found.departure.largest_m, "largest_time_s": found.departure.largest_s,
        },
        "alarms": found.log.alarms,
        "status": found.log.status.label, "flight_time_s": float(found.log.column("time")[-1]),
        "golden": {"status": found.twin.status.label, "flight_time_s": float(found.twin.column("time")[-1])},
        "masked": found.log.digest() == found.twin.digest(),
    }  # fmt: skip


def lines(found: Explanation) -> list[tuple[str, str]]:
    """The story: heading and sentence by turns."""
    spec = found.spec
    watched = f", detector {spec.detector} ({spec.profile})" if spec.detector else ""
    story = [("run", f"{spec.run_id}: {spec.environment}, seed {spec.seed}, setting {spec.setting}{watched}")]
    if not found.same:
        story.append(("note", "another digest than the stored one: other versions or another machine flew it"))
    story += [("fault", _fault(spec, injection)) for injection in found.log.injections]
    story.append(("first difference", _difference(found.first)))
    story.append(("path", _path(found.departure)))
    story += _alarms(found.log.alarms)
    story.append(("end", _end(found)))
    return story


def _fault(spec: RunSpec, injection: dict[str, Any]) -> str:
    if spec.fault is not None and not spec.fault.has_site:
        return f"{injection['site']}: no site, the golden flight never published it"
    if not injection["hit"]:
        return f"{injection['site']}: not hit, no such publication came"
    bit = "empty mask" if injection["bit"] is None else f"bit {injection['bit']}"
    change = f"{_short(injection['before'])} → {_short(injection['after'])}"
    return f"{injection['site']}, {bit}, at {injection['time_s']:.3f} s: {change}"


def _difference(first: Difference | None) -> str:
    if first is None:
        return "none: every published value is bit for bit that of the golden twin"
    where = f"{first.state}.{first.field}" if first.field else first.state
    return f"{where} at {1e-6 * first.time_us:.3f} s: golden {_short(first.golden)}, here {_short(first.injected)}"


def _path(parted: Departure) -> str:
    if parted.time_s is None or parted.position is None:
        if parted.largest_m == 0.0:
            return "never left that of the golden twin"
        farthest = f"largest distance {parted.largest_m:.2g} m at {parted.largest_s:.2f} s"
        return f"stayed within {LEFT:g} m of the golden twin's; {farthest}"
    x, y, z = parted.position
    return (
        f"left the golden twin's at {parted.time_s:.2f} s, at ({x:.1f}, {y:.1f}, {z:.1f}) m; "
        f"farthest {parted.largest_m:.1f} m at {parted.largest_s:.2f} s"
    )


def _alarms(alarms: list[dict[str, Any]]) -> list[tuple[str, str]]:
    if not alarms:
        return [("alarms", "none")]
    told = [
        ("alarm", f"{alarm['time_s']:.3f} s, {alarm['source']}: {', '.join(alarm['fields']) or alarm['stage']}, score "
                  f"{float(alarm['score']):.3g}; {alarm['action']} {alarm['stage']}: {alarm['outcome']}")
        for alarm in alarms[:8]
    ]  # fmt: skip
    return told + ([("", f"and {len(alarms) - 8} more")] if len(alarms) > 8 else [])


def _end(found: Explanation) -> str:
    now, before = float(found.log.column("time")[-1]), float(found.twin.column("time")[-1])
    told = f"{found.log.status.value} ({found.log.status.label}) after {now:.2f} s; the golden twin: "
    return told + f"{found.twin.status.label} after {before:.2f} s"


def _short(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
