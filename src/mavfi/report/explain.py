"""Step-by-step explanation of a fault's effects against the golden run, for faults of every level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from mavfi.campaign.divergence import LEFT
from mavfi.faults.fault import Fault, find_level
from mavfi.mission import MissionStatus
from mavfi.outcomes import Effect
from mavfi.record import (
    AFTERMATH,
    CONTROLLER_LOST,
    CRASHED,
    INSTANT,
    LIMITED,
    SILENCED,
    AlarmRecord,
    FlightLog,
    Injection,
    KernelEffect,
)
from mavfi.report.numbers import change, lost, signed_percent

if TYPE_CHECKING:
    from mavfi.campaign.divergence import Departure, FirstDifference, StateSpread
    from mavfi.campaign.plan import RunSpec
    from mavfi.campaign.replay import Explanation

MOST_ALARMS = 8
"""Maximum number of alarms listed individually."""
_BEHIND = 0.01
"""Shortest reported delay (s): half a control period."""
_EFFECTS = {
    Effect.MASKED: "masked: the flight is bit for bit the golden run",
    Effect.SDC: "silent data corruption",
    Effect.DETECTED: "detected by the protection of the kernel, its step was computed again",
    Effect.UNKNOWN: "unknown: the flight or its golden run has no record",
}
_KERNEL_EFFECTS = {
    "masked": "masked: its output and memory are bit for bit the golden ones",
    "sdc": "silent data corruption",
    "crash": "crashed",
    "hang": "hung",
    "exception": "raised an exception",
    "not_activated": "not reached by the fault",
}
_ROLES = {
    "": "",
    "shadow": ", its shadow",
    "copy": ", a copy for its shadow",
    "check": ", the comparison with its shadow",
}
"""Role of an instruction of protected code."""
Lines = list[tuple[str, str]]
"""Pairs of a heading and a sentence."""


def lines(found: Explanation) -> Lines:
    """Explain a run: the verdict, the run, and the steps of `steps`."""
    spec = found.spec
    log = found.flight.log
    golden = found.golden.log
    story = [("verdict", verdict(found.effect, log, golden))]
    watched = f", detector {detector_name(spec)}" if spec.detector else ""
    story.append(("run", f"{spec.run_id}: {spec.environment}, seed {spec.seed}, setting {spec.setting}{watched}"))
    if not found.same:
        story.append(("note", "another digest than the stored one: other versions or another machine flew it"))
    return story + steps(log, golden, spec.fault, spec.detector, found.first, found.departure, found.spread)


def steps(
    log: FlightLog,
    golden: FlightLog,
    fault: Fault | None,
    detector: str,
    first: FirstDifference | None,
    parted: Departure,
    spread: Sequence[StateSpread] = (),
) -> Lines:
    """Explain a flight: the fault, first difference, propagation, path, alarms, and the ends of both flights."""
    story = [line for injection in log.injections for line in injection_lines(injection, fault, log)]
    if log.kernel is None or first is not None:
        story.append(("first difference", _difference(first)))
    story += spread_lines(spread)
    story.append(("path", _path(parted)))
    story += alarm_lines(log, golden) or [("alarms", "none" if detector else "none; no detector watched")]
    watching = ", with the detector on" if detector else ""
    story.append(("golden run", f"the same mission without the fault{watching}: {end_of(golden)}"))
    story.append(("end", end_of(log)))
    return story


def spread_lines(found: Sequence[StateSpread]) -> Lines:
    """Propagation of the error: interval and number of differing values, by state."""
    if not found:
        return []
    ended = not any(one.to_the_end for one in found)
    last = 1e-6 * max(one.last_us for one in found)
    if ended:
        head = f"the error died out: nothing differs after {last:.3f} s"
    else:
        head = "the error lasted to the end"
    story = [("spread", head)]
    for one in found:
        by = f" ({one.kernel})" if one.kernel else ""
        if one.to_the_end:
            end = "to the end"
        else:
            end = f"to {1e-6 * one.last_us:.3f} s"
        count = f"{one.differing} of {one.compared} values differ"
        story.append(("", f"{1e-6 * one.first_us:.3f} s, {one.name}{by}: {count}, {end}"))
    return story


def verdict(effect: Effect, log: FlightLog, golden: FlightLog) -> str:
    """Effect of the fault on the computation, and result of the mission."""
    if not any(injection.activated for injection in log.injections):
        return f"not activated; {_mission(log, golden)}"
    kernel = log.kernel
    if kernel is not None and kernel.effect in ("crash", "hang", "exception"):
        detail = f" ({kernel.detail})" if kernel.detail else ""
        what = "the firmware" if log.count(CONTROLLER_LOST) else "a kernel"
        return f"{kernel.effect}{detail} of {what}, {after_death(log)}; {_mission(log, golden)}"
    found = _EFFECTS.get(effect, effect.label)
    if kernel is not None and kernel.effect == Effect.DETECTED.label and effect is Effect.MASKED:
        found = f"{_EFFECTS[Effect.DETECTED]}; {found}"
    return f"{found}; {_mission(log, golden)}"


_AFTER_DEATH = {"end": "the mission ended with it", "recompute": "its step was computed again"}


def after_death(log: FlightLog) -> str:
    """Consequence of a kernel's death, by the policy for dead nodes."""
    if log.count(CONTROLLER_LOST):
        return "its motors stopped"
    policy = log.meta.get("scenario", {}).get("dead_node", "fresh")
    how = "" if policy == "fresh" else f" ({policy})"
    return _AFTER_DEATH.get(policy, f"its node was restarted{how}")


