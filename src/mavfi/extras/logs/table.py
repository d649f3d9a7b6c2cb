"""Tables of comma-separated values: one row per instant, with one column for the time."""

import csv
import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from mavfi.errors import BadInputError
from mavfi.faults.levels.message.definition import Definition
from mavfi.files import read_file
from mavfi.flight.log_readers import LoggedMessage, RecordLayout, check_topics, reading
from mavfi.plugins import reason

TOPIC = "row"
"""The only topic of a table."""
_MAX_BYTES = 1 << 28
_TIME_NAMES = (
    r"time(_?stamp)?(_?(boot|unix|utc|gps|now|since_start|start|elapsed|rel|log))?",
    r"(unix|boot|log|ros|gps|epoch|elapsed|rel|sim)_?time(_?stamp)?",
    r"stamp|t|ts|clock|epoch|elapsed|seconds?|secs?|date_?time",
    r"(time|timestamp|stamp|t)[^a-z].*",
    r".*time(_?stamp)?s?",
)
"""Names of columns of times, in lower case without unit, best ones first; see `_clock_of`."""
_UNIT_IN_NAME = re.compile(
    r"(?:[\[(_\s/]\s*((?i:[nuµm]?s|[num]?secs?|nano\w*|micro\w*|milli\w*|seconds?))|(?<=[a-z])(NS|US|MS|S))\s*[\])]?$"
)
"""A unit at the end of a name: "time [ms]", "time_us", "TimeUS", "timestamp(s)"."""
_UNITS = {"n": ("ns", 1e-3), "u": ("us", 1.0), "µ": ("us", 1.0), "m": ("ms", 1e3), "s": ("s", 1e6)}
"""Units and their microseconds, by the first letter of the name of the unit; "micro" is "u"."""
_MICROSECONDS = dict(_UNITS.values())
_MAGNITUDES = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
"""Smallest values of times since 1970 in a unit, largest first: those of 1973."""
_FIRST_DATE_S = 1e8
"""Smallest value of a time since 1970 (s)."""
_LONGEST_PERIOD_S = 2.0
"""Longest usual time between two rows (s)."""
_SLOW_PERIOD_S = 10.0
"""The same of a slow log, unless a log in milliseconds with as many rows would be a flight (s)."""
_SLOWEST_PERIOD_S = 60.0
"""The same of any log in seconds (s)."""
_SHORTEST_FLIGHT_S = 10.0
"""A log in milliseconds that is shorter than this may be a slow one in seconds (s)."""
_FRACTIONS = ("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds")
"""Names of columns with the nanoseconds of a time whose seconds are another column."""
_SEPARATORS = (",", ";", "\t", "|")
_LOST = {"", "nan", "null", "none", "na", "n/a", "nil", "-", "#n/a"}
"""Cells without a number, in lower case."""
_SWITCHES = {"true": 1.0, "false": 0.0}


