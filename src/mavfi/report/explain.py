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
from mavfi.report.numbers import change, corruption, outcome, signed_percent

if TYPE_CHECKING:
    from mavfi.campaign.divergence import Departure, FirstDifference, StateSpread
    from mavfi.campaign.plan import RunSpec
    from mavfi.campaign.replay import Explanation

MAX_ALARMS = 8
"""Maximum number of alarms listed individually."""
OTHER_DIGEST = "another digest than the stored one: other versions or another machine flew it"
"""Note on a flight that is not the one of the ledger."""
_SHORTEST_DELAY = 0.01
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
Story = list[tuple[str, str]]
"""Pairs of a heading and a sentence."""


def lines(explanation: Explanation) -> Story:
    """Explain a run: the verdict, the run, and the steps of `steps`."""
    spec = explanation.spec
    log = explanation.flight.log
    golden = explanation.golden.log
    story = [("verdict", verdict(explanation.effect, log, golden))]
    run = f"{spec.run_id}: {spec.environment}, seed {spec.seed}, setting {spec.setting}"
    if spec.detector:
        run = f"{run}, detector {detector_name(spec)}"
    story.append(("run", run))
    if not explanation.same:
        story.append(("note", OTHER_DIGEST))
    return story + steps(
        log, golden, spec.fault, spec.detector, explanation.first, explanation.departure, explanation.spread
    )


def steps(
    log: FlightLog,
    golden: FlightLog,
    fault: Fault | None,
    detector: str,
    first: FirstDifference | None,
    departure: Departure,
    spread: Sequence[StateSpread] = (),
) -> Story:
    """Explain a flight: the fault, first difference, propagation, path, alarms, and the ends of both flights.

    Args:
        log: The flight.
        golden: Its golden run.
        fault: The fault; None = as recorded by the injections alone.
        detector: Detector that watched both flights; "" = none.
        first: First published value that differs; None = none.
        departure: Where and how far the path left the golden one.
        spread: States that differ, in the order of their first difference.
    """
    story = [line for injection in log.injections for line in injection_lines(injection, fault, log)]
    # an effect on a kernel already tells what differs, or that nothing does
    if log.kernel is None or first is not None:
        story.append(("first difference", _first_difference(first)))
    story += spread_lines(spread)
    story.append(("path", _path(departure)))
    no_alarm = "none; no detector watched"
    golden_run = "the same mission without the fault"
    if detector:
        no_alarm = "none"
        golden_run = f"{golden_run}, with the detector on"
    story += alarm_lines(log, golden) or [("alarms", no_alarm)]
    story.append(("golden run", f"{golden_run}: {end_of(golden)}"))
    story.append(("end", end_of(log)))
    return story


def spread_lines(spread: Sequence[StateSpread]) -> Story:
    """Propagation of the error: interval and number of differing values, by state."""
    if not spread:
        return []
    summary = "the error lasted to the end"
    if not any(state.to_the_end for state in spread):
        last = 1e-6 * max(state.last_us for state in spread)
        summary = f"the error died out: nothing differs after {last:.3f} s"
    story = [("spread", summary)]
    for state in spread:
        name = state.name
        if state.kernel:
            name = f"{name} ({state.kernel})"
        end = "to the end"
        if not state.to_the_end:
            end = f"to {1e-6 * state.last_us:.3f} s"
        count = f"{state.differing} of {state.compared} values differ"
        story.append(("", f"{1e-6 * state.first_us:.3f} s, {name}: {count}, {end}"))
    return story


def verdict(effect: Effect, log: FlightLog, golden: FlightLog) -> str:
    """Effect of the fault on the computation, and result of the mission."""
    if not any(injection.activated for injection in log.injections):
        return f"not activated; {_mission(log, golden)}"
    kernel = log.kernel
    if kernel is not None and has_died(log):
        death = kernel.effect
        if kernel.detail:
            death = f"{death} ({kernel.detail})"
        victim = "the firmware" if log.count(CONTROLLER_LOST) else "a kernel"
        return f"{death} of {victim}, {after_death(log)}; {_mission(log, golden)}"
    text = _EFFECTS.get(effect, effect.label)
    if effect is Effect.SDC and is_failure(log.injections):
        text = "another flight than the golden run"
    # masked because the protection has computed the step again
    if kernel is not None and kernel.effect == Effect.DETECTED.label and effect is Effect.MASKED:
        text = f"{_EFFECTS[Effect.DETECTED]}; {text}"
    return f"{text}; {_mission(log, golden)}"