def _mission(log: FlightLog, golden: FlightLog) -> str:
    end = log.status
    golden_end = golden.status
    now = _duration(log)
    before = _duration(golden)
    if MissionStatus.SUCCESS not in (end, golden_end):
        return f"the mission fails without the fault, too ({golden_end.words}; with it {end.words})"
    if end is not MissionStatus.SUCCESS:
        return f"the mission is lost: {end.words} after {now:.2f} s (golden run: success after {before:.2f} s)"
    if golden_end is not MissionStatus.SUCCESS:
        return f"the mission succeeds after {now:.2f} s, which the golden run does not ({golden_end.words})"
    if now == before:
        return f"the mission succeeds after {now:.2f} s, as without the fault"
    return f"the mission succeeds after {now:.2f} s ({signed_percent(now / before - 1)} against the golden run)"


def injection_lines(injection: Injection, fault: Fault | None, log: FlightLog) -> Lines:
    """The injected value before and after; for instructions, also source line and effect on the kernel."""
    story = [("fault", _fault(injection, fault))]
    details = injection.details
    kernel = log.kernel
    if injection.file:
        if details.get("inlined"):
            inlined = f", inlined at {', '.join(details['inlined'])}"
        else:
            inlined = ""
        if details.get("variable"):
            variable = f" of {details['variable']}"
        else:
            variable = ""
        value_class = str(details.get("value_class", "")).replace("_", " ")
        story.append(
            (
                "source line",
                f"{injection.file}:{injection.line}{inlined}: {details.get('opcode')} {details.get('type')}{variable}"
                f"{_ROLES[details.get('role', '')]}"
                f" ({value_class}), call {details.get('call')}, instruction {details.get('index')}",
            )
        )
    if "instruction" in details:
        story.append(("instruction", f"{details['instruction']} in {details['symbol'] or details['library']}"))
    if kernel is not None:
        story.append(
            (
                "process" if log.count(CONTROLLER_LOST) else "kernel",
                _kernel(str(details.get("kernel", injection.site)), kernel, after_death(log)),
            )
        )
    return story


