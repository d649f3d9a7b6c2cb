"""ROS 1 bags, with the definitions of their messages inside; ROS is not needed."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from rosbags.rosbag1 import Reader

from mavfi.errors import BadInputError, MavfiError, allowed
from mavfi.faults.message.definition import Definition
from mavfi.files import check_regular
from mavfi.flight_logs.reader import LoggedMessage
from mavfi.plugins import reason


class BagReader:
    """Reads a ROS 1 bag; see `FlightLogReader`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        path = self._path
        check_regular(path)
        try:
            with Reader(path) as reader:
                chosen = [connection for connection in reader.connections if not topics or connection.topic in topics]
                for topic in topics:
                    if topic not in {connection.topic for connection in chosen}:
                        raise BadInputError(f"{path}: holds no topic {topic}; allowed: {allowed(reader.topics, topic)}")
                layouts = {
                    connection.id: Definition(connection.msgtype.replace("/msg/", "/"), connection.msgdef.data)
                    for connection in chosen
                }
                for connection, time_ns, data in reader.messages(chosen):
                    yield LoggedMessage(connection.topic, time_ns // 1000, layouts[connection.id], bytes(data))
        except MavfiError:
            raise
        except Exception as error:  # noqa: BLE001 - whatever the library raises at a damaged file
            raise BadInputError(f"{path}: is not a ROS 1 bag that can be read ({reason(error)})") from None
