"""Flights recorded elsewhere: interface of their readers, and messages with numbers."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from mavfi.errors import BadInputError, MavfiError, not_known
from mavfi.extras.shared.message_definition import FORMATS, Leaf
from mavfi.files import check_regular
from mavfi.plugins import build, known, load_object, reason

GROUP = "mavfi.log_readers"
"""Entry points of this group are readers by file name extension: classes constructed with a path."""
_FORMAT_OF_FOLDERS = "mcap"
"""Folders are recordings of rosbag2, read by the reader of its files."""
_DESCRIPTION = "metadata.yaml"
"""Name of the file in such a folder that describes it."""
_RAW_LOGS = ("bbl", "bfl")
"""Extensions of logs of Betaflight, INAV and others that only their own decoder reads."""
LONGEST_LIST = 16
"""Longer lists in messages are left out."""


class Number(Protocol):
    """Location of a number in a message."""

    @property
    def offset(self) -> int:
        """Position of its first byte in the message."""

    def value(self, data: bytes) -> int | float:
        """Decode the number from the bytes of a message."""


class Layout(Protocol):
    """Numbers in the messages of a topic.

    Attributes:
        kind: Name of their type.
    """

    kind: str

    def check(self, path: str) -> str:
        """Refuse a path that names no number; `BadInputError` says why."""

    def locate(self, data: bytes, path: str) -> Number:
        """The number with a path; `AbsentError` if this message does not have it."""

    def numbers(self, data: bytes, longest_list: int) -> list[str]:
        """Paths of all numbers of a message; lists that are longer are left out."""


class RecordLayout:
    """Layout of the messages of a topic, by the offset of each number; see `Layout`.

    Args:
        kind: Name of the type.
        leaves: Location of each number, by its name.
        units: Units of numbers, as far as the format defines them.
    """

    def __init__(self, kind: str, leaves: Mapping[str, Leaf], units: Mapping[str, str] | None = None) -> None:
        self.kind = kind
        self.units = dict(units or {})
        self._leaves = dict(leaves)

    @staticmethod
    def of(kind: str, dtype: np.dtype) -> "RecordLayout":
        """The layout of rows of a structured array."""
        return RecordLayout(kind, RecordLayout.leaves_of(dtype))

    @staticmethod
    def leaves_of(dtype: np.dtype) -> dict[str, Leaf]:
        """Location of each number in the rows of a structured array."""
        leaves = {}
        for name, (field_type, offset, *_) in (dtype.fields or {}).items():
            leaves[name] = Leaf(offset, field_type.name)
        return leaves

    def check(self, path: str) -> str:
        """Kind of a number, e.g. "float32", or a BadInputError."""
        if path not in self._leaves:
            raise BadInputError(f"field of {self.kind} {not_known(path, self._leaves)}")
        return self._leaves[path].kind

    def locate(self, data: bytes, path: str) -> Leaf:
        """Location of a number."""
        del data
        return self._leaves[path]

    def numbers(self, data: bytes, longest_list: int) -> list[str]:
        """Names of all numbers."""
        del data, longest_list
        return list(self._leaves)


def numeric(dtype: np.dtype) -> bool:
    """Whether a NumPy type is one of `FORMATS`."""
    return dtype.name in FORMATS


@dataclass(frozen=True, slots=True)
class LoggedMessage:
    """One message of a recorded flight.

    Attributes:
        topic: Its topic.
        time_us: Time of recording (us, by the clock of the file).
        layout: Layout of its numbers.
        data: Its bytes.
    """

    topic: str
    time_us: int
    layout: Layout
    data: bytes


class FlightLogReader(Protocol):
    """Reads one file.

    A reader may have `recommended`: fields worth monitoring, by topic, with names as in its messages; without it, all
    numbers of all topics are.  After `messages` it may have `notices`, what could not be read, one line each, and
    `is_cut()`: whether the file ends within a message.
    """

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """The messages of some topics, in their order; without topics, those of all.

        Raises:
            BadInputError: The file cannot be read, or lacks a topic.
        """


def recording_at(path: Path) -> Path:
    """The file or folder that a path means: of the description of a rosbag2 recording, its folder."""
    if path.name == _DESCRIPTION and path.is_file():
        return path.resolve().parent
    return path


def open_flight_log(path: Path) -> FlightLogReader:
    """The reader of a file, by its extension, or of a folder; it is opened when messages are asked for.

    Raises:
        BadInputError: Nothing reads files with this extension.
    """
    path = recording_at(path)
    extension = path.suffix.removeprefix(".").lower()
    if path.is_dir():
        extension = _FORMAT_OF_FOLDERS
    formats = known(GROUP, {})
    if extension in _RAW_LOGS:
        raise BadInputError(
            f"{path}: a raw log of a flight controller; allowed: the .csv that its decoder blackbox_decode writes"
        )
    if extension not in formats:
        endings = ", ".join(f".{name}" for name in sorted(formats))
        raise BadInputError(f"{path}: no reader of flight logs knows this format; allowed: {endings}")
    factory = load_object("reader of flight logs", extension, GROUP, formats)
    methods = {"messages": "topics"}
    reader: FlightLogReader = build("reader of flight logs", extension, factory, path, needs=methods)
    return reader


@contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """Convert the exceptions of a library at a missing or damaged file to a `BadInputError`; `kind`: "a ROS 1 bag"."""
    check_regular(path)
    try:
        yield
    except MavfiError:
        raise
    except (Exception, SystemExit) as error:  # noqa: BLE001 - any exception of a library
        raise BadInputError(f"{path}: is not {kind} that can be read ({reason(error)})") from None


def check_topics(path: Path, topics: Sequence[str], topics_of_file: Collection[str]) -> None:
    """Refuse topics that a file does not hold."""
    for topic in topics:
        if topic not in topics_of_file:
            raise BadInputError(f"{path}: topic {not_known(topic, topics_of_file)}")