def _fault(injection: Injection, fault: Fault | None) -> str:
    never, why = find_level(injection.level).absent
    if fault is not None and not fault.has_site:
        return f"{injection.site}: no site, the golden run never {never} it"
    if not injection.activated:
        return f"{injection.site}: not activated, {why}"
    if injection.bit is None:
        bit = injection.details.get("model", "empty mask")
    else:
        bit = _bit(injection.bit, fault)
    before, after = change(injection.before, injection.after)
    return f"{injection.site}, {bit}, at {injection.time_s:.3f} s: {before} → {after}{lost(injection)}"


def _bit(bit: int, fault: Fault | None) -> str:
    """Index of a bit, with its class if known."""
    kind = "" if fault is None else fault.bit_class
    if kind:
        return f"bit {bit} ({kind.replace('_', ' ')})"
    return f"bit {bit}"


def _kernel(name: str, kernel: KernelEffect, after: str) -> str:
    if kernel.effect == Effect.DETECTED.label:
        return f"{name}: detected by its protection; its step was computed again by plain code"
    text = f"{name}: {_KERNEL_EFFECTS.get(kernel.effect, kernel.effect)}"
    if kernel.detail:
        text += f" ({kernel.detail}); {after}"
    if kernel.effect != "sdc":
        return text
    first = kernel.first_difference
    if first is None:
        return f"{text} of what it remembers; nothing that it published differs"
    before, after = change(first["before"], first["after"])
    return f"{text}, first in {published_field(first)}: golden {before}, here {after}"


def published_field(first: Mapping[str, Any]) -> str:
    """Name of the field in a `KernelEffect.first_difference`, with state and element."""
    element = "" if first.get("element") is None else f"[{first['element']}]"
    return f"{first['state']}.{first['field']}{element}"


def _difference(first: FirstDifference | None) -> str:
    if first is None:
        return "none: every published value is bit for bit that of the golden run"
    golden = first.golden_us
    injected = first.injected_us
    if golden is None or injected is None:
        where = "here alone" if golden is None else "by the golden run alone"
        return f"{first.state} at {1e-6 * first.time_us:.3f} s: published {where}"
    later = f"{abs(injected - golden) / 1000:g} ms {'later' if injected > golden else 'earlier'}"
    if not first.field:
        if injected > golden:
            held = "held back, the same value came"
        else:
            held = "the same value came"
        return f"{first.state} at {1e-6 * golden:.3f} s in the golden run: here {held} {later}"
    before, after = change(first.golden, first.injected)
    text = f"{first.state}.{first.field} at {1e-6 * injected:.3f} s: golden {before}, here {after}"
    if injected == golden:
        return text
    return f"{text}, {later}"


def _path(parted: Departure) -> str:
    behind = ""
    if parted.behind_s is not None and abs(parted.behind_s) >= _BEHIND:
        order = "behind" if parted.behind_s > 0 else "ahead of"
        behind = f"; in the end {abs(parted.behind_s):.2f} s {order} the golden run"
    if parted.time_s is None or parted.position is None:
        if parted.largest_m == 0.0 and not behind:
            return "never left that of the golden run"
        return f"stayed within {LEFT:g} m of the golden run's (largest distance {parted.largest_m:.2g} m){behind}"
    x, y, z = parted.position
    return (
        f"left the golden run's at {parted.time_s:.2f} s, at ({x:.1f}, {y:.1f}, {z:.1f}) m; "
        f"farthest from it {parted.largest_m:.1f} m at {parted.largest_s:.2f} s{behind}"
    )


_UNANSWERED = {
    LIMITED: "no response to further alarms for a while, {alarms} had changed nothing (same_twice: limit)",
    CRASHED: "the detector is disabled from {at:.2f} s on, a call of it crashed: {how}",
    SILENCED: "no response to further alarms, the detector is faulty: {alarms} on violated rules had changed nothing",
}
"""What follows from these events."""


