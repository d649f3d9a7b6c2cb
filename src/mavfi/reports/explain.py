"""What a fault did, step by step, against the golden twin."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from mavfi.campaign.plan import RunSpec
from mavfi.campaign.replay import golden_twin
from mavfi.campaign.store import Store
from mavfi.campaign.worker import KERNEL_KEYS
from mavfi.errors import BadInputError
from mavfi.flight_log import FlightLog
from mavfi.reports.change import change
from mavfi.reports.kernel_story import kernel_story
from mavfi.reports.watch import Difference, first_difference, fly_watched

LEFT = 0.1
"""Distance from the twin's path from which a flight counts as having left it (m)."""
_BEHIND = 0.01
"""Shortest delay that is told (s): half a control period."""


@dataclass(frozen=True, slots=True)
class Departure:
    """How far a flight went from its twin's path, whenever the twin was there; and how far it is behind.

    Attributes:
        time_s: When it was first farther than `LEFT` from the path; None if never.
        position: Where it was then (m); None if never.
        largest_m: Largest distance from the path.
        largest_s: When.
        behind_s: At its end: its time less that at which the twin passed the nearest point (s); negative = ahead, None
            where its last position is not finite.
    """

    time_s: float | None
    position: tuple[float, float, float] | None
    largest_m: float
    largest_s: float
    behind_s: float | None


@dataclass(frozen=True, slots=True)
class Explanation:
    """A run and its golden twin, both flown again.

    Attributes:
        spec: The run.
        log: Its flight of now.
        twin: The golden flight of now, with the same detector.
        same: Whether the digest is the stored one.
        first: First publication that differs; None = masked, or a fault in an instruction: its flight ends in a forked
            process, and `kernel_outcome` of its log has the first difference.
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
        store.require_flights()
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
        first_difference(golden.publications, injected.publications) if injected.publications else None,
        departure(golden.flight.log, log),
    )  # fmt: skip


def departure(golden: FlightLog, injected: FlightLog) -> Departure:
    """How far a flight went from the path of its golden twin, and how far behind it ended."""
    time = injected.column("time")
    distance, passed = _nearest(golden, injected.columns("x", "y", "z"))
    farthest = int(np.argmax(distance))
    behind = float(time[-1] - passed[-1]) if np.isfinite(distance[-1]) else None
    left = np.flatnonzero(distance > LEFT)
    largest = (float(distance[farthest]), float(time[farthest]), behind)
    if len(left) == 0:
        return Departure(None, None, *largest)
    x, y, z = (float(value) for value in injected.columns("x", "y", "z")[left[0]])
    return Departure(float(time[left[0]]), (x, y, z), *largest)


def _nearest(golden: FlightLog, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of points from a flown path, and when that flight was there.

    The nearest of the flight's positions is looked for, then the nearest point of the two legs that meet there.

    Args:
        golden: The flight; its positions are finite.
        points: Shape (n, 3) (m).

    Returns:
        Distances (m), infinite for points that are not finite, and instants (s). Shapes (n,), (n,).
    """
    path, time = golden.columns("x", "y", "z"), golden.column("time")
    distance, passed = np.full(len(points), np.inf), np.zeros(len(points))
    finite = np.flatnonzero(np.isfinite(points).all(axis=1))
    place = points[finite]
    distance[finite], row = cKDTree(path).query(place)
    passed[finite] = time[row]
    for begin in (np.maximum(row - 1, 0), np.minimum(row, max(0, len(path) - 2))):
        end = np.minimum(begin + 1, len(path) - 1)
        leg = path[end] - path[begin]
        square = (leg**2).sum(axis=1)
        along = ((place - path[begin]) * leg).sum(axis=1) / np.where(square > 0.0, square, 1.0)
        along = np.clip(along, 0.0, 1.0)
        apart = np.linalg.norm(place - path[begin] - along[:, None] * leg, axis=1)
        nearer = apart < distance[finite]
        distance[finite[nearer]] = apart[nearer]
        passed[finite[nearer]] = (time[begin] + along * (time[end] - time[begin]))[nearer]
    return distance, passed


