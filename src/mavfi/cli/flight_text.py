"""One flight as text for people."""

from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from mavfi.cli.flown import Flown, outcome, replans, to_json
from mavfi.faults.strata import bit_class
from mavfi.mission import MissionStatus
from mavfi.outcomes import Outcome
from mavfi.reports.change import change
from mavfi.reports.kernel_story import kernel_story
from mavfi.states import STATES

_MEANING = {
    Outcome.MASKED.label: "bit for bit the golden flight",
    Outcome.SDC.label: "another flight than the golden one",
    Outcome.UNKNOWN.label: Outcome.UNKNOWN.value,
}
MOST_ALARMS = 6
"""Alarms that are shown one by one."""


def panel(flown: Flown) -> Panel:
    """The flight in a frame: how it ended, its figures, the fault, the alarms, the digest."""
    data = to_json(flown)
    success = flown.flight.log.status is MissionStatus.SUCCESS
    colour = "green" if success else "red"
    head = Text.assemble((f"{'✓' if success else '✗'} {flown.flight.log.status.value}", f"bold {colour}"))
    parts: list[RenderableType] = [head, Text(), _figures(flown, data)]
    parts += [part for part in (_fault(flown, data), _alarms(data)) if part is not None]
    parts += [Text(), Text(f"digest {data['digest'][:16]}…", style="dim")]
    watched = f" · detector {flown.detector}" if flown.detector else ""
    title = f"[bold]{data['environment']}[/bold] · seed {data['seed']} · stack [bold]{data['stack']}[/bold]{watched}"
    below = f"{data['platform']} · {data['planner']} · {data['v_max']:g} m/s"
    return Panel(
        Group(*parts), title=title, subtitle=f"[dim]{below}[/dim]", box=box.ROUNDED, border_style=colour,
        padding=(1, 2), expand=False, title_align="left", subtitle_align="right",
    )  # fmt: skip


def _figures(flown: Flown, data: dict[str, Any]) -> Table:
    golden = data["golden"]
    table = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0), show_header=golden is not None)
    for heading in ("", "this flight", "golden", "difference"):
        table.add_column(heading, justify="left" if not heading else "right", header_style="dim")
    rows = (
        ("flight time", "flight_time_s", 1.0, " s"),
        ("energy", "energy_j", 1e-3, " kJ"),
        ("distance", "distance_m", 1.0, " m"),
    )
    for label, key, scale, unit in rows:
        beside = () if golden is None else (f"{golden[key] * scale:.1f}{unit}", _relative(data[key], golden[key]))
        table.add_row(label, f"{data[key] * scale:.1f}{unit}", *beside)
    if data["wind"] > 0.0:
        table.add_row("wind gusts", f"{data['wind']:g} m/s")
    if data["localization"] != "truth":
        table.add_row("localization", data["localization"])
    ours = replans(flown.flight)
    if flown.golden is None:
        table.add_row("replans", str(ours))
    else:
        table.add_row("replans", str(ours), str(replans(flown.golden)), f"{ours - replans(flown.golden):+d}")
    table.add_row("[dim]course[/dim]", f"[dim]{data['course_m']:.1f} m[/dim]")
    table.add_row("[dim]time limit[/dim]", f"[dim]{data['time_limit_s']:.1f} s[/dim]")
    return table


def _relative(value: float, beside: float) -> str:
    return f"{100 * (value / beside - 1):+.1f} %" if beside > 0 else ""


def _fault(flown: Flown, data: dict[str, Any]) -> RenderableType | None:
    if flown.fault is None:
        return None
    lines = [Text()]
    for injection in data["injections"]:
        place = Text.assemble(("fault  ", "bold"), (injection["site"], "cyan"))
        if not injection["hit"]:
            lines.append(place.append("  not hit: no such publication came", style="yellow"))
            continue
        bit = f"bit {injection['bit']} ({_class(flown)})"
        if injection["bit"] is None:
            bit = injection.get("model", "empty mask")
        lines.append(place.append(f"  {bit}  at {injection['time_s']:.3f} s"))
        lines += [Text(f"       {sentence}") for _, sentence in kernel_story(injection, data.get("kernel_outcome"))]
        lines.append(Text(f"       {' → '.join(change(injection['before'], injection['after']))}"))
    verdict = outcome(flown)
    lines.append(Text.assemble("       ", (f"{verdict}: ", "bold"), (_MEANING[verdict or ""], "dim")))
    return Group(*lines)


def _class(flown: Flown) -> str:
    if flown.fault is None or flown.fault.bit is None:
        return ""
    if flown.fault.instruction is not None:
        return flown.fault.stratum
    return bit_class(STATES[flown.fault.site.state].find(flown.fault.site.field), flown.fault.bit)


def _alarms(data: dict[str, Any]) -> RenderableType | None:
    alarms = data["alarms"]
    if not alarms:
        return Text("\nno alarm", style="dim") if data["detector"] else None
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for heading in ("alarm", "stage", "score", "fields", "action", "outcome"):
        table.add_column(heading, justify="right" if heading == "score" else "left")
    for alarm in alarms[:MOST_ALARMS]:
        fields = ", ".join(alarm["fields"][:2]) + (" …" if len(alarm["fields"]) > 2 else "")
        time, score = f"{alarm['time_s']:.3f} s", f"{float(alarm['score']):.3g}"
        table.add_row(time, alarm["stage"], score, fields, alarm["action"], alarm["outcome"])
    more = len(alarms) - MOST_ALARMS
    return Group(Text(), table, *([Text(f"and {more} more", style="dim")] if more > 0 else []))
