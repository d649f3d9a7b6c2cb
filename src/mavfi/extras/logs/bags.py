"""Recordings of ROS 1 and ROS 2: bags, folders of rosbag2, mcap files; and folders of tables."""

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from mavfi.errors import BadInputError, not_known
from mavfi.extras.logs.table import TOPIC, CsvReader
from mavfi.extras.shared.log_readers import LoggedMessage, check_topics, reading
from mavfi.extras.shared.message_definition import Definition
from mavfi.plugins import reason

_HEADER = "MSG: std_msgs/Header\n"
_ENCODINGS = {"ros1": False, "cdr": True}
"""Serializations that are read, and whether they are those of ROS 2."""


class _Channel(NamedTuple):
    """What a recording says of the messages of a publisher.

    Attributes:
        topic: Their topic.
        kind: Name of their type, "package/msg/Name" in ROS 2.
        encoding: Their serialization.
        language: That of the definition: "msg", "idl", or "" if there is none.
        definition: The definition of their type.
        digest: Its checksum; "" = unknown.
    """

    topic: str
    kind: str
    encoding: str
    language: str
    definition: str
    digest: str = ""


_Records = Iterator[tuple[_Channel, int, bytes]]
"""Messages with their channel and time (ns)."""


class RosReader:
    """Reads a bag of ROS 1, or a recording of rosbag2 (folder, mcap or db3 file); see `FlightLogReader`.

    A folder of tables, one for each topic, as `ulog2csv` and exporters of bags write it, is read as well: a topic has
    the name of its file without what all names begin with.

    Attributes:
        notices: Topics that could not be read, and why.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._is_cut = False
        self.notices: list[str] = []

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        kind = "a recording of ROS 2"
        if self._path.suffix.lower() == ".bag":
            kind = "a ROS 1 bag"
        self.notices = []
        tables = _tables_in(self._path)
        if tables:
            yield from self._table_messages(tables, topics)
            return
        with reading(self._path, kind), ExitStack() as stack:
            channels, records = self._open(stack)
            check_topics(self._path, topics, {channel.topic for channel in channels})
            decoders: dict[_Channel, _Decoder | None] = {}
            for channel, time_ns, data in records:
                if topics and channel.topic not in topics:
                    continue
                if channel not in decoders:
                    decoders[channel] = self._decoder(channel)
                decoder = decoders[channel]
                if decoder is not None:
                    yield LoggedMessage(channel.topic, time_ns // 1000, decoder.layout, decoder.convert(data))

    def is_cut(self) -> bool:
        """Whether the file, read by `messages`, ends within a message."""
        return self._is_cut

    def _table_messages(self, tables: Sequence[Path], topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """The messages of a folder of tables, in order of time; a table that cannot be read is a notice."""
        start = len(os.path.commonprefix([path.stem for path in tables]))
        names = {path: path.stem[start:] or path.stem for path in tables}
        check_topics(self._path, topics, names.values())
        messages = []
        for path, topic in names.items():
            if topics and topic not in topics:
                continue
            try:
                rows = list(CsvReader(path).messages([]))
            except BadInputError as error:
                self.notices.append(f"{topic}: not read, {str(error).removeprefix(f'{path}: ')}")
                continue
            messages += [replace(row, topic=topic + row.topic.removeprefix(TOPIC)) for row in rows]
        if not messages:
            raise BadInputError(f"{self._path}: no table in this folder can be read ({'; '.join(self.notices[:3])})")
        yield from sorted(messages, key=lambda message: message.time_us)

    def _decoder(self, channel: _Channel) -> "_Decoder | None":
        """What reads the messages of a channel; None if that is impossible, with a notice."""
        try:
            return _Decoder(channel)
        except Exception as error:  # noqa: BLE001 - any exception of a library
            self.notices.append(f"{channel.topic}: not read, {channel.kind}: {reason(error)}")
            return None

    def _open(self, stack: ExitStack) -> tuple[Collection[_Channel], _Records]:
        """All channels, and the messages in order of time."""
        path = self._path
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            # of a recorder that did not end as it should; bag_2 comes before bag_10
            files = [file for file in path.iterdir() if file.suffix.lower() in (".mcap", ".db3")]
            files.sort(key=lambda file: (len(file.name), file.name))
            if not files:
                raise ValueError("no metadata.yaml, .mcap or .db3 in this folder")
        elif path.is_dir():
            files = []
            if not _is_compressed(path / "metadata.yaml"):
                files = sorted(path.glob("*.mcap"))
        else:
            files = [path]
        if files and all(file.suffix.lower() == ".mcap" for file in files):
            messages = [message for file in files for message in self._mcap_messages(file)]
            messages.sort(key=lambda message: message[1])
            return {channel for channel, _, _ in messages}, iter(messages)
        # One reader for each file of a folder without metadata, in order of their names.
        channels: list[_Channel] = []
        recordings: list[_Records] = []
        for file in files or [path]:
            reader: Any = stack.enter_context(_rosbags_reader(file))
            channels += [_channel_of(connection, reader) for connection in reader.connections]
            recordings.append(_bag_messages(reader))
        return channels, chain.from_iterable(recordings)

    def _mcap_messages(self, file: Path) -> _Records:
        """The messages of a file, up to its end, or where it is cut or damaged."""
        schemas: dict[int, Any] = {}
        channels: dict[int, _Channel] = {}
        count = 0
        with file.open("rb") as stream:
            records = StreamReader(stream, validate_crcs=True).records
            while True:
                try:
                    record: Any = next(records)
                except StopIteration:
                    return
                except Exception as error:  # noqa: BLE001 - any exception of a library at a damaged file
                    if not count:
                        raise
                    self._is_cut = isinstance(error, EndOfFile)
                    if not self._is_cut:
                        self.notices.append(f"damaged ({reason(error)}); read up to its message {count}")
                    return
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = _channel_of_mcap(record, schemas.get(record.schema_id))
                elif isinstance(record, Message) and record.channel_id in channels:
                    count += 1
                    yield channels[record.channel_id], record.log_time, record.data


def _tables_in(path: Path) -> list[Path]:
    """The tables in a folder without a recording of rosbag2."""
    if not path.is_dir():
        return []
    files = sorted(path.iterdir())
    if any(file.name == "metadata.yaml" or file.suffix.lower() in (".mcap", ".db3") for file in files):
        return []
    return [file for file in files if file.suffix.lower() == ".csv"]


def _is_compressed(metadata: Path) -> bool:
    """Whether rosbag2 has compressed the messages of a recording, or its files."""
    information = yaml.safe_load(metadata.read_text())["rosbag2_bagfile_information"]
    return str(information.get("compression_mode") or "none").lower() != "none"


def _channel_of_mcap(channel: Any, schema: Any) -> _Channel:
    """The channel of an mcap file."""
    if schema is None:
        return _Channel(channel.topic, "no type", channel.message_encoding, "", "")
    languages = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl", "omgidl": "idl"}
    text = schema.data.decode(errors="replace")
    return _Channel(channel.topic, schema.name, channel.message_encoding, languages.get(schema.encoding, ""), text)


class _Rosbag2Reader(rosbag2.Reader):
    """The library's reader, also of files with an extension in upper case."""

    STORAGE_PLUGINS: Mapping[str, Any] = {
        **rosbag2.Reader.STORAGE_PLUGINS,
        ".DB3": rosbag2.Reader.STORAGE_PLUGINS[".db3"],
    }