def has_died(log: FlightLog) -> bool:
    """Whether the fault has ended a kernel or the firmware, which is not silent."""
    return log.kernel is not None and log.kernel.effect in ("crash", "hang", "exception")


def is_failure(injections: Sequence[Injection]) -> bool:
    """Whether a sensor, motor or message fails, alone or with other faults: the flight is no silent data corruption."""
    activated = [injection for injection in injections if injection.activated]
    return not all(find_level(injection.level).corrupts_data for injection in activated or injections)


_AFTER_DEATH = {"end": "the mission ended with it", "recompute": "its step was computed again"}


def after_death(log: FlightLog) -> str:
    """Consequence of a kernel's death, by the policy for dead nodes."""
    if log.count(CONTROLLER_LOST):
        return "its motors stopped"
    policy = log.meta.get("scenario", {}).get("dead_node", "fresh")
    if policy in _AFTER_DEATH:
        return _AFTER_DEATH[policy]
    if policy == "fresh":
        return "its node was restarted"
    return f"its node was restarted ({policy})"


def _mission(log: FlightLog, golden: FlightLog) -> str:
    """Result of the mission against that of the golden run."""
    status = log.status
    golden_status = golden.status
    time_s = _duration(log)
    golden_s = _duration(golden)
    if MissionStatus.SUCCESS not in (status, golden_status):
        return f"the mission fails without the fault, too ({golden_status.words}; with it {status.words})"
    if status is not MissionStatus.SUCCESS:
        return f"the mission is lost: {status.words} after {time_s:.2f} s (golden run: success after {golden_s:.2f} s)"
    if golden_status is not MissionStatus.SUCCESS:
        return f"the mission succeeds after {time_s:.2f} s, which the golden run does not ({golden_status.words})"
    if time_s == golden_s:
        return f"the mission succeeds after {time_s:.2f} s, as without the fault"
    return f"the mission succeeds after {time_s:.2f} s ({signed_percent(time_s / golden_s - 1)} against the golden run)"


def injection_lines(injection: Injection, fault: Fault | None, log: FlightLog) -> Story:
    """The injected value before and after; for instructions, also source line and effect on the kernel."""
    story = [("fault", _fault(injection, fault, log))]
    details = injection.details
    for further in details.get("also", ()):
        before, after = change(further["before"], further["after"])
        story.append(("also", f"{further['field']}, bit {further['bit']}: {before} → {after}"))
    if injection.file:
        story.append(("source line", _source_line(injection)))
    if "instruction" in details:
        story.append(("instruction", f"{details['instruction']} in {details['symbol'] or details['library']}"))
    if log.kernel is not None and details.get("died", True):  # with several faults, another one may have killed it
        heading = "process" if log.count(CONTROLLER_LOST) else "kernel"
        name = str(details.get("kernel", injection.site))
        story.append((heading, _kernel(name, log.kernel, after_death(log))))
    return story


def _source_line(injection: Injection) -> str:
    """Source line and instruction of a fault in compiled code, with the number of the call and of the instruction."""
    details = injection.details
    line = f"{injection.file}:{injection.line}"
    if details.get("inlined"):
        line += f", inlined at {', '.join(details['inlined'])}"
    instruction = f"{details.get('opcode')} {details.get('type')}"
    if details.get("variable"):
        instruction += f" of {details['variable']}"
    instruction += _ROLES[details.get("role", "")]
    value_class = str(details.get("value_class", "")).replace("_", " ")
    return f"{line}: {instruction} ({value_class}), call {details.get('call')}, instruction {details.get('index')}"


def _fault(injection: Injection, fault: Fault | None, log: FlightLog) -> str:
    """Site, bit, instant, and the value before and after; or why nothing was injected."""
    never, reason = find_level(injection.level).absent
    if fault is not None and not fault.has_site:
        return f"{injection.site}: no site, the golden run never {never} it"
    if "start" in injection.details:
        return f"{injection.site}: not activated, its {injection.details['start']} did not come"
    if not injection.activated and injection.time_s > _duration(log):
        due = f"due at {injection.time_s:.2f} s, the mission ended at {_duration(log):.2f} s"
        return f"{injection.site}: not activated, {due}"
    if not injection.activated:
        return f"{injection.site}: not activated, {reason}"
    if injection.bit is None:
        what = corruption(injection) or injection.details.get("model", "empty mask")
    elif fault is None or not fault.bit_class:
        what = f"bit {injection.bit}"
    else:
        what = f"bit {injection.bit} ({fault.bit_class.replace('_', ' ')})"
    text = f"{injection.site}, {what}, at {injection.time_s:.3f} s: {outcome(injection)}"
    count = injection.details.get("publications", 1)
    if "operation" in injection.details and injection.before is not None and count > 1:
        text += f", {count} publications"
    for key, unit in (("periods", "control periods"), ("calls", "calls")):
        if key in injection.details:
            text += f", in {injection.details[key]} {unit}"
    return text


