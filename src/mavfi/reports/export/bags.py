"""Writes messages as a ROS 1 bag or a ROS 2 mcap file, with the library `rosbags`; no ROS is needed."""

import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mavfi.errors import BadInputError
from mavfi.reports.export.timeline import ERROR, INFO, WARN, Message

_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms\n"
_LEVELS_1 = {INFO: 2, WARN: 4, ERROR: 8}
_LEVELS_2 = {INFO: 20, WARN: 30, ERROR: 40}


class _Maker:
    """Makes messages of one ROS version from plain fields; what is not given is zero or empty."""

    def __init__(self, store: Typestore, levels: dict[str, int]) -> None:
        self.store = store
        self._levels = levels
        self._is_ros1 = levels is _LEVELS_1

    def name(self, kind: str) -> str:
        """Full name of a type, as `rosbags` writes it."""
        if kind == "Log":
            return "rosgraph_msgs/msg/Log" if self._is_ros1 else "rcl_interfaces/msg/Log"
        package, name = kind.split("/")
        return f"{package}/msg/{name}"

    def make(self, message: Message) -> Any:
        """The message."""
        fields = message.fields
        if message.kind == "Log":
            fields = {**fields, "level": self._levels[fields["level"]]}
            if self._is_ros1:
                fields["header"] = {"stamp": fields["time"]}
            else:
                fields["stamp"] = fields["time"]
        return self._make(self.name(message.kind), fields)

    def _make(self, name: str, fields: dict[str, Any]) -> Any:
        _, definition = self.store.fielddefs[name]
        values = {field: self._value(kind, fields.get(field)) for field, kind in definition}
        return self.store.types[name](**values)

    def _value(self, kind: Any, value: Any) -> Any:
        node, what = kind
        if node == Nodetype.BASE:
            return value if value is not None else ("" if what[0] == "string" else _ZEROS.get(what[0], 0))
        if node == Nodetype.NAME:
            return self._make(what, value or {})
        inner, length = what
        items = [] if value is None else value
        if inner[0] == Nodetype.NAME or inner[1][0] == "string":
            return [self._value(inner, item) for item in items]
        if value is None:
            items = np.zeros(length)
        return np.asarray(items, _DTYPES.get(inner[1][0], inner[1][0]))


_ZEROS: dict[str, Any] = {"bool": False, "float32": 0.0, "float64": 0.0}
_DTYPES = {"byte": "uint8", "char": "uint8", "octet": "uint8"}


def _makers() -> tuple[_Maker, _Maker]:
    ros1, ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    ros1.register(get_types_from_msg(_TRANSFORMS, "tf2_msgs/msg/TFMessage"))
    return _Maker(ros1, _LEVELS_1), _Maker(ros2, _LEVELS_2)


def write_bag(messages: Iterable[Message], path: Path) -> int:
    """Write a ROS 1 bag, for `rosbag info`, `rosbag play` and rqt.

    Args:
        messages: What to write.
        path: File, written over.

    Returns:
        How many messages were written.

    Raises:
        BadInputError: The place cannot be written.
    """
    maker, _ = _makers()
    with _beside(path) as folder:
        part = folder / "flight.bag"
        with rosbag1.Writer(part) as writer:
            count = _write(writer, messages, maker, maker.store.serialize_ros1)
        _put(part, path)
    return count


def write_mcap(messages: Iterable[Message], path: Path) -> int:
    """Write a ROS 2 mcap file with its message definitions, for Foxglove, PlotJuggler and `ros2 bag`.

    Args:
        messages: What to write.
        path: File, written over.

    Returns:
        How many messages were written.

    Raises:
        BadInputError: The place cannot be written.
    """
    _, maker = _makers()
    with _beside(path) as folder:
        part = folder / "flight"
        with rosbag2.Writer(part, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
            count = _write(writer, messages, maker, maker.store.serialize_cdr)
        _put(next(part.glob("*.mcap")), path)
    return count


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """A folder next to the file: what is half written never bears its name."""
    try:
        folder = tempfile.TemporaryDirectory(prefix=".mavfi-", dir=path.absolute().parent)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None
    with folder as name:
        yield Path(name)


def _write(writer: Any, messages: Iterable[Message], maker: _Maker, serialize: Any) -> int:
    connections: dict[str, Any] = {}
    count = 0
    for message in messages:
        name = maker.name(message.kind)
        if message.topic not in connections:
            connections[message.topic] = writer.add_connection(message.topic, name, typestore=maker.store)
        writer.write(connections[message.topic], message.time_ns, serialize(maker.make(message), name))
        count += 1
    return count


def _put(part: Path, path: Path) -> None:
    try:
        part.replace(path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None
