"""ROS 1 bags and ROS 2 mcap files, with the definitions of their messages inside; ROS is not needed.

Messages of ROS 2 are converted to the serialization of ROS 1, in which `Definition` locates numbers.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection

from mavfi.faults.levels.message.definition import Definition
from mavfi.flight.log_readers import LoggedMessage, check_topics, reading

_HEADER = "MSG: std_msgs/Header\n"


class RosReader:
    """Reads a bag or an mcap file; see `FlightLogReader`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        kind = "a ROS 1 bag" if self._path.suffix == ".bag" else "an mcap file of ROS 2"
        with reading(self._path, kind), AnyReader([self._path]) as reader:
            check_topics(self._path, topics, reader.topics)
            chosen = [connection for connection in reader.connections if not topics or connection.topic in topics]
            layouts = {connection.id: _layout(reader, connection) for connection in chosen}
            for connection, time_ns, data in reader.messages(chosen):
                content = reader.typestore.cdr_to_ros1(data, connection.msgtype) if reader.is2 else data
                yield LoggedMessage(connection.topic, time_ns // 1000, layouts[connection.id], bytes(content))


def _layout(reader: AnyReader, connection: Connection) -> Definition:
    """The type in ROS 1, whose headers have a sequence number in addition to those of ROS 2."""
    name = connection.msgtype.replace("/msg/", "/")
    if not reader.is2:
        return Definition(name, connection.msgdef.data)
    text, _ = reader.typestore.generate_msgdef(connection.msgtype, ros_version=1)
    return Definition(name, text.replace(_HEADER, f"{_HEADER}uint32 seq\n"))
