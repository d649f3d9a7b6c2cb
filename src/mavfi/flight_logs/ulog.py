"""PX4's ULog files, with the library pyulog (extra `logs`)."""

from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import BadInputError, allowed
from mavfi.files import check_regular
from mavfi.flight_logs.reader import LoggedMessage
from mavfi.flight_logs.record import Record, numeric
from mavfi.plugins import reason

_LANDED = "vehicle_land_detected"


def _indexed(name: str, count: int) -> tuple[str, ...]:
    return tuple(f"{name}[{index}]" for index in range(count))


class UlogReader:
    """Reads a ULog file; see `FlightLogReader`.

    Of topics with several instances, those after the first are named `topic.1`, `topic.2` ...  If the file says when
    the vehicle was on the ground (`vehicle_land_detected`), messages of these times are left out.
    """

    recommended = {  # what flight software computes, from estimate to actuator, in old and new versions of PX4
        "vehicle_attitude": _indexed("q", 4),
        "vehicle_angular_velocity": _indexed("xyz", 3),
        "vehicle_local_position": ("x", "y", "z", "vx", "vy", "vz"),
        "vehicle_local_position_setpoint": (
            "x", "y", "z", "vx", "vy", "vz", *_indexed("acceleration", 3), *_indexed("thrust", 3),
        ),
        "trajectory_setpoint": (*_indexed("position", 3), *_indexed("velocity", 3), "yawspeed"),
        "vehicle_attitude_setpoint": (*_indexed("q_d", 4), "thrust_body[2]"),
        "vehicle_rates_setpoint": ("roll", "pitch", "yaw", "thrust_body[2]"),
        "actuator_controls_0": _indexed("control", 4),
        "actuator_motors": _indexed("control", 4),
        "vehicle_torque_setpoint": _indexed("xyz", 3),
        "actuator_outputs": _indexed("output", 4),
    }  # fmt: skip

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        found = self._data_sets(topics)
        spans = _airborne(found.get(_LANDED))
        tables = []
        for topic, columns in found.items():
            if topics and topic not in topics:
                continue
            times, rows = _rows(columns)
            flown = np.zeros(len(times), np.bool_)
            for begin, end in spans:
                flown |= (times >= begin) & (times < end)
            tables.append((topic, Record.of(topic, rows.dtype), times[flown], rows[flown]))
        order = np.argsort(np.concatenate([times for _, _, times, _ in tables] or [np.zeros(0)]), kind="stable")
        places = [(table, row) for table, (_, _, times, _) in enumerate(tables) for row in range(len(times))]
        for place in order.tolist():
            topic, layout, times, rows = tables[places[place][0]]
            row = places[place][1]
            yield LoggedMessage(topic, int(times[row]), layout, rows[row].tobytes())

    def _data_sets(self, topics: Sequence[str]) -> dict[str, dict[str, np.ndarray]]:
        """Columns by topic; a BadInputError for a file that cannot be read, or lacks a topic."""
        path = self._path
        check_regular(path)
        try:
            import pyulog
        except ImportError:
            raise BadInputError(
                f"{path}: reading ULog files needs pyulog; allowed: pip install 'mavfi[logs]'"
            ) from None
        try:
            names = [*dict.fromkeys(topic.partition(".")[0] for topic in topics), _LANDED]
            sets = _sets(pyulog, path, names if topics else None)
            found = {f"{d.name}.{d.multi_id}" if d.multi_id else d.name: dict(d.data) for d in sets}
            held = set(found)
            if not set(topics) <= held:
                held = {d.name for d in _sets(pyulog, path, None)}
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever the library raises at a damaged file
            raise BadInputError(f"{path}: is not a ULog file that can be read ({reason(error)})") from None
        for topic in topics:
            if topic not in found:
                raise BadInputError(f"{path}: holds no topic {topic}; allowed: {allowed(held, topic)}")
        return found


def _sets(pyulog: Any, path: Path, names: list[str] | None) -> list[Any]:
    """Data sets of a file; a ValueError for a damaged file, of which the library prints lines and reads the rest."""
    with path.open("rb") as file, redirect_stdout(StringIO()):
        log = pyulog.ULog(file, names)
    sets: list[Any] = log.data_list
    lacking = [one.name for one in sets if "timestamp" not in one.data]
    lacking += [one.name for one in sets if one.name == _LANDED and "landed" not in one.data]
    if log.file_corruption or lacking:
        raise ValueError(f"damaged{' in ' if lacking else ''}{', '.join(lacking)}")
    return sets


def _rows(columns: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Time stamps (us), and all other numbers as a structured array, row by row."""
    chosen = {
        name: column
        for name, column in columns.items()
        if name != "timestamp" and not name.startswith("_padding") and numeric(column.dtype)
    }
    rows = np.zeros(len(columns["timestamp"]), [(name, column.dtype) for name, column in chosen.items()])
    for name, column in chosen.items():
        rows[name] = column
    return columns["timestamp"].astype(np.int64), rows


def _airborne(landed: dict[str, np.ndarray] | None) -> list[tuple[int, int]]:
    """Times (us) in the air, from and until; everything if the file does not say."""
    forever = np.iinfo(np.int64).max
    if landed is None or not len(landed["timestamp"]) or landed["landed"].all():
        return [(0, forever)]
    times = [*landed["timestamp"].astype(np.int64).tolist(), forever]
    return [(begin, end) for begin, end, on in zip(times, times[1:], landed["landed"], strict=False) if not on]
