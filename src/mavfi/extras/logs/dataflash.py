"""ArduPilot's logs (DataFlash): binary (.bin) and as text (.log), with the library pymavlink (extra `logs`)."""

import struct
from collections.abc import Iterator, Sequence
from contextlib import closing, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import BadInputError, not_installed
from mavfi.extras.shared.log_readers import LoggedMessage, RecordLayout, check_topics, reading

_CODES = {**{code: code for code in "bBhHiIqQfd"}, "g": "f", **dict.fromkeys("cCeEL", "d")}
"""Types of the numbers of each format character, as in `struct`; scaled integers become float64."""
_FORMAT_OF_FORMATS = b"\xa3\x95\x80"
"""How a message that defines another one starts."""
_TIMES = {"TimeUS": 1, "TimeMS": 1000}
"""Names of columns of times since the start of the vehicle, with their microseconds."""
_WITHOUT_NUMBERS = ("FMT", "FMTU", "UNIT", "MULT", "MSG", "FILE", "PARM", "ISBH", "ISBD")
"""Messages about the log itself, texts, parameters and batches of samples."""


class DataFlashReader:
    """Reads a log of ArduPilot; see `FlightLogReader`.

    Topics are names of messages, e.g. "ATT"; those of one of several sensors have its number, "IMU[0]", if the log says
    which column that is.
    """

    recommended = {
        "ATT": ("Roll", "Pitch", "Yaw"),
        "RATE": ("R", "P", "Y", "ROut", "POut", "YOut", "AOut"),
        "PSCN": ("PN", "VN"),
        "PSCE": ("PE", "VE"),
        "PSCD": ("PD", "VD"),
        "PSC": ("PX", "PY", "VX", "VY"),
        "NTUN": ("PosX", "PosY", "VelX", "VelY"),
        "CTUN": ("ThO", "Alt", "CRt"),
        "NKF1": ("PN", "PE", "PD", "VN", "VE", "VD"),
        "XKF1": ("PN", "PE", "PD", "VN", "VE", "VD"),
        "RCOU": ("C1", "C2", "C3", "C4"),
    }

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        path = self._path
        kind = "a log of ArduPilot"
        try:
            from pymavlink.DFReader import DFReader_binary, DFReader_text
        except ImportError:
            raise not_installed(f"{path}, a log of ArduPilot", "pymavlink", "logs") from None

        class BinaryReader(DFReader_binary):
            """The library's reader, without its index in C, which prints past `redirect_stderr`."""

            def init_arrays_fast(self, progress_callback: Any = None) -> None:
                """Make the index in Python."""
                self.init_arrays(progress_callback)

        library_reader: Any = DFReader_text
        first_format = b"FMT"
        if path.suffix.lower() == ".bin":
            library_reader = BinaryReader
            first_format = _FORMAT_OF_FORMATS
        # The library prints what it skips.
        with reading(path, kind), redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            if first_format not in path.read_bytes():
                raise ValueError("it does not define its messages")
            log: Any = library_reader(str(path))
            with closing(log.filehandle):
                logged = list(_all_of(log))
        if not logged:
            raise BadInputError(f"{path}: is not {kind} that can be read (no message with a time)")
        check_topics(path, topics, {message.topic for message in logged})
        yield from (message for message in logged if not topics or message.topic in topics)


def _all_of(log: Any) -> Iterator[LoggedMessage]:
    """All messages with a time and numbers."""
    layouts: dict[tuple[int, bool], _Layout] = {}
    while (message := log.recv_msg()) is not None:
        fmt = message.fmt
        if fmt.name in _WITHOUT_NUMBERS:
            continue
        key = id(fmt), fmt.units is None  # units and instances are known from a later message on
        if key not in layouts:
            layouts[key] = _Layout(fmt)
        layout = layouts[key]
        if layout.clock is None:
            continue
        topic = fmt.name
        if fmt.instance_field is not None:
            topic = f"{fmt.name}[{getattr(message, fmt.instance_field)}]"
        time_us = int(getattr(message, layout.clock)) * _TIMES[layout.clock]
        yield LoggedMessage(topic, time_us, layout.record, layout.pack(message))


class _Layout:
    """The numbers of a type of messages.

    Args:
        fmt: The library's description of the type.

    Attributes:
        clock: Name of the column of times; None = there is none.
        record: Layout of what `pack` returns.
    """

    def __init__(self, fmt: Any) -> None:
        self.clock = next((name for name in _TIMES if name in fmt.columns), None)
        units = dict(zip(fmt.columns, fmt.units or (), strict=False))
        codes = {
            name: _CODES[character]
            for name, character in zip(fmt.columns, fmt.format, strict=False)
            if character in _CODES and name not in (self.clock, fmt.instance_field)
        }
        self._names = list(codes)
        self._struct = struct.Struct("<" + "".join(codes.values()))
        dtype = np.dtype([(name, f"<{code}") for name, code in codes.items()])
        self.record = RecordLayout(fmt.name, RecordLayout.leaves_of(dtype), units)

    def pack(self, message: Any) -> bytes:
        """The numbers of a message."""
        return self._struct.pack(*(getattr(message, name) for name in self._names))
