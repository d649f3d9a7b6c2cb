"""Conversion of a flight to messages of standard ROS types: trajectory, scene, publications and events.

Frames follow REP-103 and REP-105: `map` is the world (ENU, z up), `base_link` the vehicle (x forward, y left, z up).
Stamps are the clock of the flight.
"""

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import binary_erosion

from mavfi.extras.logs.lines import LogLine, lines_of
from mavfi.numerics.rotations import rotation_matrix
from mavfi.numerics.voxels import Grid
from mavfi.record import FlightLog
from mavfi.sim.environments.world import World
from mavfi.states import State, rows

MAP = "map"
VEHICLE = "base_link"
FIRST_STAMP_NS = 1
"""Stamp of the start of the mission: in ROS a stamp of 0 means "not set", and bags reject it."""
_OBSTACLE = {"r": 0.55, "g": 0.57, "b": 0.62, "a": 0.9}
_GOAL = {"r": 0.0, "g": 0.45, "b": 0.7, "a": 0.9}
_CUBE = 1
_SPHERE = 2
_CUBE_LIST = 6
_GOAL_SIZE = 1.0
_MAX_POSES = 1000
"""About the largest number of poses in the path of a flight."""
TICK_TOPICS = ("/clock", "/tf", "/odometry", "/command", "/reference")
"""Topics of `tick_messages`."""
_MAP_PERIOD_US = 1_000_000
"""Shortest time between two messages with the whole map (us)."""
_FLOAT32 = 7  # sensor_msgs/PointField.FLOAT32
_POINT_SIZE = 12
_MAX_DURATION_S = 1000.0
"""Longest duration of a point of a trajectory that counts (s)."""


@dataclass(frozen=True, slots=True)
class PublishedStates:
    """What the kernels of a flight published.

    Attributes:
        states: Instant (us) and value of each publication, in order.
        grid: Geometry of the map.
    """

    states: Sequence[tuple[int, State]]
    grid: Grid


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
    """A stamp, as in ROS 2."""
    seconds, rest = divmod(time_ns, 1_000_000_000)
    return {"sec": seconds, "nanosec": rest}


def _xyz(values: np.ndarray) -> dict[str, float]:
    """A vector or point."""
    return dict(zip("xyz", map(float, values), strict=True))


def _orientation(wxyz: np.ndarray) -> dict[str, float]:
    """A quaternion."""
    return dict(zip("wxyz", map(float, wxyz), strict=True))


def timeline(
    log: FlightLog, world: World, published: PublishedStates | None = None, golden: FlightLog | None = None
) -> Iterator[Message]:
    """All messages of a flight, in chronological order.

    Args:
        log: The flight.
        world: Its world.
        published: Its publications; None = unknown.
        golden: Its golden run; None = the flight itself, or unknown.

    Yields:
        `/clock`, `/tf`, `/odometry`, `/command` and `/reference` at each control tick; `/obstacles`, `/goal`, `/flown`
        and `/golden` once; `/points`, `/map`, `/path` and `/trajectory` as published; `/log` with events, alarms,
        injections, and the end of the mission.
    """
    yield from scenery(world)
    yield _path_of("/flown", log)
    if golden is not None:
        yield _path_of("/golden", golden)
    ticks = (message for row in log.rows for message in tick_messages(row))
    lines = map(log_message, lines_of(log))
    yield from heapq.merge(ticks, lines, _published(published), key=lambda message: message.time_ns)


def _published(published: PublishedStates | None) -> Iterator[Message]:
    """The messages of all publications."""
    if published is not None:
        convert = Converter(published.grid)
        for time_us, state in published.states:
            yield from convert(state, time_us)


