"""Conversion of a flight to messages of standard ROS types: trajectory, scene and events.

Frames follow REP-103 and REP-105: `map` is the world (ENU, z up), `base_link` the vehicle (x forward, y left, z up).
"""

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import binary_erosion

from mavfi.flight_log import FlightLog
from mavfi.numerics.rotations import rotation_matrix
from mavfi.sim.environments.world import World

MAP, VEHICLE = "map", "base_link"
FIRST_STAMP_NS = 1
"""Stamp of the start of the mission: in ROS a stamp of 0 means "not set", and bags reject it."""
INFO, WARN, ERROR = "info", "warn", "error"
_OBSTACLE = {"r": 0.55, "g": 0.57, "b": 0.62, "a": 0.9}
_GOAL = {"r": 0.0, "g": 0.45, "b": 0.7, "a": 0.9}
_CUBE, _SPHERE, _CUBE_LIST = 1, 2, 6
_GOAL_SIZE = 1.0
_POSES = 1000


@dataclass(frozen=True, slots=True)
class Message:
    """A message independent of the ROS version; missing fields are zero or empty.

    `kind` is a ROS type, "package/Name", or "Log": the version's own type for log lines.
    """

    topic: str
    kind: str
    time_ns: int
    fields: dict[str, Any]


def stamp_ns(time_s: float) -> int:
    """Stamp of an instant (ns): flight time in whole microseconds."""
    return max(FIRST_STAMP_NS, 1000 * round(1e6 * time_s))


def _in_map(time_ns: int) -> dict[str, Any]:
    """Header of a message in the frame `map`."""
    return {"stamp": _time(time_ns), "frame_id": MAP}


def _time(time_ns: int) -> dict[str, int]:
    seconds, rest = divmod(time_ns, 1_000_000_000)
    return {"sec": seconds, "nanosec": rest}


def _xyz(values: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))


def _orientation(wxyz: np.ndarray) -> dict[str, float]:
    return dict(zip("wxyz", map(float, wxyz), strict=True))


def timeline(log: FlightLog, world: World) -> Iterator[Message]:
    """All messages of a flight, in chronological order.

    Yields:
        `/tf`, `/odometry`, `/command` and `/reference` at each control tick; `/obstacles`, `/goal` and `/flown` once;
        `/log` with events, alarms, injections, and the end of the mission.
    """
    yield from _scenery(log, world)
    ticks = (message for row in log.rows for message in _tick(row))
    yield from heapq.merge(ticks, _lines(log), key=lambda message: message.time_ns)


def _tick(row: np.ndarray) -> Iterator[Message]:
    time_ns = stamp_ns(row[0])
    position, orientation = _xyz(row[1:4]), _orientation(row[7:11])
    to_map = np.empty((3, 3))
    rotation_matrix(row[7:11], to_map)
    in_map = _in_map(time_ns)
    transform = {"translation": position, "rotation": orientation}
    yield Message("/tf", "tf2_msgs/TFMessage", time_ns, {
        "transforms": [{"header": in_map, "child_frame_id": VEHICLE, "transform": transform}],
    })  # fmt: skip
    yield Message("/odometry", "nav_msgs/Odometry", time_ns, {
        "header": in_map, "child_frame_id": VEHICLE,
        "pose": {"pose": {"position": position, "orientation": orientation}},
        "twist": {"twist": {"linear": _xyz(row[4:7] @ to_map), "angular": _xyz(row[11:14])}},
    })  # fmt: skip
    yield Message("/command", "geometry_msgs/TwistStamped", time_ns, {
        "header": in_map, "twist": {"linear": _xyz(row[14:17]), "angular": {"z": float(row[17])}},
    })  # fmt: skip
    yield Message("/reference", "geometry_msgs/PointStamped", time_ns, {"header": in_map, "point": _xyz(row[18:21])})


def _scenery(log: FlightLog, world: World) -> Iterator[Message]:
    time_ns = FIRST_STAMP_NS
    in_map = _in_map(time_ns)
    markers = [_voxels(world, in_map)] if world.is_voxels else list(_boxes(world, in_map))
    yield Message("/obstacles", "visualization_msgs/MarkerArray", time_ns, {"markers": markers})
    yield Message("/goal", "visualization_msgs/Marker", time_ns, {
        "header": in_map, "ns": "goal", "type": _SPHERE, "pose": _at(world.goal), "color": _GOAL,
        "scale": {"x": _GOAL_SIZE, "y": _GOAL_SIZE, "z": _GOAL_SIZE},
    })  # fmt: skip
    poses = [
        {"header": in_map, "pose": {"position": _xyz(row[1:4]), "orientation": _orientation(row[7:11])}}
        for row in log.rows[:: max(1, len(log.rows) // _POSES)]
    ]
    yield Message("/flown", "nav_msgs/Path", time_ns, {"header": in_map, "poses": poses})


def _at(position: np.ndarray) -> dict[str, Any]:
    return {"position": _xyz(position), "orientation": {"w": 1.0}}


def _boxes(world: World, header: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for number, (lower, upper) in enumerate(zip(world.lower, world.upper, strict=True)):
        yield {
            "header": header, "ns": "obstacles", "id": number, "type": _CUBE, "pose": _at((lower + upper) / 2),
            "scale": _xyz(upper - lower), "color": _OBSTACLE,
        }  # fmt: skip


def _voxels(world: World, header: dict[str, Any]) -> dict[str, Any]:
    """One marker with all solid voxels that have a free neighbour; voxels inside walls are invisible."""
    inner = binary_erosion(world.occupied, border_value=1)
    centres = world.origin + (np.argwhere(world.occupied & ~inner) + 0.5) * world.resolution
    edge = world.resolution
    return {
        "header": header, "ns": "obstacles", "type": _CUBE_LIST, "pose": _at(np.zeros(3)), "color": _OBSTACLE,
        "scale": {"x": edge, "y": edge, "z": edge}, "points": [_xyz(centre) for centre in centres],
    }  # fmt: skip


def _lines(log: FlightLog) -> Iterator[Message]:
    """Events, alarms, injections and the end of the mission as log messages, in chronological order."""
    lines = [(event.time_us / 1e6, INFO, "event", f"{event.kind} {_pairs(event.data)}") for event in log.events]
    lines += [(alarm.time_s, WARN, "alarm", _pairs(alarm.to_json())) for alarm in log.alarms]
    lines += [(item.time_s, ERROR, "injection", _pairs(item.to_json())) for item in log.injections]
    lines.append((float(log.column("time")[-1]), INFO, "mission", f"{log.status.label}: {log.status.value}"))
    for time_s, level, name, text in sorted(lines, key=lambda line: line[0]):
        if not math.isfinite(time_s):
            continue
        time_ns = stamp_ns(time_s)
        fields = {"time": _time(time_ns), "level": level, "name": name, "msg": text.strip()}
        yield Message("/log", "Log", time_ns, fields)


def _pairs(data: dict[str, Any]) -> str:
    return " ".join(f"{key}={value}" for key, value in data.items() if key != "time_s")
