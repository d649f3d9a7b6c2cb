"""ROS 2 mcap files with the definitions of their messages inside; ROS is not needed.

Messages are converted to the serialization of ROS 1, in which `Definition` locates numbers.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from rosbags.highlevel import AnyReader

from mavfi.faults.message.definition import Definition
from mavfi.flight_logs.reader import LoggedMessage, check_topics, reading

_HEADER = "MSG: std_msgs/Header\n"


class McapReader:
    """Reads an mcap file; see `FlightLogReader`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        with reading(self._path, "an mcap file of ROS 2"), AnyReader([self._path]) as reader:
            check_topics(self._path, topics, reader.topics)
            chosen = [connection for connection in reader.connections if not topics or connection.topic in topics]
            store = reader.typestore
            layouts = {
                name: _definition(name, store.generate_msgdef(name, ros_version=1)[0])
                for name in {connection.msgtype for connection in chosen}
            }
            for connection, time_ns, data in reader.messages(chosen):
                content = bytes(store.cdr_to_ros1(data, connection.msgtype))
                yield LoggedMessage(connection.topic, time_ns // 1000, layouts[connection.msgtype], content)


def _definition(name: str, text: str) -> Definition:
    """The type in ROS 1, whose headers have a sequence number in addition."""
    return Definition(name.replace("/msg/", "/"), text.replace(_HEADER, f"{_HEADER}uint32 seq\n"))
