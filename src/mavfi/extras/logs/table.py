"""Tables of comma-separated values: one row per instant, with one column for the time."""

import csv
import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.logs.recording import longest_gap_us
from mavfi.extras.shared.log_readers import LoggedMessage, RecordLayout, check_topics
from mavfi.files import read_file

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
"""Longest usual time between two rows of a slow log (s).

Longer times in seconds are read as milliseconds if the log would still be long enough for a flight.
"""
_SLOWEST_PERIOD_S = 60.0
"""Longest usual time between two rows of any log whose times are in seconds (s)."""
_SHORTEST_FLIGHT_S = 10.0
"""A log in milliseconds that is shorter than this may be a slow one in seconds (s)."""
_LONGEST_FLIGHT_S = 4 * 3600.0
"""A longer log is read in the next smaller unit, if it is long enough for a flight in that one, too (s)."""
_SHORTEST_PERIOD_S = 1e-4
"""Shortest usual time between two rows (s): flight controllers log at up to 8 kHz."""
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
        self._guesses += _irregularities(times)
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
                    step = float(np.median(_forward_steps(numbers)))
                    period_s = 1e-6 * _MICROSECONDS[unit] * step
                    other = "ms"
                    if unit == "ms":
                        other = "s"
                    self._guesses = [
                        f"{name}: taken for {unit} ({1.0 / period_s:.3g} rows/s, "
                        f"{period_s * (len(numbers) - 1) / 60.0:.1f} min); if wrong, put the unit in its name, like "
                        f"{name}_{other}"
                    ]
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


def _forward_steps(numbers: Sequence[int | float]) -> np.ndarray:
    """Differences of times that go forward."""
    steps = np.diff(np.array(numbers, np.float64))
    return steps[steps > 0.0]


def _irregularities(times_us: Sequence[int]) -> list[str]:
    """Where times go back, and where rows are missing."""
    steps = np.diff(np.array(times_us, np.int64))
    texts = []
    backward = np.flatnonzero(steps < 0)
    if len(backward):
        # The first row is in line 2.
        first_line = int(backward[0]) + 3
        texts.append(f"time goes back in {len(backward)} of {len(times_us)} rows, first in line {first_line}")
    gap_count = int((steps > longest_gap_us(times_us)).sum())
    if gap_count:
        longest = int(np.argmax(steps))
        texts.append(
            f"gaps without rows, not counted as flight: {gap_count}; the longest {1e-6 * steps[longest]:.1f} s from "
            f"{1e-6 * times_us[longest]:.3f} s"
        )
    return texts


def _guess_unit(numbers: Sequence[int | float]) -> tuple[str, bool]:
    """Unit of a column of times, by the size of dates or the time between rows, and whether it is doubtful."""
    first = numbers[0]
    for smallest, unit in _MAGNITUDES:
        if first >= smallest:
            return unit, False
    steps = _forward_steps(numbers)
    is_whole = all(float(number).is_integer() for number in numbers)
    if not len(steps) or not is_whole:
        return "s", False
    # Whole numbers since the start of the log or of the vehicle.
    step = float(np.median(steps))
    if first >= _FIRST_DATE_S and step <= _SLOWEST_PERIOD_S:
        return "s", False
    is_left_out = False
    for unit in ("s", "ms", "us", "ns"):
        unit_s = 1e-6 * _MICROSECONDS[unit]
        if unit_s * step > _LONGEST_PERIOD_S:
            continue
        # Rows that come slowly for half a day are rather fast ones of some minutes, in the next smaller unit.
        span_s = unit_s * step * len(steps)
        is_flight_in_smaller = 1e-3 * unit_s * step >= _SHORTEST_PERIOD_S and 1e-3 * span_s >= _SHORTEST_FLIGHT_S
        if span_s > _LONGEST_FLIGHT_S and is_flight_in_smaller:
            is_left_out = True
            continue
        if unit == "s" or is_left_out:
            return unit, is_left_out
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