def to_json(found: Explanation) -> dict[str, Any]:
    """Plain data."""
    first = found.first
    return {
        "run_id": found.spec.run_id, "setting": found.spec.setting, "environment": found.spec.environment,
        "seed": found.spec.seed, "same_digest": found.same, "injections": found.log.injections,
        "first_difference": None if first is None else {
            "time_s": 1e-6 * first.time_us, "state": first.state, "field": first.field,
            "golden_time_s": _seconds(first.golden_us), "injected_time_s": _seconds(first.injected_us),
            "golden": first.golden, "injected": first.injected,
        },
        "left_path": {
            "threshold_m": LEFT, "time_s": found.departure.time_s, "position": found.departure.position,
            "largest_m": found.departure.largest_m, "largest_time_s": found.departure.largest_s,
            "behind_s": found.departure.behind_s,
        },
        **{key: found.log.meta[key] for key in KERNEL_KEYS if key in found.log.meta},
        "alarms": found.log.alarms,
        "status": found.log.status.label, "flight_time_s": float(found.log.column("time")[-1]),
        "golden": {
            "detector": found.spec.detector, "status": found.twin.status.label,
            "flight_time_s": float(found.twin.column("time")[-1]),
        },
        "masked": found.log.digest() == found.twin.digest(),
    }  # fmt: skip


def lines(found: Explanation) -> list[tuple[str, str]]:
    """The story: heading and sentence by turns."""
    spec = found.spec
    story = [("run", f"{spec.run_id}: {spec.environment}, seed {spec.seed}, setting {spec.setting}{_watched(spec)}")]
    if not found.same:
        story.append(("note", "another digest than the stored one: other versions or another machine flew it"))
    story.append(("golden twin", "the same mission without the fault" + (", the detector on" if spec.detector else "")))
    for injection in found.log.injections:
        story.append(("fault", _fault(spec, injection)))
        story += kernel_story(injection, found.log.meta.get("kernel_outcome"))
    if "kernel_outcome" not in found.log.meta:
        story.append(("first difference", _difference(found.first)))
    story.append(("path", _path(found.departure)))
    story += _alarms(found.log.alarms)
    story.append(("end", _end(found)))
    return story


def _watched(spec: RunSpec) -> str:
    if not spec.detector:
        return ""
    return f", detector {spec.detector}" + (f" ({spec.profile})" if spec.model else "")  # without a model: no profile


def _fault(spec: RunSpec, injection: dict[str, Any]) -> str:
    if spec.fault is not None and not spec.fault.has_site:
        return f"{injection['site']}: no site, the golden flight never published it"
    if not injection["hit"]:
        if injection["level"] == "instruction":
            return f"{injection['site']}: not hit, the instruction was not executed"
        return f"{injection['site']}: not hit, no such publication came"
    bit = injection.get("model", "empty mask") if injection["bit"] is None else f"bit {injection['bit']}"
    before, after = change(injection["before"], injection["after"])
    return f"{injection['site']}, {bit}, at {injection['time_s']:.3f} s: {before} → {after}"


def _difference(first: Difference | None) -> str:
    if first is None:
        return "none: every published value is bit for bit that of the golden twin"
    golden, injected = first.golden_us, first.injected_us
    if golden is None or injected is None:
        which = "here alone" if golden is None else "by the golden twin alone"
        return f"{first.state} at {1e-6 * first.time_us:.3f} s: published {which}"
    later = _later(injected - golden)
    if not first.field:
        held = "held back, the same value came" if injected > golden else "the same value came"
        return f"{first.state} at {1e-6 * golden:.3f} s in the golden twin: here {held} {later}"
    before, after = change(first.golden, first.injected)
    told = f"{first.state}.{first.field} at {1e-6 * injected:.3f} s: golden {before}, here {after}"
    return told if injected == golden else f"{told}, {later}"


def _later(microseconds: int) -> str:
    return f"{abs(microseconds) / 1000:g} ms {'later' if microseconds > 0 else 'earlier'}"


def _seconds(microseconds: int | None) -> float | None:
    return None if microseconds is None else 1e-6 * microseconds


def _path(parted: Departure) -> str:
    behind = _behind(parted.behind_s)
    if parted.time_s is None or parted.position is None:
        if parted.largest_m == 0.0 and not behind:
            return "never left that of the golden twin"
        return f"stayed within {LEFT:g} m of the golden twin's (largest distance {parted.largest_m:.2g} m){behind}"
    x, y, z = parted.position
    return (
        f"left the golden twin's at {parted.time_s:.2f} s, at ({x:.1f}, {y:.1f}, {z:.1f}) m; "
        f"farthest from it {parted.largest_m:.1f} m at {parted.largest_s:.2f} s{behind}"
    )


def _behind(seconds: float | None) -> str:
    """How far the flight ended behind its twin, measured where the twin passed nearest."""
    if seconds is None or abs(seconds) < _BEHIND:
        return ""
    return f"; in the end {abs(seconds):.2f} s {'behind' if seconds > 0 else 'ahead of'} the twin"


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
