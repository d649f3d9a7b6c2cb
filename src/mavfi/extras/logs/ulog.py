"""PX4's ULog files, with the library pyulog (extra `logs`)."""

import struct
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.logs.reader import LoggedMessage, Record, check_topics, numeric, reading

_LANDED = "vehicle_land_detected"
_FILE_HEADER = 16
_HEADER = struct.Struct("<HB")
"""Of a message: size of what follows, type."""


def _indexed(name: str, count: int) -> tuple[str, ...]:
    return tuple(f"{name}[{index}]" for index in range(count))


class UlogReader:
    """Reads a ULog file; see `FlightLogReader`.

    Of topics with several instances, those after the first are named `topic.1`, `topic.2` ...  If the file says when
    the vehicle was on the ground (`vehicle_land_detected`), messages of these times are left out.
    """

    recommended = {  # outputs of flight software, from estimate to actuators, in old and new versions of PX4
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
        found = self._data_sets()
        check_topics(self._path, topics, found)
        spans = _airborne(found.get(_LANDED))
        messages = []
        for topic, columns in found.items():
            if topics and topic not in topics:
                continue
            times, rows = _rows(columns)
            flown = np.zeros(len(times), np.bool_)
            for begin, end in spans:
                flown |= (times >= begin) & (times < end)
            layout = Record.of(topic, rows.dtype)
            messages += [
                LoggedMessage(topic, time_us, layout, row.tobytes())
                for time_us, row in zip(times[flown].tolist(), rows[flown], strict=True)
            ]
        yield from sorted(messages, key=lambda message: message.time_us)

    def is_cut(self) -> bool:
        """Whether the file ends within a message, as after a loss of power."""
        data = self._path.read_bytes()
        place = _FILE_HEADER
        while place + _HEADER.size <= len(data):
            size, _ = _HEADER.unpack_from(data, place)
            place += _HEADER.size + size
        return place != len(data)

    def _data_sets(self) -> dict[str, dict[str, np.ndarray]]:
        """Columns by topic; a damaged file, of which the library reads only the rest, is a BadInputError."""
        path = self._path
        try:
            import pyulog
        except ImportError:
            needed = "allowed: pip install 'mavfi[logs]'"
            raise BadInputError(f"{path}: reading ULog files needs pyulog; {needed}") from None
        with reading(path, "a ULog file"):
            with path.open("rb") as file, redirect_stdout(StringIO()):
                log: Any = pyulog.ULog(file)
            lacking = [one.name for one in log.data_list if not _required(one.name) <= set(one.data)]
            if log.file_corruption or lacking:
                raise ValueError(f"damaged{' in ' if lacking else ''}{', '.join(lacking)}")
            return {f"{one.name}.{one.multi_id}" if one.multi_id else one.name: one.data for one in log.data_list}


def _required(topic: str) -> set[str]:
    """Columns that the reader uses."""
    return {"timestamp", "landed"} if topic == _LANDED else {"timestamp"}


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
