"""Draw docs/images/ros_graph.png, and write the output of ROS's own tools during a flight to docs/ros.md.

A flight with an injector and a detector is flown on ROS, free-running.  The picture shows the graph as reported by the
master, not as configured.  Run as `python -m tools.draw_ros_graph`.
"""

import json
import signal
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen, run

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch, PathPatch
from matplotlib.path import Path as Line

from mavfi.errors import BadInputError, MavfiError
from mavfi.faults.spec import StateRequest, parse
from mavfi.hosts.loop.compose import resolve
from mavfi.hosts.ros1 import finder
from mavfi.hosts.ros1.folder import JOIN
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.session import configure, fly, isolation
from mavfi.hosts.watching import detector_for
from mavfi.mission import MissionSpec
from mavfi.reports import style
from tools import drawing
from tools.markers import DOCS, IMAGES, between

FAULT = "state:planning.waypoint.x:bit=40@20"
REPORTS = 2
PATIENCE_S = 120.0
SHOWN = (
    ("rosnode", "list"),
    ("rostopic", "hz", "/mavfi/sensor/depth"),
    ("rostopic", "hz", "/mavfi/control/command"),
    ("rosmsg", "show", "mavfi_msgs/PlanningWaypoint"),
)
COMMANDS, CONTROL_HZ = 2, 50.0
"""Index of the command that reports the command rate, and the nominal rate (Hz)."""
MASTER = (
    "import json, os, xmlrpc.client; master = xmlrpc.client.ServerProxy(os.environ['ROS_MASTER_URI']); "
    "print(json.dumps(master.getSystemState('/picture')[2]))"
)
PREFIX = "/mavfi/"
NODES = ("world", "point_cloud", "octomap", "collision_check", "planner", "waypoint", "pid")
"""Nodes in data-flow order."""
COLOURS = {"sensor": style.GREY, "perception": style.BLUE, "planning": style.GREEN, "control": style.PURPLE}
LEFT, RAW, INJECTOR, INJECTED, DETECTOR, FINAL, RIGHT = 0.0, 2.4, 4.35, 6.35, 8.05, 10.1, 13.7
PITCH, HALF_HEIGHT = 1.0, 0.3
NODE, GATE, WRITTEN, READ = 0.98, 0.42, 0.62, 1.08
"""Half-width of a node, the detector, a topic upstream of it, and a topic downstream."""
SPREAD = 0.42
"""Spacing of the arrows that end at one reader."""
TAPS = {"injector": (INJECTOR, NODE), "detector": (DETECTOR, GATE)}


@dataclass
class Seen:
    """Observations of the flight: output by command, and the master's publishers and subscribers by topic."""

    output: dict[tuple[str, ...], str] = field(default_factory=dict)
    publishers: dict[str, list[str]] = field(default_factory=dict)
    subscribers: dict[str, list[str]] = field(default_factory=dict)


def look(folder: Path, seen: Seen) -> None:
    """Query ROS's own tools, as a user does in another terminal."""
    join = str(folder / JOIN)
    for command in SHOWN:
        if command[1] == "hz":
            seen.output[command] = rate(join, command)
        else:
            output = run([join, *command], capture_output=True, text=True, check=True).stdout
            seen.output[command] = "\n".join(line.rstrip() for line in output.strip().splitlines())
    state = run([join, sys.executable, "-c", MASTER], capture_output=True, text=True, check=True).stdout
    seen.publishers, seen.subscribers = (
        {topic: [node.removeprefix("/") for node in nodes] for topic, nodes in part} for part in json.loads(state)[:2]
    )


def rate(join: str, command: tuple[str, ...]) -> str:
    """The second report of a continuously reporting command; the first covers too short a time."""
    with Popen([join, "env", "PYTHONUNBUFFERED=1", *command], stdout=PIPE, stderr=DEVNULL, text=True) as process:
        assert process.stdout is not None
        reports = (line.rstrip() for line in process.stdout)
        found: list[str] = []
        for line in reports:
            if line.startswith("average rate"):
                found.append(line)
            if len(found) == REPORTS:
                found = [line, next(reports)]
                break
        process.send_signal(signal.SIGINT)
    return "\n".join(found)


