"""ROS 1 bags, with the definitions of their messages inside; ROS is not needed."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from rosbags.rosbag1 import Reader

from mavfi.faults.message.definition import Definition
from mavfi.flight_logs.reader import LoggedMessage, check_topics, reading


class BagReader:
    """Reads a ROS 1 bag; see `FlightLogReader`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        with reading(self._path, "a ROS 1 bag"), Reader(self._path) as reader:
            check_topics(self._path, topics, reader.topics)
            chosen = [connection for connection in reader.connections if not topics or connection.topic in topics]
            layouts = {
                connection.id: Definition(connection.msgtype.replace("/msg/", "/"), connection.msgdef.data)
                for connection in chosen
            }
            for connection, time_ns, data in reader.messages(chosen):
                yield LoggedMessage(connection.topic, time_ns // 1000, layouts[connection.id], bytes(data))