def alarm_lines(log: FlightLog, golden: FlightLog | None, most: int = MOST_ALARMS) -> Lines:
    """Number of alarms, then up to `most` of them, those within `AFTERMATH` of the injection first."""
    events = {event.kind: event for event in log.events if event.kind in _UNANSWERED}
    if not (log.alarms or events):
        return []
    near, others = around(log)
    if golden is None:
        known = set()
    else:
        known = {_key(alarm) for alarm in golden.alarms}
    parts = [f"{len(log.alarms)} in all"]
    if log.injections:
        parts.append(f"{len(near)} within {AFTERMATH:g} s of the injection")
    if golden is not None:
        parts.append(f"{sum(_key(alarm) in known for alarm in log.alarms)} also in the golden run")
    story = [("alarms", ", ".join(parts))]
    story += [("", _alarm(alarm, also=_key(alarm) in known)) for alarm in (*near, *others)[:most]]
    story += [("", f"and {len(log.alarms) - most} more")] if len(log.alarms) > most else []
    return story + [
        ("", _UNANSWERED[kind].format(at=1e-6 * event.time_us, **event.data)) for kind, event in events.items()
    ]


def around(log: FlightLog) -> tuple[list[AlarmRecord], list[AlarmRecord]]:
    """Alarms within `AFTERMATH` of an activated injection, and all others, in chronological order."""
    instants = [injection.time_s for injection in log.injections if injection.activated]
    near = [alarm for alarm in log.alarms if any(-INSTANT < alarm.time_s - t <= AFTERMATH for t in instants)]
    return near, [alarm for alarm in log.alarms if alarm not in near]


def _key(alarm: AlarmRecord) -> tuple[str, int]:
    return alarm.state, round(1e6 * alarm.time_s)


def _alarm(alarm: AlarmRecord, *, also: bool) -> str:
    text = f"{alarm.time_s:.3f} s, {alarm.source}: {', '.join(alarm.fields) or alarm.state or alarm.stage}, "
    text += f"score {alarm.score:.3g}; {alarm.action} {alarm.stage}: {alarm.outcome}"
    if also:
        return f"{text}; also in the golden run"
    return text


def end_of(log: FlightLog) -> str:
    """Final status and end time of a flight."""
    return f"{log.status.value} ({log.status.words}) after {_duration(log):.2f} s"


def _duration(log: FlightLog) -> float:
    return float(log.column("time")[-1])


def detector_name(spec: RunSpec) -> str:
    """Detector of a run, with its profile if it has one; "" = none."""
    if spec.detector and spec.model:
        return f"{spec.detector} ({spec.detector_profile})"
    return spec.detector


def to_json(found: Explanation) -> dict[str, Any]:
    """Plain data: verdict, effect, injections, first difference, propagation, path, all alarms, both ends."""
    spec = found.spec
    log = found.flight.log
    first = found.first
    parted = found.departure
    return {
        "run_id": spec.run_id,
        "setting": spec.setting,
        "environment": spec.environment,
        "seed": spec.seed,
        "verdict": verdict(found.effect, log, found.golden.log),
        "effect": found.effect.label,
        "same_digest": found.same,
        "injections": [injection.to_json() for injection in log.injections],
        "kernel": None if log.kernel is None else asdict(log.kernel),
        "first_difference": None
        if first is None
        else {
            "time_s": 1e-6 * first.time_us,
            "state": first.state,
            "field": first.field,
            "golden_time_s": _seconds(first.golden_us),
            "injected_time_s": _seconds(first.injected_us),
            "golden": first.golden,
            "injected": first.injected,
        },
        "spread": [asdict(one) for one in found.spread],
        "left_path": {
            "threshold_m": LEFT,
            "time_s": parted.time_s,
            "position": parted.position,
            "largest_m": parted.largest_m,
            "largest_time_s": parted.largest_s,
            "behind_s": parted.behind_s,
        },
        "alarms": [alarm.to_json() for alarm in log.alarms],
        "status": log.status.label,
        "flight_time_s": _duration(log),
        "golden": {
            "detector": spec.detector,
            "status": found.golden.log.status.label,
            "flight_time_s": _duration(found.golden.log),
        },
    }


def _seconds(microseconds: int | None) -> float | None:
    if microseconds is None:
        return None
    return 1e-6 * microseconds