def _kernel(name: str, kernel: KernelEffect, consequence: str) -> str:
    """Effect on a kernel; `consequence` tells what followed if it died."""
    if kernel.effect == Effect.DETECTED.label:
        return f"{name}: detected by its protection; its step was computed again by plain code"
    text = f"{name}: {_KERNEL_EFFECTS.get(kernel.effect, kernel.effect)}"
    if kernel.detail:
        text += f" ({kernel.detail}); {consequence}"
    if kernel.effect != "sdc":
        return text
    first = kernel.first_difference
    if first is None:
        return f"{text} of what it remembers; nothing that it published differs"
    before, after = change(first["before"], first["after"])
    return f"{text}, first in {published_field(first)}: golden {before}, here {after}"


def published_field(first: Mapping[str, Any]) -> str:
    """Name of the field in a `KernelEffect.first_difference`, with state and element."""
    field = f"{first['state']}.{first['field']}"
    if first.get("element") is None:
        return field
    return f"{field}[{first['element']}]"


def _first_difference(first: FirstDifference | None) -> str:
    """The first publication that differs from that of the golden run, in a sentence."""
    if first is None:
        return "none: every published value is bit for bit that of the golden run"
    golden_us = first.golden_us
    injected_us = first.injected_us
    # one of the flights did not publish
    if golden_us is None:
        return f"{first.state} at {1e-6 * first.time_us:.3f} s: published here alone"
    if injected_us is None:
        return f"{first.state} at {1e-6 * first.time_us:.3f} s: published by the golden run alone"
    # both published, perhaps at different instants; without a field, the same value
    shift = f"{abs(injected_us - golden_us) / 1000:g} ms earlier"
    arrival = "the same value came"
    if injected_us > golden_us:
        shift = f"{(injected_us - golden_us) / 1000:g} ms later"
        arrival = "held back, the same value came"
    if not first.field:
        return f"{first.state} at {1e-6 * golden_us:.3f} s in the golden run: here {arrival} {shift}"
    before, after = change(first.golden, first.injected)
    text = f"{first.state}.{first.field} at {1e-6 * injected_us:.3f} s: golden {before}, here {after}"
    if injected_us == golden_us:
        return text
    return f"{text}, {shift}"


def _path(departure: Departure) -> str:
    """Deviation from the path of the golden run, and the delay at the end, in a sentence."""
    delay = ""
    if departure.behind_s is not None and abs(departure.behind_s) >= _SHORTEST_DELAY:
        order = "behind" if departure.behind_s > 0 else "ahead of"
        delay = f"; in the end {abs(departure.behind_s):.2f} s {order} the golden run"
    if departure.time_s is None or departure.position is None:
        if departure.largest_m == 0.0 and not delay:
            return "never left that of the golden run"
        return f"stayed within {LEFT:g} m of the golden run's (largest distance {departure.largest_m:.2g} m){delay}"
    x, y, z = departure.position
    return (
        f"left the golden run's at {departure.time_s:.2f} s, at ({x:.1f}, {y:.1f}, {z:.1f}) m; "
        f"farthest from it {departure.largest_m:.1f} m at {departure.largest_s:.2f} s{delay}"
    )


_UNANSWERED_ALARMS = {
    LIMITED: "no response to further alarms for a while, {alarms} had changed nothing (same_twice: limit)",
    CRASHED: "the detector is disabled from {at:.2f} s on, a call of it crashed: {how}",
    SILENCED: "no response to further alarms, the detector is faulty: {alarms} on violated rules had changed nothing",
}
"""Consequence of these events, after which alarms have no response."""