def watch_flight() -> Seen:
    """Fly, and query the graph during the flight."""
    scenario = resolve(MissionSpec(environment="sparse", seed=7))
    request = parse(FAULT)
    assert isinstance(request, StateRequest)
    detector, _ = detector_for(scenario, "gaussian", "paper")
    plan = Plan(scenario, configure(scenario), request.resolve(0, scenario.autopilot.name, None), detector,
                free_running=True)  # fmt: skip
    seen = Seen()
    looking: list[threading.Thread] = []

    def begin(folder: Path) -> None:
        looking.append(threading.Thread(target=wait_and_look, args=(folder, seen)))
        looking[0].start()

    flown = fly(plan, tell=begin)
    looking[0].join()
    if set(SHOWN) > set(seen.output) or not seen.publishers:
        raise MavfiError(f"the flight was over ({flown.flight.log.status.label}) before everything was recorded")
    measured = float(seen.output[SHOWN[COMMANDS]].split()[2])
    if not 0.9 < measured / CONTROL_HZ < 1.1:
        raise MavfiError(
            f"commands at {measured:g} Hz, not {CONTROL_HZ:g}: the machine is too busy to fly in real time"
        )
    return seen


def wait_and_look(folder: Path, seen: Seen) -> None:
    """Query the graph as soon as all nodes are registered."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        listed = run([str(folder / JOIN), "rosnode", "list"], capture_output=True, text=True, check=False).stdout
        if {f"/{node}" for node in NODES} <= set(listed.split()):
            break
        time.sleep(0.5)
    look(folder, seen)


def transcript(seen: Seen) -> str:
    """The terminal session as a text block."""
    lines = ["```text"]
    for command in SHOWN:
        lines += [f"$ $FLIGHT/join {' '.join(command)}", seen.output[command]]
    return "\n".join([*lines, "```"])


# ---- the picture ----------------------------------------------------------------------------------------------------
def states_of(seen: Seen) -> list[str]:
    """The loop's final topics, ordered by their first publishers in data-flow order."""
    finals = [topic for topic in seen.publishers if topic.startswith(PREFIX) and topic.count("/") == 3]
    return sorted(finals, key=lambda topic: (NODES.index(first_of(seen, topic)), list(COLOURS).index(stage(topic))))


def stage(topic: str) -> str:
    """Stage in a topic's name."""
    return topic.split("/")[2]


def first_of(seen: Seen, topic: str) -> str:
    """Node that first publishes a value."""
    return seen.publishers.get(f"{topic}/raw", seen.publishers[topic])[0]


def box(axes: Axes, at: tuple[float, float], half: tuple[float, float], colour: str, *, node: bool = True) -> None:
    """Draw a node (filled) or a topic (outlined)."""
    axes.add_patch(
        FancyBboxPatch(
            (at[0] - half[0], at[1] - half[1]), 2 * half[0], 2 * half[1],
            boxstyle=f"round,pad=0,rounding_size={0.09 if node else 0.28}",
            facecolor=colour if node else "white", edgecolor=colour, linewidth=1.2, zorder=4,
        )
    )  # fmt: skip


def node_box(axes: Axes, x: float, y: float, name: str, colour: str) -> None:
    """Draw a node with its name."""
    box(axes, (x, y), (NODE, HALF_HEIGHT), colour)
    axes.text(x, y, name, ha="center", va="center", color="white", fontsize=9.5, fontweight="bold", zorder=5)


def topic_box(axes: Axes, x: float, y: float, text: str, half: float, colour: str) -> None:
    """Draw a topic with its name."""
    box(axes, (x, y), (half, HALF_HEIGHT + 0.04), colour, node=False)
    axes.text(x, y, text, ha="center", va="center", fontsize=8.5, linespacing=1.15, zorder=5)


def arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
    """Draw a curve with horizontal ends and an arrowhead."""
    middle = 0.5 * (start[0] + end[0])
    curve = Line([start, (middle, start[1]), (middle, end[1]), (end[0] - 0.09, end[1])], [1, 4, 4, 4])
    axes.add_patch(PathPatch(curve, facecolor="none", edgecolor=colour, linewidth=1.1, alpha=0.85, zorder=2))
    axes.plot(end[0] - 0.08, end[1], marker=">", color=colour, markersize=4.5, zorder=3)


