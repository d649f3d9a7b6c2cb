"""Tables of comma-separated values: one row per instant, with one column for the time."""

import csv
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from mavfi.errors import BadInputError
from mavfi.faults.levels.message.definition import Definition
from mavfi.files import read_file
from mavfi.flight.log_readers import LoggedMessage, RecordLayout, check_topics, reading

TOPIC = "row"
"""The only topic of a table."""
_MAX_BYTES = 1 << 28
_TIME = re.compile(r"#?\s*(time|timestamp|stamp|t)([^a-z]|$)", re.IGNORECASE)
_UNIT_IN_NAME = re.compile(r"(?:[\[(_])(ns|us|ms|s)(?:[\])]|$)")
_UNITS = {"ns": 1e-3, "us": 1.0, "ms": 1e3, "s": 1e6}
"""Microseconds of each unit."""
_MAGNITUDES = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
"""Smallest values of times since 1970 in a unit, largest first: those of 1973."""


class CsvReader:
    """Reads a table; see `FlightLogReader`.

    The first line has the names of the columns.  The time is the first column with a name like `time`, `timestamp` or
    `t`; its unit is in the name ("time [ms]", "time_us"), else follows from the size of whole numbers, else is seconds.
    Columns that are not numeric throughout are left out.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        check_topics(self._path, topics, [TOPIC])
        names, lines = self._lines()
        # The time.
        clocks = [index for index, name in enumerate(names) if _TIME.match(name)]
        if not clocks:
            raise BadInputError(f"{self._path}: no column of time; allowed: a name like time, timestamp or t")
        clock = clocks[0]
        times = self._times(names[clock], [line[clock] for line in lines])
        # All other numeric columns, row by row.
        columns = {}
        for index, name in enumerate(names):
            if index == clock:
                continue
            column = _column(lines, index)
            if column is not None:
                columns[name] = column
        rows = np.zeros(len(lines), [(name, np.float64) for name in columns])
        for name, column in columns.items():
            rows[name] = column
        layout = RecordLayout.of(TOPIC, rows.dtype)
        for time_us, row in zip(times, rows, strict=True):
            yield LoggedMessage(TOPIC, time_us, layout, row.tobytes())

    def _lines(self) -> tuple[list[str], list[list[str]]]:
        """Names of the columns and the rows."""
        path = self._path
        try:
            text = read_file(path, _MAX_BYTES).decode()
            names, *lines = csv.reader(text.splitlines())
        except (UnicodeDecodeError, ValueError, csv.Error) as error:
            raise BadInputError(f"{path}: is not a table of comma-separated values ({error})") from None
        names = [name.strip() for name in names]
        if len(set(names)) < len(names) or not all(names):
            raise BadInputError(f"{path}: columns: allowed: a different name for each")
        for number, line in enumerate(lines, 2):
            if len(line) != len(names):
                raise BadInputError(f"{path}: line {number}: {len(line)} values; allowed: {len(names)}")
        if not lines:
            raise BadInputError(f"{path}: has no rows; allowed: one or more")
        return names, lines

    def _times(self, name: str, cells: Sequence[str]) -> list[int]:
        """The column of times (us), given its name and cells."""
        try:
            values = [_number(cell) for cell in cells]
            unit_in_name = _UNIT_IN_NAME.search(name)
            if unit_in_name is not None:
                unit = unit_in_name[1]
            else:
                unit = _guess_unit(values[0])
            return [_microseconds(value, unit) for value in values]
        except (ValueError, OverflowError) as error:
            raise BadInputError(f"{self._path}: column {name}: is not a time ({error})") from None


def _number(cell: str) -> int | float:
    """A number; whole ones are exact: nanoseconds since 1970 exceed the digits of a float."""
    if cell.strip().isdigit():
        return int(cell)
    return float(cell)


def _guess_unit(first: int | float) -> str:
    """Unit of a column of times, given the first one: seconds, unless it is a whole number of a calendar date."""
    if isinstance(first, int):
        for smallest, unit in _MAGNITUDES:
            if first >= smallest:
                return unit
    return "s"


def _microseconds(value: int | float, unit: str) -> int:
    """A time in microseconds."""
    if isinstance(value, int) and unit == "ns":
        return value // 1000
    return round(value * _UNITS[unit])


def _column(lines: Sequence[Sequence[str]], index: int) -> np.ndarray | None:
    """The numbers of a column; None if it has other values."""
    try:
        return np.array([float(line[index]) for line in lines])
    except ValueError:
        return None


# ---- recordings of ROS 1 and ROS 2 ----------------------------------------------------------------------------------

_HEADER = "MSG: std_msgs/Header\n"


class RosReader:
    """Reads a bag of ROS 1, or a recording of rosbag2 (folder, mcap or db3 file); see `FlightLogReader`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        if self._path.suffix == ".bag":
            kind = "a ROS 1 bag"
        else:
            kind = "a recording of ROS 2"
        # Files of Humble and earlier do not define their messages.
        types = get_typestore(Stores.ROS2_HUMBLE)
        with reading(self._path, kind), AnyReader([self._path], default_typestore=types) as reader:
            check_topics(self._path, topics, reader.topics)
            connections = [connection for connection in reader.connections if not topics or connection.topic in topics]
            layouts = {connection.id: _layout(reader, connection) for connection in connections}
            for connection, time_ns, data in reader.messages(connections):
                if reader.is2:
                    content: bytes | memoryview = reader.typestore.cdr_to_ros1(data, connection.msgtype)
                else:
                    content = data
                yield LoggedMessage(connection.topic, time_ns // 1000, layouts[connection.id], bytes(content))


def _layout(reader: AnyReader, connection: Connection) -> Definition:
    """The type in ROS 1, whose headers have a sequence number in addition to those of ROS 2."""
    name = connection.msgtype.replace("/msg/", "/")
    if not reader.is2:
        return Definition(name, connection.msgdef.data)
    text, _ = reader.typestore.generate_msgdef(connection.msgtype, ros_version=1)
    return Definition(name, text.replace(_HEADER, f"{_HEADER}uint32 seq\n"))
