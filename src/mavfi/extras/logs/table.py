"""Tables of comma-separated values: one row per instant, with one column for the time."""

import csv
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection

from mavfi.errors import BadInputError
from mavfi.faults.levels.message.definition import Definition
from mavfi.files import read_file
from mavfi.flight.log_readers import LoggedMessage, RecordLayout, check_topics, reading

TOPIC = "row"
"""The only topic of a table."""
_LARGEST = 1 << 28
_TIME = re.compile(r"#?\s*(time|timestamp|stamp|t)([^a-z]|$)", re.IGNORECASE)
_UNITS = {"ns": 1e-3, "us": 1.0, "ms": 1e3, "s": 1e6}
_MAGNITUDES = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
"""Units of times since 1970 without a fraction, by their smallest value."""


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
        clock = next((index for index, name in enumerate(names) if _TIME.match(name)), None)
        if clock is None:
            raise BadInputError(f"{self._path}: no column of time; allowed: a name like time, timestamp or t")
        times = self._times(names[clock], [line[clock] for line in lines])
        chosen = {
            name: column
            for index, name in enumerate(names)
            if index != clock and (column := _column(lines, index)) is not None
        }
        rows = np.zeros(len(lines), [(name, np.float64) for name in chosen])
        for name, column in chosen.items():
            rows[name] = column
        layout = RecordLayout.of(TOPIC, rows.dtype)
        for time_us, row in zip(times, rows, strict=True):
            yield LoggedMessage(TOPIC, time_us, layout, row.tobytes())

    def _lines(self) -> tuple[list[str], list[list[str]]]:
        """Names of the columns and the rows."""
        path = self._path
        try:
            text = read_file(path, _LARGEST).decode()
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
        """Times in us."""
        named = re.search(r"(?:[\[(_])(ns|us|ms|s)(?:[\])]|$)", name)
        try:
            values = [int(cell) if cell.strip().isdigit() else float(cell) for cell in cells]
            whole = isinstance(values[0], int)
            guessed = next((unit for least, unit in _MAGNITUDES if whole and values[0] >= least), "s")
            scale = _UNITS[named[1] if named else guessed]
            return [
                value // 1000 if isinstance(value, int) and scale == 1e-3 else round(value * scale) for value in values
            ]
        except (ValueError, OverflowError) as error:
            raise BadInputError(f"{self._path}: column {name}: is not a time ({error})") from None


def _column(lines: Sequence[Sequence[str]], index: int) -> np.ndarray | None:
    try:
        return np.array([float(line[index]) for line in lines])
    except ValueError:
        return None


# ---- ROS 1 bags and mcap files ---------------------------------------------------------------------------------------

_HEADER = "MSG: std_msgs/Header\n"


class RosReader:
    """Reads a bag or an mcap file; see `FlightLogReader`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        if self._path.suffix == ".bag":
            kind = "a ROS 1 bag"
        else:
            kind = "an mcap file of ROS 2"
        with reading(self._path, kind), AnyReader([self._path]) as reader:
            check_topics(self._path, topics, reader.topics)
            chosen = [connection for connection in reader.connections if not topics or connection.topic in topics]
            layouts = {connection.id: _layout(reader, connection) for connection in chosen}
            for connection, time_ns, data in reader.messages(chosen):
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
