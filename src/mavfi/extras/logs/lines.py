"""Events, alarms, injections and the end of a flight, one line of text each."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from mavfi.mission import MissionStatus
from mavfi.record import AlarmRecord, Event, FlightLog, Injection
from mavfi.report.numbers import corruption

INFO = "info"
WARN = "warn"
ERROR = "error"


@dataclass(frozen=True, slots=True)
class LogLine:
    """One line.

    Attributes:
        time_us: Instant of the flight (us).
        level: "info", "warn" (alarm) or "error" (injection).
        name: Kind of source: "event", "alarm", "injection" or "mission".
        text: Short text.
        data: All data as plain text, "key=value ...".
    """

    time_us: int
    level: str
    name: str
    text: str
    data: str


def lines_of(log: FlightLog) -> list[LogLine]:
    """All lines of a flight by time, injections first; an injection without an instant is left out."""
    items: list[Event | AlarmRecord | Injection] = [*log.injections, *log.events, *log.alarms]
    lines = lines_at(float(log.column("time")[-1]), items, log.status)
    return sorted(lines, key=lambda line: line.time_us)


def lines_at(
    time_s: float, items: Iterable[Event | AlarmRecord | Injection], status: MissionStatus | None
) -> list[LogLine]:
    """Lines of what happened until an instant (s); with a status, also that the mission has ended then."""
    lines = [line for line in map(line_of, items) if line is not None]
    if status is not None:
        lines.append(end_line(time_s, status))
    return lines


def end_line(time_s: float, status: MissionStatus) -> LogLine:
    """The line of the end of the mission."""
    text = f"{status.label}: {status.value}"
    return LogLine(max(0, round(1e6 * time_s)), INFO, "mission", text, text)


def line_of(item: Event | AlarmRecord | Injection) -> LogLine | None:
    """The line of an event, an alarm or an injection; None if it has no finite instant."""
    if isinstance(item, Event):
        text = f"{item.kind} {_pairs(item.data)}".strip()
        return LogLine(max(0, item.time_us), INFO, "event", text, text)
    if not math.isfinite(item.time_s):
        return None
    time_us = max(0, round(1e6 * item.time_s))
    data = _pairs(item.to_json())
    if isinstance(item, AlarmRecord):
        return LogLine(
            time_us, WARN, "alarm", f"alarm: {item.source} {item.state}, {item.action}, {item.outcome}", data
        )
    if item.activated and item.before is None:
        change = "activated"
    elif item.activated:
        change = f"{_short(item.before)} -> {_short(item.after)}"
    else:
        change = "not activated"
    site = f"{item.site} {corruption(item)}".strip()
    return LogLine(time_us, ERROR, "injection", f"fault: {site}: {change}", data)


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def _pairs(data: dict[str, Any]) -> str:
    return " ".join(f"{key}={value}" for key, value in data.items() if key != "time_s")
