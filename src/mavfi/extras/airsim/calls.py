"""Calls of a program and their answers, one line of JSON each, as `mavfi airsim serve --save` writes them."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from mavfi.config import checked
from mavfi.errors import BadInputError
from mavfi.extras.shared.log_readers import LoggedMessage, RecordLayout, check_topics
from mavfi.extras.shared.message_definition import Leaf
from mavfi.files import read_file
from mavfi.record import LATEST_S

_LARGEST = 1 << 28


@dataclass(frozen=True, slots=True)
class RecordedCall:
    """The numbers in the arguments or in the answer of one call.

    Attributes:
        time_us: Its instant (us).
        topic: Call and side, e.g. "moveByVelocity(arguments)".
        numbers: By path, e.g. "position.z_val"; infinities and NaN as text, since JSON has none.
    """

    time_us: int
    topic: str
    numbers: Mapping[str, float | str]

    @staticmethod
    def of(time_us: int, topic: str, numbers: Mapping[str, float]) -> "RecordedCall":
        """A call from its numbers."""
        plain: dict[str, float | str] = dict(numbers)
        for name, value in numbers.items():
            if not math.isfinite(value):
                plain[name] = str(value)
        return RecordedCall(time_us, topic, plain)

    @property
    def values(self) -> dict[str, float]:
        """The numbers, not finite ones too."""
        return {name: float(value) for name, value in self.numbers.items()}

    def line(self) -> str:
        """Its line in a file."""
        return json.dumps(asdict(self)) + "\n"


def read_calls(path: Path) -> list[RecordedCall]:
    """Calls of a file, in order.

    Raises:
        BadInputError: The file cannot be read, or has a line that is no call.
    """
    try:
        lines = read_file(path, _LARGEST).decode().splitlines()
    except UnicodeDecodeError as error:
        raise BadInputError(f"{path}: is not a file of calls ({error})") from None
    calls = []
    for number, line in enumerate(lines, 1):
        try:
            call = checked(RecordedCall, json.loads(line), "call")
            if not call.values or abs(call.time_us) > 1e6 * LATEST_S:
                raise ValueError(f"numbers, time_us: allowed: one or more; {LATEST_S:g} s at most")
        except (BadInputError, OverflowError, RecursionError, ValueError) as error:
            raise BadInputError(f"{path}: line {number}: is not a call ({error})") from None
        calls.append(call)
    if not calls:
        raise BadInputError(f"{path}: has no calls; allowed: one or more")
    return calls


class CallsReader:
    """Reads a file of calls; see `FlightLogReader`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        calls = read_calls(self._path)
        check_topics(self._path, topics, {call.topic for call in calls})
        layouts: dict[tuple[str, ...], RecordLayout] = {}
        for call in calls:
            if topics and call.topic not in topics:
                continue
            values = call.values
            shape = (call.topic, *values)
            if shape not in layouts:
                leaves = {name or "value": Leaf(8 * index, "float64") for index, name in enumerate(values)}
                layouts[shape] = RecordLayout(call.topic, leaves)
            yield LoggedMessage(call.topic, call.time_us, layouts[shape], np.array(list(values.values())).tobytes())
