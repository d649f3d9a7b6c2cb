"""What people and their tools see of a flight: messages of standard types beside those of the lock-step.

Topics, types and frames are those of exported mcap files.  A topic without subscribers is not converted.
"""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mavfi.extras.logs.lines import lines_at
from mavfi.extras.ros.lockstep.plan import FlightPlan
from mavfi.extras.ros.lockstep.transport import StandardView, Transport
from mavfi.flight.loop import Loop
from mavfi.flight.observers import FlightItem
from mavfi.mission import MissionStatus
from mavfi.pipeline.kernel import map_grid
from mavfi.states import State

if TYPE_CHECKING:
    from mavfi.extras.logs.timeline import Message

TICKS: Mapping[str, str] = {
    "/clock": "rosgraph_msgs/Clock",
    "/tf": "tf2_msgs/TFMessage",
    "/odometry": "nav_msgs/Odometry",
    "/command": "geometry_msgs/TwistStamped",
    "/reference": "geometry_msgs/PointStamped",
}
"""Topics of each control period, with their types."""
PUBLICATIONS: Mapping[str, tuple[str, str]] = {
    "perception.point_cloud": ("/points", "sensor_msgs/PointCloud2"),
    "planning.path": ("/path", "nav_msgs/Path"),
    "planning.trajectory": ("/trajectory", "nav_msgs/Path"),
}
"""Topics of publications of states, with their types."""
TRAJECTORY = "/trajectory_points"
"""Topic of trajectories with yaw, velocities and accelerations, of the type `TRAJECTORY_TYPE`."""
TRAJECTORY_TYPE = "trajectory_msgs/MultiDOFJointTrajectory"
MAP = "/map"
SCENERY: Mapping[str, str] = {
    MAP: "sensor_msgs/PointCloud2",
    "/obstacles": "visualization_msgs/MarkerArray",
    "/goal": "visualization_msgs/Marker",
}
"""Topics that are repeated once per second of flight, for new viewers: occupied voxels of the map, and the world."""
_SCENERY_PERIOD = 50
"""The same in control periods."""
LOG = "/log"
"""Topic of events, alarms, injections and the end of the mission."""
LOG_TYPE = "rcl_interfaces/Log"


class Views:
    """Shows the world's flight on topics; an observer.

    Args:
        transport: Of the world's node.
        plan: The flight.
    """

    def __init__(self, transport: Transport, plan: FlightPlan) -> None:
        kinds = {
            **TICKS,
            **dict(PUBLICATIONS.values()),
            TRAJECTORY: TRAJECTORY_TYPE,
            **SCENERY,
            LOG: LOG_TYPE,
        }
        advertised = {topic: transport.view(topic, kind) for topic, kind in kinds.items()}
        self._views: dict[str, StandardView] = {topic: view for topic, view in advertised.items() if view is not None}
        self._grid = map_grid(plan.config)
        self._log_odds = np.zeros(self._grid.size, np.float32)
        self._maker: Any = None
        self._ticks = 0

    def begin(self, loop: Loop) -> None:
        """See `Observer`."""
        self._world = loop.world

    def published(self, state: State, time_us: int) -> None:
        """See `Observer`."""
        if state.spec.name == "planning.trajectory" and self._has_readers([TRAJECTORY]):
            self._load()
            self._send([self._timeline.trajectory_message(state, time_us)])
        if state.spec.name == "perception.map_update":
            self._update_map(state)  # read or not: a map consists of all updates
        topic, _ = PUBLICATIONS.get(state.spec.name, ("", ""))
        if self._has_readers([topic]):
            self._load()
            self._send(self._convert(state, time_us))

    def _update_map(self, state: State) -> None:
        """Apply an update; voxels outside the map are ignored, as an index may have been corrupted."""
        voxels = state.elements["voxel"]
        inside = (voxels >= 0) & (voxels < self._grid.size)
        self._log_odds[voxels[inside]] = state.elements["log_odds"][inside]

    def tick(self, row: np.ndarray, items: list[FlightItem], status: MissionStatus | None) -> None:
        """See `Observer`."""
        if (items or status is not None) and self._has_readers([LOG]):
            self._load()
            self._send(map(self._timeline.log_message, lines_at(float(row[0]), items, status)))
        if self._has_readers(TICKS):
            self._load()
            self._send(self._timeline.tick_messages(row))
        if self._ticks % _SCENERY_PERIOD == 0 and self._has_readers(SCENERY):
            self._load()
            self._send(self._scenery)
            self._send([self._timeline.map_message(self._grid, self._log_odds, self._timeline.stamp_ns(row[0]))])
        self._ticks += 1

    def _has_readers(self, topics: Iterable[str]) -> bool:
        return any(topic in self._views and self._views[topic].has_readers() for topic in topics)

    def _load(self) -> None:
        """Import what converts and serializes, at the first message that somebody reads."""
        if self._maker is not None:
            return
        from mavfi.extras.logs import timeline
        from mavfi.extras.logs.files import Maker

        self._maker = Maker(is_ros1=False)
        self._convert = timeline.Converter(self._grid)
        self._scenery = list(timeline.scenery(self._world))
        self._timeline = timeline

    def _send(self, messages: "Iterable[Message]") -> None:
        """Publish messages to the topics that somebody reads."""
        for message in messages:
            view = self._views.get(message.topic)
            if view is not None and view.has_readers():
                view.publish(bytes(self._maker.serialize(self._maker.make(message), self._maker.name(message.kind))))
