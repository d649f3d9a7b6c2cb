"""Write the documentation derived from code: the state table, topics on ROS, and the reference pages."""

import re
from collections.abc import Callable, Iterable
from itertools import groupby
from pathlib import Path
from typing import cast

from mavfi.errors import BadInputError
from mavfi.extras.ros.lockstep import views
from mavfi.extras.ros.lockstep.host import configure
from mavfi.extras.ros.lockstep.plan import FlightGraph
from mavfi.faults.strata import WORD_BITS
from mavfi.flight.compose import new_loop, resolve
from mavfi.flight.host import find_host, host_class
from mavfi.flight.loop import CONTROL_PERIOD_US
from mavfi.levels.sensor.fault import NULL, TYPES, UNITS, Device, SensorFault, check_read
from mavfi.mission import MissionSpec
from mavfi.pipeline.memory import Remembers
from mavfi.pipeline.ppc import build_pipeline
from mavfi.pipeline.words import words_of
from mavfi.states import AUTOPILOTS, STATES, Field, StateSpec
from tools import build_commands, build_reference, build_schemas
from tools.fault_levels import level_table
from tools.markers import DOCS, between

_INSTANT_US = 10_000_000


def fields_text(fields: Iterable[Field]) -> str:
    """Names of fields, each unit once; then the profiles that read them unless all do."""
    parts = []
    for (unit, read_in), group in groupby(fields, key=lambda field: (field.unit, field.read_in)):
        part = " ".join(f"`{field.name}`" for field in group)
        if unit != "-":
            part += f" {unit}"
        if set(read_in) != set(AUTOPILOTS):
            part += f" [{', '.join(read_in) or 'dead'}]"
        parts.append(part)
    return ", ".join(parts)


def state_row(state: StateSpec) -> str:
    """One row of the table of states."""
    fields = fields_text(state.header)
    if state.elements:
        fields = f"per {state.element}: {fields_text(state.elements)}; once: {fields}"
    when = state.rate
    if state.only_with:
        when = f"{state.rate}; only with localization `{state.only_with}`"
    return f"| `{state.name}` | {state.writer} | {when} | {fields} |"


def state_table() -> str:
    """The table of states."""
    rows = ["| state | kernel | published | fields (unit) |", "|---|---|---|---|", *map(state_row, STATES.values())]
    return "\n".join(rows)


def _graph() -> FlightGraph:
    config = configure(resolve(MissionSpec(environment="sparse", seed=0)))
    return FlightGraph(build_pipeline(config))


