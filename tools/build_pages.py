"""Write what the documentation derives from the code: the states, the graph and topics of ROS, the reference pages."""

from pathlib import Path

from mavfi.hosts.loop.compose import resolve
from mavfi.hosts.ros1.definitions import PACKAGE as PACKAGE_OF_MESSAGES
from mavfi.hosts.ros1.definitions import type_name
from mavfi.hosts.ros1.graph import JUDGED_BY_WORLD, WORLD, Graph
from mavfi.hosts.ros1.mirrors import STANDARDS
from mavfi.hosts.ros1.session import configure
from mavfi.mission import MissionSpec
from mavfi.pipeline.ppc import build_pipeline
from mavfi.states import STACKS, STATES, Field, StateSpec
from tools import build_reference
from tools.markers import DOCS, between


def field_text(field: Field) -> str:
    """Name, unit, and who reads it if not everybody does."""
    readers = "" if set(field.read_in) == set(STACKS) else f" [{', '.join(field.read_in) or 'dead'}]"
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


def ros_topics() -> str:
    """The table of the loop's own topics on ROS."""
    lines = ["| topic | type | published by | read by |", "|---|---|---|---|"]
    for state, way in _graph().ways.items():
        kind = f"{PACKAGE_OF_MESSAGES}/{type_name(STATES[state])}"
        lines.append(f"| `{way.final}` | `{kind}` | {way.writer} | {', '.join(way.readers)} |")
    return "\n".join(lines)


def ros_mirrors() -> str:
    """The table of topics in standard types."""
    lines = ["| topic | type | frame | what |", "|---|---|---|---|"]
    for standard in STANDARDS:
        spec = STATES[standard.state]
        what = f"`{standard.state}`" + (f", with localization `{spec.only_with}`" if spec.only_with else "")
        lines.append(f"| `{standard.topic}` | `{standard.kind}` | `{standard.frame}` | {what} |")
    lines += [
        "| `/imu/data` | `sensor_msgs/Imu` | `base_link` | specific force and rates, with localization `truth` |",
        "| `/clock` | `rosgraph_msgs/Clock` | | simulated time; always published |",
        "| `/tf_static` | `tf2_msgs/TFMessage` | `base_link` | where the camera is |",
    ]
    return "\n".join(lines)


def ros_graph() -> str:
    """Nodes and topics of a flight as a diagram."""
    arrows: dict[tuple[str, str], list[str]] = {}
    for state, way in _graph().ways.items():
        readers = [*way.readers, *([WORLD] if state in JUDGED_BY_WORLD else [])]
        for reader in readers:
            if reader != way.writer:
                arrows.setdefault((way.writer, reader), []).append(state.split(".")[1])
    lines = [f"    {writer} -- {', '.join(names)} --> {reader}" for (writer, reader), names in arrows.items()]
    return "\n".join(["```mermaid", "flowchart LR", *lines, "```"])


def ros_page() -> str:
    """The page on ROS with its written parts."""
    page = (DOCS / "ros.md").read_text(encoding="utf-8")
    for name, block in (("graph", ros_graph()), ("topics", ros_topics()), ("mirrors", ros_mirrors())):
        page = between(page, name, block)
    return page


def pages() -> dict[Path, str]:
    """Every written page, as it should be."""
    fault_model = DOCS / "fault-model.md"
    return {
        DOCS / "ros.md": ros_page(),
        fault_model: between(fault_model.read_text(encoding="utf-8"), "states", state_table()),
        **build_reference.pages(),
    }


if __name__ == "__main__":
    for written, content in pages().items():
        written.write_text(content, encoding="utf-8")