def tick_messages(row: np.ndarray) -> Iterator[Message]:
    """The messages of one row of a flight log."""
    # Columns as in `record.COLUMNS`; the velocity is in the world's frame, a twist in the vehicle's.
    time_ns = stamp_ns(row[0])
    position = _xyz(row[1:4])
    orientation = _orientation(row[7:11])
    to_map = np.empty((3, 3))
    rotation_matrix(row[7:11], to_map)
    in_map = _in_map(time_ns)
    transform = {"translation": position, "rotation": orientation}
    # What a robot publishes: clock, frames and state ...
    yield Message("/clock", "rosgraph_msgs/Clock", time_ns, {"clock": _time(time_ns)})
    yield Message(
        "/tf",
        "tf2_msgs/TFMessage",
        time_ns,
        {
            "transforms": [{"header": in_map, "child_frame_id": VEHICLE, "transform": transform}],
        },
    )
    yield Message(
        "/odometry",
        "nav_msgs/Odometry",
        time_ns,
        {
            "header": in_map,
            "child_frame_id": VEHICLE,
            "pose": {"pose": {"position": position, "orientation": orientation}},
            "twist": {"twist": {"linear": _xyz(row[4:7] @ to_map), "angular": _xyz(row[11:14])}},
        },
    )
    # ... and what the controller has commanded and followed.
    yield Message(
        "/command",
        "geometry_msgs/TwistStamped",
        time_ns,
        {
            "header": in_map,
            "twist": {"linear": _xyz(row[14:17]), "angular": {"z": float(row[17])}},
        },
    )
    yield Message("/reference", "geometry_msgs/PointStamped", time_ns, {"header": in_map, "point": _xyz(row[18:21])})


class Converter:
    """Converts publications to messages; publications without a message yield none.

    Args:
        grid: Geometry of the map.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._log_odds = np.zeros(grid.size, np.float32)
        self._next_map_us = 0
        self._kinds: dict[str, Callable[[State, int], Iterable[Message]]] = {
            "perception.point_cloud": lambda state, time_ns: [_cloud("/points", state.elements, time_ns)],
            "perception.map_update": self._map,
            "planning.path": lambda state, time_ns: [_polyline("/path", rows(state.elements, 3), time_ns)],
            "planning.trajectory": lambda state, time_ns: [_polyline("/trajectory", rows(state.elements, 3), time_ns)],
        }

    def __call__(self, state: State, time_us: int) -> Iterable[Message]:
        """The messages of one publication."""
        convert = self._kinds.get(state.spec.name)
        if convert is None:
            return ()
        return convert(state, stamp_ns(1e-6 * time_us))

    def _map(self, state: State, time_ns: int) -> Iterator[Message]:
        """Centres of all occupied voxels, once per second at most; updates outside the map are ignored."""
        voxels = state.elements["voxel"]
        inside = (voxels >= 0) & (voxels < len(self._log_odds))
        self._log_odds[voxels[inside]] = state.elements["log_odds"][inside]
        if time_ns >= 1000 * self._next_map_us:
            self._next_map_us = time_ns // 1000 + _MAP_PERIOD_US
            yield map_message(self._grid, self._log_odds, time_ns)


def map_message(grid: Grid, log_odds: np.ndarray, time_ns: int) -> Message:
    """Centres of all occupied voxels; log-odds of every voxel of the grid, shape (size,)."""
    cells = np.unravel_index(np.flatnonzero(log_odds > 0), (grid.nx, grid.ny, grid.nz))
    centres = np.array([grid.x0, grid.y0, grid.z0]) + (np.column_stack(cells) + 0.5) * grid.resolution
    return _cloud("/map", centres.astype(np.float32), time_ns)


def _cloud(topic: str, points: np.ndarray, time_ns: int) -> Message:
    """A point cloud of n points of three float32 each."""
    return Message(
        topic,
        "sensor_msgs/PointCloud2",
        time_ns,
        {
            "header": _in_map(time_ns),
            "height": 1,
            "width": len(points),
            "point_step": _POINT_SIZE,
            "row_step": _POINT_SIZE * len(points),
            "data": np.frombuffer(points.tobytes(), np.uint8),
            "fields": [
                {"name": axis, "offset": 4 * index, "datatype": _FLOAT32, "count": 1}
                for index, axis in enumerate("xyz")
            ],
        },
    )


def _polyline(topic: str, points: np.ndarray, time_ns: int) -> Message:
    """A path through points (m), without orientation. Shape (n, 3)."""
    in_map = _in_map(time_ns)
    poses = [{"header": in_map, "pose": _at(point)} for point in points.reshape(-1, 3)]
    return Message(topic, "nav_msgs/Path", time_ns, {"header": in_map, "poses": poses})


def trajectory_message(state: State, time_us: int) -> Message:
    """A trajectory (`planning.trajectory`) with yaw, velocities and accelerations, in the world's frame."""
    time_ns = stamp_ns(1e-6 * time_us)
    points = []
    passed_s = 0.0
    for point in state.elements:
        half_yaw = 0.5 * float(point["yaw"])
        rotation = np.array([np.cos(half_yaw), 0.0, 0.0, np.sin(half_yaw)])
        points.append(
            {
                "transforms": [
                    {"translation": _components(point, ""), "rotation": _orientation(rotation)},
                ],
                "velocities": [{"linear": _components(point, "v")}],
                "accelerations": [{"linear": _components(point, "a")}],
                "time_from_start": _time(round(1e9 * passed_s)),
            }
        )
        # a duration may have been corrupted
        if 0.0 < point["duration"] < _MAX_DURATION_S:
            passed_s += float(point["duration"])
    fields = {"header": _in_map(time_ns), "joint_names": [VEHICLE], "points": points}
    return Message("/trajectory_points", "trajectory_msgs/MultiDOFJointTrajectory", time_ns, fields)


