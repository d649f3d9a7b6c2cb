"""Writers of flights as ROS 1 bag or ROS 2 mcap files (with the library `rosbags`, without ROS) or CSV.

An existing file is replaced; `BadInputError` is raised if the file cannot be written.
"""

import csv
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mavfi.errors import writing
from mavfi.extras.logs.lines import ERROR, INFO, WARN
from mavfi.extras.logs.timeline import Message
from mavfi.record import COLUMNS, FlightLog

_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms\n"
_ZEROS: dict[str, Any] = {"bool": False, "float32": 0.0, "float64": 0.0, "string": ""}
_DTYPES = {"byte": "uint8", "char": "uint8", "octet": "uint8"}


class Maker:
    """Constructs messages of one ROS version from plain fields; missing fields are zero or empty."""

    def __init__(self, *, is_ros1: bool) -> None:
        self._is_ros1 = is_ros1
        if is_ros1:
            self.store = get_typestore(Stores.ROS1_NOETIC)
            self.store.register(get_types_from_msg(_TRANSFORMS, "tf2_msgs/msg/TFMessage"))
            self.serialize = self.store.serialize_ros1
            self._levels = {INFO: 2, WARN: 4, ERROR: 8}
        else:
            self.store = get_typestore(Stores.ROS2_HUMBLE)
            self.serialize = self.store.serialize_cdr
            self._levels = {INFO: 20, WARN: 30, ERROR: 40}

    def name(self, kind: str) -> str:
        """Full name of a type in the notation of `rosbags`."""
        if kind == "Log":
            if self._is_ros1:
                return "rosgraph_msgs/msg/Log"
            return "rcl_interfaces/msg/Log"
        package, name = kind.split("/")
        return f"{package}/msg/{name}"

    def make(self, message: Message) -> Any:
        """Convert to a `rosbags` message."""
        fields = message.fields
        if message.kind == "Log":
            stamped = {"stamp": fields["time"]}
            if self._is_ros1:
                stamped = {"header": stamped}
            fields = {**fields, **stamped, "level": self._levels[fields["level"]]}
        return self._make(self.name(message.kind), fields)

    def _make(self, name: str, fields: dict[str, Any]) -> Any:
        """A message of the type with this full name."""
        _, definition = self.store.fielddefs[name]
        values = {field: self._value(kind, fields.get(field)) for field, kind in definition}
        return self.store.types[name](**values)

    def _value(self, kind: Any, value: Any) -> Any:
        """Value of a field of a kind as in the type store; None = zero or empty."""
        node, detail = kind
        if node == Nodetype.BASE:
            if value is None:
                return _ZEROS.get(detail[0], 0)
            return value
        if node == Nodetype.NAME:
            return self._make(detail, value or {})
        # An array or a sequence of elements.
        element, length = detail
        element_node, element_detail = element
        if element_node == Nodetype.NAME or element_detail[0] == "string":
            return [self._value(element, item) for item in value or ()]
        if value is None:
            value = np.zeros(length)
        return np.asarray(value, _DTYPES.get(element_detail[0], element_detail[0]))


def write_bag(messages: Iterable[Message], path: Path) -> int:
    """Write a ROS 1 bag, for `rosbag info`, `rosbag play` and rqt; return the number of messages."""
    with _temporary_folder(path) as folder:
        file = folder / "flight.bag"
        with rosbag1.Writer(file) as writer:
            count = _write(writer, messages, Maker(is_ros1=True))
        _put(file, path)
    return count


def write_mcap(messages: Iterable[Message], path: Path) -> int:
    """Write a ROS 2 mcap file, for Foxglove, PlotJuggler and `ros2 bag`; return the number of messages."""
    with _temporary_folder(path) as folder:
        file = folder / "flight"
        with rosbag2.Writer(file, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
            count = _write(writer, messages, Maker(is_ros1=False))
        _put(next(file.glob("*.mcap")), path)
    return count


def write_csv(log: FlightLog, path: Path) -> int:
    """Write one row per control tick, with numbers that read back bit for bit; return the number of rows."""
    with writing(path), path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows([repr(float(value)) for value in row] for row in log.rows)
    return len(log.rows)


@contextmanager
def _temporary_folder(path: Path) -> Iterator[Path]:
    """A temporary folder next to the file, so that the file appears only when complete."""
    with writing(path):
        folder = tempfile.TemporaryDirectory(prefix=".mavfi-", dir=path.absolute().parent)
    with folder as name:
        yield Path(name)


def _write(writer: Any, messages: Iterable[Message], maker: Maker) -> int:
    """Write messages, with a connection for each topic; returns their number."""
    connections: dict[str, Any] = {}
    count = 0
    for message in messages:
        name = maker.name(message.kind)
        if message.topic not in connections:
            connections[message.topic] = writer.add_connection(message.topic, name, typestore=maker.store)
        writer.write(connections[message.topic], message.time_ns, maker.serialize(maker.make(message), name))
        count += 1
    return count


def _put(finished: Path, path: Path) -> None:
    """Put a finished file in its place."""
    with writing(path):
        finished.replace(path)
