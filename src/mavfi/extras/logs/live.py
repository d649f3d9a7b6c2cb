"""A running flight for Foxglove and Lichtblick, by their WebSocket protocol (library foxglove-sdk, extra `live`).

Topics, types and frames are those of exported mcap files.  Topics without subscribers are not converted; motion, point
clouds, plans and map are sent as often as a small share of the wall time allows, log lines without exception.
"""

import time
from collections.abc import Iterable
from typing import Any

import numpy as np

from mavfi.errors import BadInputError, not_installed
from mavfi.extras.logs.files import Maker
from mavfi.extras.logs.lines import INFO, lines_at
from mavfi.extras.logs.timeline import (
    TICK_TOPICS,
    Converter,
    Message,
    log_message,
    map_message,
    scenery,
    stamp_ns,
    tick_messages,
)
from mavfi.flight.loop import Loop
from mavfi.flight.observers import FlightItem
from mavfi.mission import MissionStatus
from mavfi.record import COLUMNS
from mavfi.states import State

HOST = "127.0.0.1"
PORT = 8765
"""Where flights are served; the port of Foxglove's WebSocket protocol."""
_PERIOD_S = 0.05
_SCENERY_PERIOD_S = 1.0
"""Shortest wall time between messages (s); of obstacles and map, which are repeated for new viewers."""
_SHARE = 0.01
"""Largest share of wall time spent on each of motion, point clouds, plans, and obstacles with the map."""
_KINDS = {
    **{message.topic: message.kind for message in tick_messages(np.ones(len(COLUMNS)))},
    "/obstacles": "visualization_msgs/MarkerArray",
    "/goal": "visualization_msgs/Marker",
    "/points": "sensor_msgs/PointCloud2",
    "/map": "sensor_msgs/PointCloud2",
    "/path": "nav_msgs/Path",
    "/trajectory": "nav_msgs/Path",
    "/log": "Log",
}
"""Types of all topics."""
_TOPICS = {"perception.point_cloud": "/points", "planning.path": "/path", "planning.trajectory": "/trajectory"}


class Allowance:
    """Limits work to a rate and to `_SHARE` of the wall time; `with` encloses the work.

    Args:
        period_s: Shortest time between two starts of the work (s).
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._begin = 0.0
        self._next = 0.0

    def due(self, now: float) -> bool:
        """Whether there is work at a time (s, `time.monotonic`)."""
        return now >= self._next

    def __enter__(self) -> None:
        self._begin = time.monotonic()

    def __exit__(self, *_: object) -> None:
        spent = time.monotonic() - self._begin
        self._next = self._begin + max(self._period_s, spent / _SHARE)


class LiveView:
    """A server, until `close`; an observer of flights.

    Args:
        port: TCP port on loopback; 0 = any free one.

    Raises:
        BadInputError: The library is not installed, or the port is in use.
    """

    def __init__(self, port: int = PORT) -> None:
        try:
            import foxglove
        except ImportError:
            raise not_installed("--live", "foxglove-sdk", "live") from None
        self._sdk: Any = foxglove
        self._context: Any = foxglove.Context()
        try:
            self._server: Any = foxglove.start_server(name="mavfi", host=HOST, port=port, context=self._context)
        except Exception as error:  # noqa: BLE001 - the library's own exceptions
            raise BadInputError(f"--live: port {port}: cannot be served ({error}); allowed: a free port") from None
        self._maker = Maker(is_ros1=False)
        self._channels = {topic: self._channel(topic, kind) for topic, kind in _KINDS.items()}
        self._motion = Allowance(_PERIOD_S)
        self._clouds = Allowance(_PERIOD_S)
        self._planning = Allowance(_PERIOD_S)
        self._scene = Allowance(_SCENERY_PERIOD_S)
        self._plans: dict[str, tuple[State, int]] = {}
        self._scenery: list[Message] = []

    @property
    def address(self) -> str:
        """Where viewers connect."""
        return f"ws://{HOST}:{self._server.port}"

    def begin(self, loop: Loop) -> None:
        """See `Observer`."""
        kernels: Any = loop.kernels
        self._octomap = kernels["octomap"]
        self._convert = Converter(self._octomap.grid)
        self._scenery = list(scenery(loop.world))

    def published(self, state: State, time_us: int) -> None:
        """See `Observer`."""
        topic = _TOPICS.get(state.spec.name)
        if topic is None or not self._channels[topic].has_sinks():
            return
        if topic != "/points":
            self._plans[topic] = state, time_us
        elif self._clouds.due(time.monotonic()):
            with self._clouds:
                self._send(self._convert(state, time_us))

    def tick(self, row: np.ndarray, items: list[FlightItem], status: MissionStatus | None) -> None:
        """See `Observer`."""
        if items or status is not None:
            self._send(map(log_message, lines_at(float(row[0]), items, status)))
        now = time.monotonic()
        if status is not None or self._motion.due(now):
            with self._motion:
                if any(self._channels[topic].has_sinks() for topic in TICK_TOPICS):
                    self._send(tick_messages(row))
        if self._plans and (status is not None or self._planning.due(now)):
            with self._planning:
                for state, time_us in self._plans.values():
                    self._send(self._convert(state, time_us))
                self._plans.clear()
        if self._scene.due(now):
            with self._scene:
                self._send(self._scenery)
                if self._channels["/map"].has_sinks():
                    self._send([map_message(self._octomap.grid, self._octomap.map.log_odds, stamp_ns(row[0]))])

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()
        for channel in self._channels.values():
            channel.close()

    def _channel(self, topic: str, kind: str) -> Any:
        """Advertise a topic; the library that serializes its messages compiles their type now, not in flight."""
        name = self._maker.name(kind)
        text, _ = self._maker.store.generate_msgdef(name, ros_version=2)
        empty: dict[str, Any] = {}
        if kind == "Log":
            empty = {"time": {}, "level": INFO}
        self._maker.serialize(self._maker.make(Message(topic, kind, 0, empty)), name)
        schema = self._sdk.Schema(name=name, encoding="ros2msg", data=text.encode())
        return self._sdk.Channel(topic, schema=schema, message_encoding="cdr", context=self._context)

    def _send(self, messages: Iterable[Message]) -> None:
        """Send messages to the viewers of their topics."""
        for message in messages:
            channel = self._channels[message.topic]
            if channel.has_sinks():
                content = self._maker.serialize(self._maker.make(message), self._maker.name(message.kind))
                channel.log(bytes(content), log_time=message.time_ns)