class CsvReader:
    """Reads a table; see `FlightLogReader`.

    The first line has the names of the columns.  The time is the column with the best name, like `time`, `timestamp` or
    `t`, with or without a unit; else the unit follows from the size of its values and the time between rows.  Columns
    that are not numeric or have no name, like the index that pandas writes, are left out; a cell without a number in a
    numeric column is NaN.

    Attributes:
        notices: A unit that was guessed, and columns that were left out.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._is_cut = False
        self._guesses: list[str] = []
        self.notices: list[str] = []

    def is_cut(self) -> bool:
        """Whether the last row, read by `messages`, is not complete."""
        return self._is_cut

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        names, lines = self._lines()
        clock = _clock_of(names)
        if clock is None:
            raise BadInputError(f"{self._path}: no column of time; allowed: a name like time, timestamp or t")
        times = self._times(names[clock], [line[clock] for line in lines])
        fraction = _fraction_of(names, clock)
        if fraction is not None:
            fractions = self._times(f"{names[fraction]} [ns]", [line[fraction] for line in lines])
            times = [whole_us + part_us for whole_us, part_us in zip(times, fractions, strict=True)]
        source_of_row = _sources(names, lines)
        check_topics(self._path, topics, [TOPIC, *source_of_row])
        # All other numeric columns, row by row.
        columns = {}
        texts = []
        for index, name in enumerate(names):
            if index in (clock, fraction):
                continue
            column = _column(lines, index)
            if not name or column is None:
                texts.append(name or f"column {index + 1}")
            else:
                columns[name] = column
        self.notices = list(self._guesses)
        if texts:
            self.notices += [f"columns without numbers or a name: {', '.join(texts[:5])}{'...' * (len(texts) > 5)}"]
        rows = np.zeros(len(lines), [(name, np.float64) for name in columns])
        for name, column in columns.items():
            rows[name] = column
        layout = RecordLayout.of(TOPIC, rows.dtype)
        for index, (time_us, row) in enumerate(zip(times, rows, strict=True)):
            topic = TOPIC
            if source_of_row:
                topic = source_of_row[index]
            if not topics or topic in topics:
                yield LoggedMessage(topic, time_us, layout, row.tobytes())

    def _lines(self) -> tuple[list[str], list[list[str]]]:
        """Names of the columns and the rows."""
        path = self._path
        try:
            text = _without_hint(_decoded(read_file(path, _MAX_BYTES)))
            separator = _separator_of(text)
            names, *lines = (line for line in csv.reader(text.splitlines(), delimiter=separator) if line)
        except (UnicodeDecodeError, ValueError, csv.Error) as error:
            raise BadInputError(f"{path}: is not a table of comma-separated values ({error})") from None
        names = [name.strip().lstrip("#").strip() for name in names]
        if len(names) > 1 and not names[-1] and all(len(line) < len(names) or not line[-1].strip() for line in lines):
            names = names[:-1]  # each line ends with a separator
            lines = [line[: len(names)] for line in lines]
        named = [name for name in names if name]
        if len(set(named)) < len(named):
            raise BadInputError(f"{path}: columns: allowed: a different name for each")
        self._is_cut = len(lines) > 1 and len(lines[-1]) < len(names)
        if self._is_cut:
            lines = lines[:-1]
        for number, line in enumerate(lines, 2):
            if len(line) != len(names):
                raise BadInputError(f"{path}: line {number}: {len(line)} values; allowed: {len(names)}")
        if not lines:
            raise BadInputError(f"{path}: has no rows; allowed: one or more")
        if separator == ";":
            lines = [[cell.replace(",", ".") for cell in line] for line in lines]
        return names, lines

    def _times(self, name: str, cells: Sequence[str]) -> list[int]:
        """The column of times (us), given its name and cells."""
        try:
            values = _calendar_times(cells)
            if values is not None:
                return values
            numbers = [_number(cell) for cell in cells]
            unit = _unit_in_name(name)
            if not unit:
                unit, is_doubtful = _guess_unit(numbers)
                if is_doubtful:
                    self._guesses = [f"{name}: taken for {unit}; if wrong, put the unit in its name, like {name}_ms"]
            return [_microseconds(number, unit) for number in numbers]
        except (ValueError, OverflowError) as error:
            raise BadInputError(f"{self._path}: column {name}: is not a time ({error})") from None


def _decoded(content: bytes) -> str:
    """Text of a file: UTF-8 or UTF-16, with or without a byte-order mark, else as Windows writes it."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252")


def _without_hint(text: str) -> str:
    """Text without the first line "sep=;" by which Excel knows the separator."""
    first, _, rest = text.partition("\n")
    if re.fullmatch(r"sep=.\s*", first):
        return rest
    return text


def _separator_of(text: str) -> str:
    """The separator of columns: the most frequent one in the first line."""
    first = text.partition("\n")[0]
    return max(_SEPARATORS, key=first.count)


def _clock_of(names: Sequence[str]) -> int | None:
    """Index of the column of time; None = there is none."""
    # `__time` of PlotJuggler, `%time` of rostopic, `TimeUS` of ArduPilot, `/clock/time`, `header.stamp` ...
    simple = []
    for name in names:
        last = re.split(r"[./]", name.strip("%_# \"'"))[-1]
        text = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", last)
        simple.append(_UNIT_IN_NAME.sub("", text).strip(" _[]()").lower())
    for pattern in _TIME_NAMES:
        for index, name in enumerate(simple):
            if re.fullmatch(pattern, name):
                return index
    return None


def _unit_in_name(name: str) -> str:
    """Unit of a column of times by its name; "" = it does not say."""
    match = _UNIT_IN_NAME.search(name.strip())
    if match is None:
        return ""
    word = (match[1] or match[2]).lower()
    if word.startswith("micro"):
        return "us"
    return _UNITS[word[0]][0]


