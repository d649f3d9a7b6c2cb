"""Write the documentation derived from code: the state table, ROS graph and topics, and the reference pages."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import cast

from mavfi.errors import BadInputError
from mavfi.extras.mavlink.autopilot import TYPES as MAVLINK_TYPES
from mavfi.extras.mavlink.autopilot import UNITS as MAVLINK_UNITS
from mavfi.extras.ros.ros1.host import configure
from mavfi.extras.ros.ros1.messages import PACKAGE as PACKAGE_OF_MESSAGES
from mavfi.extras.ros.ros1.messages import type_name
from mavfi.extras.ros.ros1.plan import WORLD, Graph
from mavfi.faults.levels.sensor.fault import NULL, TYPES, UNITS, Device, SensorFault, check_read
from mavfi.faults.strata import WORD_BITS
from mavfi.flight.compose import new_loop, resolve
from mavfi.flight.host import find_host, host_class
from mavfi.flight.loop import CONTROL_PERIOD_US
from mavfi.mission import MissionSpec
from mavfi.pipeline.memory import Remembers
from mavfi.pipeline.ppc import build_pipeline
from mavfi.pipeline.words import words_of
from mavfi.states import AUTOPILOTS, STATES, Field, StateSpec
from tools import build_reference
from tools.fault_levels import level_table
from tools.markers import DOCS, between

_INSTANT_US = 10_000_000


def field_text(field: Field) -> str:
    """Name and unit, and the profiles that read the field unless all do."""
    readers = "" if set(field.read_in) == set(AUTOPILOTS) else f" [{', '.join(field.read_in) or 'dead'}]"
    return f"`{field.name}` ({field.unit}){readers}"


def state_row(state: StateSpec) -> str:
    """One row of the table of states."""
    header = ", ".join(map(field_text, state.header))
    elements = ", ".join(map(field_text, state.elements))
    fields = f"per {state.element}: {elements}; once: {header}" if state.elements else header
    when = f"{state.rate}; only with localization `{state.only_with}`" if state.only_with else state.rate
    return f"| `{state.name}` | {state.writer} | {when} | {fields} |"


def state_table() -> str:
    """The table of states."""
    rows = ["| state | kernel | published | fields (unit) |", "|---|---|---|---|", *map(state_row, STATES.values())]
    return "\n".join(rows)


def _graph() -> Graph:
    config = configure(resolve(MissionSpec(environment="sparse", seed=0)))
    return Graph(build_pipeline(config))


def memory_table() -> str:
    """The table of kernel memories, 10 s into a flight of the default mission."""
    loop = new_loop(resolve(MissionSpec()))
    loop.begin()
    loop.run(_INSTANT_US // CONTROL_PERIOD_US)
    lines = ["| kernel | words, by name | kbit |", "|---|---|---:|"]
    for name, kernel in loop.kernels.items():
        found = list(words_of(cast(Remembers, kernel)))
        fields: dict[str, list[str]] = {}
        for words in found:
            start, _, last = re.sub(r"\[\d+\]", "[ ]", words.name).rpartition(".")
            if last not in fields.setdefault(start, []):
                fields[start].append(last)
        shown = ", ".join(f"`{start}.`({', '.join(own)})" if start else ", ".join(own) for start, own in fields.items())
        kbits = sum(words.count * WORD_BITS[words.dtype] for words in found) / 1000
        lines.append(f"| `{name}` | {shown} | {kbits:,.1f} |")
    return "\n".join(lines)


def ros_topics() -> str:
    """The table of the loop's topics on ROS."""
    lines = ["| topic | type | published by | read by |", "|---|---|---|---|"]
    for state, way in _graph().ways.items():
        kind = f"{PACKAGE_OF_MESSAGES}/{type_name(STATES[state])}"
        lines.append(f"| `{way.final}` | `{kind}` | {way.writer} | {', '.join(way.readers)} |")
    return "\n".join(lines)


def ros_graph() -> str:
    """Nodes and topics of a flight as a diagram."""
    arrows: dict[tuple[str, str], list[str]] = {}
    for state, way in _graph().ways.items():
        for reader in way.readers or (WORLD,):
            if reader != way.writer:
                arrows.setdefault((way.writer, reader), []).append(state.split(".")[1])
    lines = [f"    {writer} -- {', '.join(names)} --> {reader}" for (writer, reader), names in arrows.items()]
    return "\n".join(["```mermaid", "flowchart LR", *lines, "```"])


def unit_text(name: str, unit: Device) -> str:
    """One row of the table of units."""
    error = f"{unit.error:+.0%}" if unit.relative else f"{unit.error:.3g}"
    low = "0" if unit.relative else f"−{unit.spread:.3g}"
    label = f"`{name}`, `{name}1` to `{name}{unit.instances}`" if unit.instances > 1 else f"`{name}`"
    return f"| {label} | {unit.readers} | {error} | {low} to {unit.spread:.3g} |"


def _executed(unit: str, host: str, controller: str = "cascade", localization: str = "truth") -> bool:
    """Whether a host executes failures of a unit in missions with a flight controller and localization."""
    levels = cast(frozenset[str], find_host(host).levels if host == "local" else host_class(host).levels)
    if SensorFault.level not in levels:
        return False
    try:
        check_read(unit, controller, localization)
    except BadInputError:
        return False
    return True


def sensor_table() -> str:
    """Units, types of failures, and which of them each host executes."""
    columns: dict[str, Callable[[str], bool]] = {
        "`local`": lambda unit: _executed(unit, "local"),
        "`local`, estimator": lambda unit: _executed(unit, "local", localization="estimator"),
        "`firmware`": lambda unit: _executed(unit, "firmware", "betaflight"),
        "`airsim_program`": lambda unit: _executed(unit, "airsim_program", ""),
        "MAVLink": lambda unit: unit in MAVLINK_UNITS.values(),
        "`ros1`": lambda unit: _executed(unit, "ros1"),
        "`ros1`, estimator": lambda unit: _executed(unit, "ros1", localization="estimator"),
        "`node`": lambda unit: _executed(unit, "node"),
    }
    absent = [kind for kind in TYPES if kind not in MAVLINK_TYPES.values()]
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
        rows.append(f"| `{unit}` | " + " | ".join("yes" if of(unit) else "no" for of in columns.values()) + " |")
    rows += ["", f"MAVLink has no command for {', '.join(f'`{kind}`' for kind in absent)}; `ok` ends failures there."]
    return "\n".join(rows)


def ros_page() -> str:
    """The ROS page with its generated parts."""
    page = (DOCS / "ros.md").read_text(encoding="utf-8")
    for name, block in (("graph", ros_graph()), ("topics", ros_topics())):
        page = between(page, name, block)
    return page


def pages() -> dict[Path, str]:
    """Every generated page with its current content."""
    fault_model = DOCS / "fault-model.md"
    model = between(fault_model.read_text(encoding="utf-8"), "states", state_table())
    model = between(model, "sensors", sensor_table())
    model = between(model, "levels", level_table())
    return {
        DOCS / "ros.md": ros_page(),
        fault_model: between(model, "memory", memory_table()),
        **build_reference.pages(),
    }


if __name__ == "__main__":
    for written, content in pages().items():
        written.write_text(content, encoding="utf-8")