def draw_lane(axes: Axes, seen: Seen, topic: str, y: float, start: float) -> tuple[float, float]:
    """Draw the route of a state from its kernel's node at height `start`; returns the end point."""
    colour = COLOURS[stage(topic)]
    at = LEFT + NODE, start
    for suffix, x, half in (("/raw", RAW, WRITTEN), ("/injected", INJECTED, WRITTEN), ("", FINAL, READ)):
        published = seen.publishers.get(topic + suffix, [])
        if not published:
            continue
        through = [node for node in TAPS if node in published]
        if through:  # the last one; those in front of a gate publish on its topic while it is down
            passed, width = TAPS[through[-1]]
            arrow(axes, at, (passed - width, y), colour)
            at = passed + width, y
        arrow(axes, at, (x - half, y), colour)
        topic_box(
            axes, x, y, f"…{suffix}" if suffix else topic.removeprefix(PREFIX).replace("/", "/\n", 1), half, colour
        )
        at = x + half, y
    return at


def draw_readers(axes: Axes, seen: Seen, ends: dict[str, tuple[float, float]], right: dict[str, float]) -> None:
    """Draw arrows from the topics to their subscribers; at a subscriber they are in topic order."""
    for node, y in right.items():
        read = [topic for topic in ends if node in seen.subscribers.get(topic, [])]
        for place, topic in enumerate(read):
            arrives = y + SPREAD * (0.5 - (place + 0.5) / len(read))
            arrow(axes, ends[topic], (RIGHT - NODE, arrives), COLOURS[stage(topic)])


def draw_rest(axes: Axes, seen: Seen, y: float) -> None:
    """List the remaining topics."""
    rejected = [topic for topic in seen.publishers if topic.endswith("/rejected")]
    others = sorted(topic for topic in seen.publishers if topic.startswith(PREFIX) and topic.count("/") == 2)
    standard = sorted(topic for topic in seen.publishers if not topic.startswith(PREFIX) and "rosout" not in topic)
    written = [f"{topic} ({', '.join(seen.publishers[topic])})" for topic in others]
    lines = [
        f"In addition: {' · '.join(written)} · …/rejected × {len(rejected)} (detector)",
        "While the detector is down, the node in front of it publishes on the last topic.",
        f"In standard types: {' · '.join(standard)}",
    ]
    axes.text(LEFT - NODE, y, "\n".join(lines), va="top", color=style.GREY, fontsize=8.5, linespacing=1.6)


def draw(seen: Seen) -> None:
    """Write the picture."""
    states = states_of(seen)
    rows = {topic: -PITCH * place for place, topic in enumerate(states)}
    writers = {node: [y for topic, y in rows.items() if first_of(seen, topic) == node] for node in NODES}
    left = {node: sum(places) / len(places) for node, places in writers.items() if places}
    bottom = -PITCH * (len(states) - 1)
    right = {node: bottom * place / (len(NODES) - 1) for place, node in enumerate((*NODES[1:], NODES[0]))}
    figure, axes = plt.subplots(figsize=(13.5, 8.0), layout="constrained")
    ends = {topic: draw_lane(axes, seen, topic, y, left[first_of(seen, topic)]) for topic, y in rows.items()}
    draw_readers(axes, seen, ends, right)
    for x, nodes in ((LEFT, left), (RIGHT, right)):
        for node, y in nodes.items():
            node_box(axes, x, y, node, style.INK)
    for topic, y in rows.items():
        if f"{topic}/injected" in seen.publishers:
            node_box(axes, INJECTOR, y, "injector", style.ORANGE)
    box(axes, (DETECTOR, 0.5 * bottom), (GATE, 0.5 * abs(bottom) + HALF_HEIGHT), style.AMBER)
    axes.text(
        DETECTOR, 0.5 * bottom, "detector", rotation=90, ha="center", va="center", color="white", fontsize=11,
        fontweight="bold", zorder=5,
    )  # fmt: skip
    for x, text in ((LEFT, "kernels publish"), (RAW, "as computed"), (FINAL, "as readers see it"), (RIGHT, "read")):
        axes.text(x, 0.72, text, ha="center", color=style.GREY, fontsize=9.5)
    draw_rest(axes, seen, bottom - 0.75)
    axes.set(xlim=(LEFT - 1.0, RIGHT + 1.0), ylim=(bottom - 1.8, 1.05))
    axes.axis("off")
    drawing.save(figure, "ros_graph.png", IMAGES)


def main() -> None:
    """Fly, draw and write; or print why this is impossible."""
    try:
        finder.require()
        isolation()
    except BadInputError as error:
        print(f"docs/images/ros_graph.png is left as it is: {error}")
        return
    seen = watch_flight()
    with style.house_style():
        draw(seen)
    page = DOCS / "ros.md"
    page.write_text(between(page.read_text(encoding="utf-8"), "terminal", transcript(seen)), encoding="utf-8")


if __name__ == "__main__":
    main()
