"""Text summary of one flight for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich import box
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from mavfi.config import EnvironmentConfig
from mavfi.flight.decide import Response
from mavfi.mission import MissionStatus
from mavfi.outcomes import Effect, QoF, quality_of
from mavfi.report.explain import alarm_lines, has_died, injection_lines, is_failure
from mavfi.report.numbers import signed_percent
from mavfi.states import PLANNERS

if TYPE_CHECKING:
    from mavfi.report.flight_result import FlightResult

_MEANING = {
    Effect.MASKED: "bit for bit the golden run",
    Effect.SDC: "another flight than the golden run",
    Effect.DETECTED: "detected by the protection, computed again",
    Effect.UNKNOWN: Effect.UNKNOWN.value,
}
MAX_ALARMS = 6
"""Number of alarms shown individually."""
_FIGURES = (
    ("flight time", "flight_time_s", 1.0, "s"),
    ("energy", "energy_j", 1e-3, "kJ"),
    ("distance", "distance_m", 1.0, "m"),
)


def panel(result: FlightResult) -> Panel:
    """The flight in a frame: status, metrics, fault, alarms, digest; names are never truncated."""
    scenario = result.scenario
    colour = "green" if result.status is MissionStatus.SUCCESS else "red"
    seed = f" · seed {scenario.seed} · autopilot "
    title = Text.assemble((scenario.environment.name, "bold"), seed, (scenario.autopilot.name, "bold"))
    if result.detector:
        title.append(f" · detector {result.detector}")
    below = f"{scenario.platform.name} · {scenario.planner.name} · {scenario.v_max:g} m/s"
    if scenario.vehicle.name != EnvironmentConfig.model_fields["vehicle"].default:
        below = f"{scenario.vehicle.name} · {below}"
    parts: list[RenderableType] = [
        title,
        Text(below, style="dim"),
        Text(),
        Text.assemble(_verdict(result.status), style="bold"),
        *_remarks(result),
        Text(),
        _figures(result),
        *_planner_time(result),
        *_fault(result),
        *_alarms(result),
        Text(),
        Text(f"digest {result.record.digest[:16]}…", style="dim"),
    ]
    return Panel(Group(*parts), box=box.ROUNDED, border_style=colour, padding=(0, 2), expand=False)


def _verdict(status: MissionStatus) -> Text:
    if status is MissionStatus.SUCCESS:
        return Text(f"✓ {status.value}", style="green")
    return Text(f"✗ {status.value}", style="red")


def _remarks(result: FlightResult) -> list[RenderableType]:
    """When recovery gave the mission up; how the flight with the same fault ended without the detector."""
    remarks: list[RenderableType] = []
    for alarm in result.log.alarms:
        if alarm.action == Response.HOLD:
            remarks.append(Text(f"  degraded mode {alarm.action!r} from {alarm.time_s:.1f} s on"))
            break
    if result.unwatched is not None:
        log = result.unwatched.log
        time = f" ({log.column('time')[-1]:.1f} s)"
        remarks.append(Text.assemble("  without the detector: ", _verdict(log.status), time))
    return remarks


def _figures(result: FlightResult) -> Table:
    """Quality of the flight against that of its golden run, then the conditions of the mission."""
    golden = result.golden_record
    table = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0), show_header=golden is not None)
    table.add_column("", header_style="dim")
    for heading in ("this flight", "golden run", "difference"):
        table.add_column(heading, justify="right", header_style="dim")
    # this flight, the golden run if there is one, and the difference, but not of a lost mission: what ends early saves
    # nothing
    both_succeed = result.golden is not None and {result.status, result.golden.log.status} == {MissionStatus.SUCCESS}
    qualities: list[QoF] = [quality_of(record) for record in (result.record, golden) if record is not None]
    for label, name, scale, unit in _FIGURES:
        values = [float(getattr(quality, name)) for quality in qualities]
        cells = [f"{scale * value:.1f} {unit}" for value in values]
        if len(values) == 2:
            change = None
            if both_succeed and values[1] > 0:
                change = values[0] / values[1] - 1
            cells.append(signed_percent(change))
        table.add_row(label, *cells)
    # conditions that are not at their defaults
    scenario = result.scenario
    record = result.record
    if scenario.wind.gust > 0.0:
        table.add_row("wind gusts", f"{scenario.wind.gust:g} m/s")
    if scenario.localization.kind != "truth":
        table.add_row("localization", scenario.localization.kind)
    replans = [str(record.replans)]
    if golden is not None:
        replans += [str(golden.replans), f"{record.replans - golden.replans:+d}"]
    table.add_row("replans", *replans)
    table.add_row("course", f"{record.course_m:.1f} m", style="dim")
    table.add_row("time limit", f"{record.time_limit_s:.1f} s", style="dim")
    return table


def _planner_time(result: FlightResult) -> list[RenderableType]:
    """What a path of a custom planner is charged as, and what it took here; empty for the planners of mavfi."""
    scenario = result.scenario
    kernel = result.flight.pipeline.get("planner")
    wall_times = sorted(getattr(getattr(kernel, "routes", None), "wall_times", ()))
    if scenario.planner.name in PLANNERS or not wall_times:
        return []
    charged_s = 1e-6 * scenario.platform.latency_us["planner"]
    text = (
        f"planner {scenario.planner.name}: a path is charged as {charged_s:.3g} s of flight; here it took "
        f"{wall_times[len(wall_times) // 2]:.2g} s (median of {len(wall_times)}); --planner-latency sets it"
    )
    return [Text(), Text(text, style="dim")]


def _fault(result: FlightResult) -> list[RenderableType]:
    """The fault and its effect; empty for a golden flight."""
    fault = result.fault
    effect = result.effect
    if fault is None or effect is None:
        return []
    log = result.log
    story = [line for injection in log.injections for line in injection_lines(injection, fault, log)]
    text = f"{effect.label}: {_MEANING.get(effect, effect.value)}"
    if effect is Effect.SDC:
        text = f"silent data corruption ({effect.label}): {_MEANING[effect]}"
    if effect is Effect.SDC and (has_died(log) or is_failure(log.injections)):
        text = _MEANING[effect]
    if effect is Effect.MASKED and not any(injection.activated for injection in log.injections):
        text = "none: nothing was injected, the flight is the golden run"
    return [Text(), story_table([*story, ("effect", text)])]


def _alarms(result: FlightResult) -> list[RenderableType]:
    """The alarms of a flight, or that there was none."""
    golden = None if result.golden is None else result.golden.log
    story = alarm_lines(result.log, golden, MAX_ALARMS)
    if story:
        return [Text(), story_table(story)]
    if result.detector:
        return [Text("\nno alarm", style="dim")]
    return []


def story_table(story: list[tuple[str, str]]) -> Table:
    """Headings and sentences in two columns; data is never interpreted as markup."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for heading, sentence in story:
        table.add_row(Text(heading, style="bold"), Text(sentence))
    return table