def _fraction_of(names: Sequence[str], clock: int) -> int | None:
    """Index of the column with the nanoseconds of a time whose column has whole seconds; None = there is none."""
    prefix = re.sub(r"(sec|secs|seconds)$", "", names[clock])
    if prefix == names[clock]:
        return None
    for fraction in _FRACTIONS:
        if prefix + fraction in names:
            return names.index(prefix + fraction)
    return None


def _calendar_times(cells: Sequence[str]) -> list[int] | None:
    """Times as dates, e.g. "2024-05-01 12:00:00.25" (us since 1970, UTC without a zone); None = these are none."""
    if _value(cells[0]) is not None:
        return None
    times = []
    for cell in cells:
        instant = datetime.fromisoformat(cell.strip())
        if instant.tzinfo is None:
            instant = instant.replace(tzinfo=UTC)
        times.append((instant - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1))
    return times


def _number(cell: str) -> int | float:
    """A number; whole ones are exact: nanoseconds since 1970 exceed the digits of a float."""
    if cell.strip().isdigit():
        return int(cell)
    return float(cell)


def _guess_unit(numbers: Sequence[int | float]) -> tuple[str, bool]:
    """Unit of a column of times, by the size of dates or the time between rows, and whether it is doubtful."""
    first = numbers[0]
    for smallest, unit in _MAGNITUDES:
        if first >= smallest:
            return unit, False
    steps = np.diff(np.array(numbers, np.float64))
    steps = steps[steps > 0.0]
    is_whole = all(float(number).is_integer() for number in numbers)
    if not len(steps) or not is_whole:
        return "s", False
    # Whole numbers since the start of the log or of the vehicle.
    step = float(np.median(steps))
    if step <= _LONGEST_PERIOD_S or (first >= _FIRST_DATE_S and step <= _SLOWEST_PERIOD_S):
        return "s", False
    for unit in ("ms", "us", "ns"):
        unit_s = 1e-6 * _MICROSECONDS[unit]
        if unit_s * step > _LONGEST_PERIOD_S:
            continue
        # A fast and short log in this unit, or a slow one in the unit before it, a thousand times as long.
        is_doubtful = 1e3 * unit_s * step <= _SLOWEST_PERIOD_S and unit_s * float(steps.sum()) < _SHORTEST_FLIGHT_S
        if is_doubtful and unit == "ms" and step <= _SLOW_PERIOD_S:
            return "s", True
        return unit, is_doubtful
    return "s", False


def _microseconds(value: int | float, unit: str) -> int:
    """A time in microseconds."""
    if isinstance(value, int) and unit == "ns":
        return value // 1000
    return round(value * _MICROSECONDS[unit])


def _column(lines: Sequence[Sequence[str]], index: int) -> np.ndarray | None:
    """The numbers of a column, NaN where a cell has none; None if most cells have another text."""
    try:
        return np.array([float(line[index]) for line in lines])
    except ValueError:
        values = [_value(line[index]) for line in lines]
    texts = sum(value is None for value in values)
    numbers = sum(value is not None and not np.isnan(value) for value in values)
    if texts >= numbers:
        return None
    return np.array([np.nan if value is None else value for value in values])


def _value(cell: str) -> float | None:
    """The number of a cell, NaN if it is lost; None = another text."""
    text = cell.strip().lower()
    if text in _LOST:
        return float("nan")
    if text in _SWITCHES:
        return _SWITCHES[text]
    try:
        return float(text)
    except ValueError:
        return None


# ---- several vehicles in one table

_SOURCE = re.compile(
    r"((vehicle|drone|uav|mav|agent|robot|sys(tem)?|instance|ns|namespace)_?(id|name|no|num(ber)?)?|id|name|child_frame_id)"
)
"""Names of columns that say whose row it is, in lower case."""
_MAX_SOURCES = 64


def _sources(names: Sequence[str], lines: Sequence[Sequence[str]]) -> list[str]:
    """Topic of each row of a table with rows of several vehicles; empty = there is only one."""
    for index, name in enumerate(names):
        if not _SOURCE.fullmatch(re.split(r"[./]", name)[-1].lower()):
            continue
        values = [line[index].strip() for line in lines]
        distinct = sorted(set(values))
        # rows of a vehicle follow those of others, unlike numbers of rows
        if 1 < len(distinct) <= min(_MAX_SOURCES, len(lines) // 2):
            return [f"{TOPIC}[{value}]" for value in values]
    return []


# ---- recordings of ROS 1 and ROS 2 ----------------------------------------------------------------------------------

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
            raise ValueError(f"serialized as {channel.encoding!r}; allowed: {', '.join(_ENCODINGS)}")
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