def _components(point: np.void, prefix: str) -> dict[str, float]:
    """A vector of a trajectory's point: its position, or with a prefix its velocity "v" or acceleration "a"."""
    return {axis: float(point[f"{prefix}{axis}"]) for axis in "xyz"}


def scenery(world: World) -> Iterator[Message]:
    """Obstacles and goal."""
    time_ns = FIRST_STAMP_NS
    in_map = _in_map(time_ns)
    if world.is_voxels:
        markers = [_voxels(world, in_map)]
    else:
        markers = list(_boxes(world, in_map))
    yield Message("/obstacles", "visualization_msgs/MarkerArray", time_ns, {"markers": markers})
    yield Message(
        "/goal",
        "visualization_msgs/Marker",
        time_ns,
        {
            "header": in_map,
            "ns": "goal",
            "type": _SPHERE,
            "pose": _at(world.goal),
            "color": _GOAL,
            "scale": {"x": _GOAL_SIZE, "y": _GOAL_SIZE, "z": _GOAL_SIZE},
        },
    )


def _path_of(topic: str, log: FlightLog) -> Message:
    """The path of a flight."""
    in_map = _in_map(FIRST_STAMP_NS)
    poses = [
        {"header": in_map, "pose": {"position": _xyz(row[1:4]), "orientation": _orientation(row[7:11])}}
        for row in log.rows[:: max(1, len(log.rows) // _MAX_POSES)]
    ]
    return Message(topic, "nav_msgs/Path", FIRST_STAMP_NS, {"header": in_map, "poses": poses})


def _at(position: np.ndarray) -> dict[str, Any]:
    """A pose without rotation."""
    return {"position": _xyz(position), "orientation": {"w": 1.0}}


def _boxes(world: World, header: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """One marker for each box."""
    for number, (lower, upper) in enumerate(zip(world.lower, world.upper, strict=True)):
        yield {
            "header": header,
            "ns": "obstacles",
            "id": number,
            "type": _CUBE,
            "pose": _at((lower + upper) / 2),
            "scale": _xyz(upper - lower),
            "color": _OBSTACLE,
        }


def _voxels(world: World, header: dict[str, Any]) -> dict[str, Any]:
    """One marker with all solid voxels that have a free neighbour; voxels inside walls are invisible."""
    inner = binary_erosion(world.occupied, border_value=1)
    centres = world.origin + (np.argwhere(world.occupied & ~inner) + 0.5) * world.resolution
    edge = world.resolution
    return {
        "header": header,
        "ns": "obstacles",
        "type": _CUBE_LIST,
        "pose": _at(np.zeros(3)),
        "color": _OBSTACLE,
        "scale": {"x": edge, "y": edge, "z": edge},
        "points": [_xyz(centre) for centre in centres],
    }


def log_message(line: LogLine) -> Message:
    """An event, alarm, injection or end of the mission as a log message."""
    time_ns = stamp_ns(1e-6 * line.time_us)
    fields = {"time": _time(time_ns), "level": line.level, "name": line.name, "msg": line.data}
    return Message("/log", "Log", time_ns, fields)