def _rosbags_reader(path: Path) -> Any:
    """The library's reader of a file or folder."""
    if path.suffix.lower() == ".bag":
        return rosbag1.Reader(path)
    return _Rosbag2Reader(path)


def _bag_messages(reader: Any) -> _Records:
    """The messages of a bag, in order of time."""
    channels = {connection.id: _channel_of(connection, reader) for connection in reader.connections}
    for connection, time_ns, data in reader.messages():
        yield channels[connection.id], time_ns, data


def _channel_of(connection: Connection, reader: Any) -> _Channel:
    """The channel of a bag."""
    languages = {MessageDefinitionFormat.MSG: "msg", MessageDefinitionFormat.IDL: "idl"}
    encoding = "cdr"
    if isinstance(reader, rosbag1.Reader):
        encoding = "ros1"
    language = languages.get(connection.msgdef.format, "")
    return _Channel(connection.topic, connection.msgtype, encoding, language, connection.msgdef.data, connection.digest)


class _Decoder:
    """Reads the messages of a channel.

    Args:
        channel: The channel.

    Attributes:
        layout: Their type in ROS 1, whose headers have a sequence number in addition to those of ROS 2.

    Raises:
        Exception: The definition cannot be read, or does not fit its checksum.
    """

    def __init__(self, channel: _Channel) -> None:
        if channel.encoding not in _ENCODINGS:
            raise ValueError(f"serialized as {not_known(channel.encoding, _ENCODINGS)}")
        self._is_ros2 = _ENCODINGS[channel.encoding]
        name = channel.kind.replace("/msg/", "/")
        self._kind = name.replace("/", "/msg/")
        # Files of Humble and earlier do not define their messages.
        self._types = get_typestore(Stores.ROS2_HUMBLE)
        if channel.language:
            self._types = get_typestore(Stores.EMPTY)
            self._types.register(_types_of(channel, self._kind))
            if channel.digest and self._digest() != channel.digest:
                raise ValueError("its definition is not the one of the recorded checksum")
        if not self._is_ros2:
            self.layout = Definition(name, channel.definition)
            return
        text, _ = self._types.generate_msgdef(self._kind, ros_version=1)
        self.layout = Definition(name, text.replace(_HEADER, f"{_HEADER}uint32 seq\n"))

    def _digest(self) -> str:
        """Checksum of the definition, as the version of ROS computes it."""
        if self._is_ros2:
            return self._types.hash_rihs01(self._kind)
        return self._types.generate_msgdef(self._kind)[1]

    def convert(self, data: bytes | memoryview) -> bytes:
        """A message in the serialization of ROS 1."""
        if self._is_ros2:
            return bytes(self._types.cdr_to_ros1(data, self._kind))
        return bytes(data)


def _types_of(channel: _Channel, kind: str) -> Any:
    """The types in the definition of a channel of ROS 2."""
    if channel.language == "msg":
        return get_types_from_msg(channel.definition, kind)
    # Several files, each behind a line of "=" and its name.
    line = "=" * 80 + "\n"
    types: dict[str, Any] = {}
    for text in channel.definition.split(line):
        if text.startswith("IDL: "):
            text = text.partition("\n")[2]
        if text.strip():
            types |= get_types_from_idl(text)
    return types