def alarm_lines(log: FlightLog, golden: FlightLog | None, most: int = MAX_ALARMS) -> Story:
    """Number of alarms, then up to `most` of them in order of time; of too many, those near the injection are kept."""
    events = {event.kind: event for event in log.events if event.kind in _UNANSWERED_ALARMS}
    if not (log.alarms or events):
        return []
    near, others = around(log)
    golden_alarms = set()
    if golden is not None:
        golden_alarms = {_key(alarm) for alarm in golden.alarms}
    # counts
    parts = [f"{len(log.alarms)} in all"]
    if log.injections:
        parts.append(f"{len(near)} within {AFTERMATH:g} s of the injection")
    if golden is not None:
        parts.append(f"{sum(_key(alarm) in golden_alarms for alarm in log.alarms)} also in the golden run")
    story = [("alarms", ", ".join(parts))]
    # single alarms
    selected = sorted((*near, *others)[:most], key=lambda alarm: alarm.time_s)
    for alarm in selected:
        text = f"{alarm.time_s:.3f} s, {alarm.source}: {', '.join(alarm.fields) or alarm.state or alarm.stage}, "
        text += f"score {alarm.score:.3g}; {alarm.action} {alarm.stage}: {alarm.outcome}"
        if _key(alarm) in golden_alarms:
            text += "; also in the golden run"
        story.append(("", text))
    if len(log.alarms) > most:
        story.append(("", f"and {len(log.alarms) - most} more (--json has all)"))
    # events after which alarms have no response
    for kind, event in events.items():
        story.append(("", _UNANSWERED_ALARMS[kind].format(at=1e-6 * event.time_us, **event.data)))
    return story


def around(log: FlightLog) -> tuple[list[AlarmRecord], list[AlarmRecord]]:
    """Alarms within `AFTERMATH` of an activated injection, and all others, in chronological order."""
    instants = [injection.time_s for injection in log.injections if injection.activated]
    near = [alarm for alarm in log.alarms if any(-INSTANT < alarm.time_s - t <= AFTERMATH for t in instants)]
    return near, [alarm for alarm in log.alarms if alarm not in near]


def _key(alarm: AlarmRecord) -> tuple[str, int]:
    return alarm.state, round(1e6 * alarm.time_s)


def end_of(log: FlightLog) -> str:
    """Final status and end time of a flight."""
    return f"{log.status.value.removesuffix('.')} ({log.status.words}) after {_duration(log):.2f} s"


def _duration(log: FlightLog) -> float:
    return float(log.column("time")[-1])


def detector_name(spec: RunSpec) -> str:
    """Detector of a run, with its profile if it has one; "" = none."""
    if spec.detector and spec.model:
        return f"{spec.detector} ({spec.detector_profile})"
    return spec.detector


def to_json(explanation: Explanation) -> dict[str, Any]:
    """Plain data: verdict, effect, injections, first difference, propagation, path, all alarms, both ends."""
    spec = explanation.spec
    log = explanation.flight.log
    golden = explanation.golden.log
    departure = explanation.departure
    # values first that may be absent
    kernel = None
    if log.kernel is not None:
        kernel = asdict(log.kernel)
    first = explanation.first
    first_difference = None
    if first is not None:
        first_difference = {
            "time_s": 1e-6 * first.time_us,
            "state": first.state,
            "field": first.field,
            "golden_time_s": _seconds(first.golden_us),
            "injected_time_s": _seconds(first.injected_us),
            "golden": first.golden,
            "injected": first.injected,
        }
    return {
        "run_id": spec.run_id,
        "setting": spec.setting,
        "environment": spec.environment,
        "seed": spec.seed,
        "verdict": verdict(explanation.effect, log, golden),
        "effect": explanation.effect.label,
        "same_digest": explanation.same,
        "injections": [injection.to_json() for injection in log.injections],
        "kernel": kernel,
        "first_difference": first_difference,
        "spread": [asdict(state) for state in explanation.spread],
        "left_path": {
            "threshold_m": LEFT,
            "time_s": departure.time_s,
            "position": departure.position,
            "largest_m": departure.largest_m,
            "largest_time_s": departure.largest_s,
            "behind_s": departure.behind_s,
        },
        "alarms": [alarm.to_json() for alarm in log.alarms],
        "status": log.status.label,
        "flight_time_s": _duration(log),
        "golden": {
            "detector": spec.detector,
            "status": golden.status.label,
            "flight_time_s": _duration(golden),
        },
    }


def _seconds(microseconds: int | None) -> float | None:
    if microseconds is None:
        return None
    return 1e-6 * microseconds