def memory_table() -> str:
    """The table of kernel memories, 10 s into a flight of the default mission."""
    loop = new_loop(resolve(MissionSpec()))
    loop.begin()
    loop.run(_INSTANT_US // CONTROL_PERIOD_US)
    lines = ["| kernel | words, by name | kbit |", "|---|---|---:|"]
    for name, kernel in loop.kernels.items():
        memory = list(words_of(cast(Remembers, kernel)))
        kbits = sum(words.count * WORD_BITS[words.dtype] for words in memory) / 1000
        lines.append(f"| `{name}` | {_word_names(words.name for words in memory)} | {kbits:,.1f} |")
    return "\n".join(lines)


def _word_names(names: Iterable[str]) -> str:
    """Names of words in one line: by their common start, elements of lists once, messages by their state."""
    ends_by_start: dict[str, list[str]] = {}
    for name in names:
        start, _, end = re.sub(r"\[\d+\]", "[ ]", name).rpartition(".")
        ends = ends_by_start.setdefault(start, [])
        if end not in ends:
            ends.append(end)
    states = {
        frozenset(field.name for field in (*state.elements, *state.header)): name for name, state in STATES.items()
    }
    parts = []
    for start, ends in ends_by_start.items():
        listed = ", ".join(ends)
        if start and frozenset(ends) in states:
            listed = f"fields of `{states[frozenset(ends)]}`"
        if start:
            listed = f"`{start}.`({listed})"
        parts.append(listed)
    return ", ".join(parts)


def ros_topics() -> str:
    """The table of the loop's topics on ROS."""
    lines = ["| topic | published by | read by |", "|---|---|---|"]
    for route in _graph().routes.values():
        lines.append(f"| `{route.final}` | {route.writer} | {', '.join(route.readers)} |")
    return "\n".join(lines)


def ros_views() -> str:
    """The table of topics with standard messages."""
    rows = [
        *((topic, kind, "each control period") for topic, kind in views.TICKS.items()),
        *((topic, kind, f"`{state}`") for state, (topic, kind) in views.PUBLICATIONS.items()),
        (views.TRAJECTORY, views.TRAJECTORY_TYPE, "`planning.trajectory`"),
        *((topic, kind, "once per second") for topic, kind in views.SCENERY.items()),
        (views.LOG, views.LOG_TYPE, "events, alarms, injections, end"),
    ]
    lines = [f"| `{topic}` | {kind} | {what} |" for topic, kind, what in rows]
    return "\n".join(["| topic | type | of |", "|---|---|---|", *lines])


def unit_text(name: str, unit: Device) -> str:
    """One row of the table of units."""
    if unit.relative:
        error = f"{unit.error:+.0%}"
        low = "0"
    else:
        error = f"{unit.error:.3g}"
        low = f"−{unit.spread:.3g}"
    label = f"`{name}`"
    if unit.instances > 1:
        label = f"`{name}`, `{name}1` to `{name}{unit.instances}`"
    return f"| {label} | {unit.readers} | {error} | {low} to {unit.spread:.3g} |"


def _executed(unit: str, host: str, controller: str = "cascade", localization: str = "truth") -> bool:
    """Whether a host executes failures of a unit in missions with a flight controller and localization."""
    if host == "local":
        levels = find_host(host).levels
    else:
        levels = cast(frozenset[str], host_class(host).levels)
    if SensorFault.level not in levels:
        return False
    try:
        check_read(unit, controller, localization)
    except BadInputError:
        return False
    return True


def sensor_table() -> str:
    """Units, types of failures, and which of them each host executes."""
    # whether a unit can fail there, by heading
    columns: dict[str, Callable[[str], bool]] = {
        "`local`": lambda unit: _executed(unit, "local"),
        "`local`, estimator": lambda unit: _executed(unit, "local", localization="estimator"),
        "`firmware`": lambda unit: _executed(unit, "firmware", "betaflight"),
        "`airsim_program`": lambda unit: _executed(unit, "airsim_program", ""),
        "`ros2`": lambda unit: _executed(unit, "ros2"),
        "the same, estimator": lambda unit: _executed(unit, "ros2", localization="estimator"),
    }

    # three tables below each other: what a unit is, what a type does, who executes it
    rows = [
        "| unit | what changes | `wrong` | `garbage` |",
        "|---|---|---|---|",
        *(unit_text(name, unit) for name, unit in UNITS.items()),
        "",
        "| type | readers receive |",
        "|---|---|",
        *(f"| `{kind}` | {text} |" for kind, text in TYPES.items() if kind != NULL),
        "",
        "| executed by | " + " | ".join(columns) + " |",
        "|---|" + "---|" * len(columns),
    ]
    for unit in UNITS:
        answers = ["yes" if is_executed(unit) else "no" for is_executed in columns.values()]
        rows.append(f"| `{unit}` | {' | '.join(answers)} |")
    return "\n".join(rows)


def ros_page() -> str:
    """The page on ROS 2 with its generated parts."""
    page = (DOCS / "how-to" / "ros2.md").read_text(encoding="utf-8")
    for name, block in (("topics", ros_topics()), ("views", ros_views())):
        page = between(page, name, block)
    return page


def pages() -> dict[Path, str]:
    """Every generated page with its current content."""
    faults = DOCS / "reference" / "faults.md"
    fault_page = between(faults.read_text(encoding="utf-8"), "states", state_table())
    fault_page = between(fault_page, "sensors", sensor_table())
    levels = DOCS / "concepts" / "levels.md"
    return {
        DOCS / "how-to" / "ros2.md": ros_page(),
        faults: between(fault_page, "memory", memory_table()),
        levels: between(levels.read_text(encoding="utf-8"), "levels", level_table()),
        **build_commands.pages(),
        **build_reference.pages(),
        **build_schemas.schemas(),
    }


if __name__ == "__main__":
    for page, content in pages().items():
        page.write_text(content, encoding="utf-8")
