"""Recorded flights as `mavfi watch` reads them: messages by source, where a known fault begins, and what is amiss."""

import struct
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.logs.ulog import FAULT_FIELD, FAULT_TOPIC
from mavfi.extras.shared.log_readers import LoggedMessage, RecordLayout, check_topics, open_flight_log
from mavfi.extras.shared.message_definition import FORMATS, AbsentError, Definition

_SHORTEST_LIMIT_US = 1_000_000
"""Times without a message up to this one are flight, whatever the rate of the log (us)."""
_USUAL_GAPS = 5
"""Longer ones are, too, if this many are of about the same length: the log has a low rate, or comes in bursts."""
_ALIKE = 1.5
"""Largest ratio of gaps of about the same length."""
_SPARE = 3.0
"""Longest time without a message that is flight / the usual one."""


@dataclass(frozen=True)
class LogRecording:
    """Messages of a recorded flight.

    Attributes:
        name: File name.
        messages: In their order in the file.
        onset_us: Start of a known fault (us, by the clock of the file); None = none known.
        recommended: Fields worth monitoring, by topic, as known by the reader; empty = all numbers.
        cut: Whether the file ends within a message.
        notices: What could not be read, one line each.
        fault: "TOPIC:FIELD" of the number that tells of the known fault, which is not monitored.
    """

    name: str
    messages: list[LoggedMessage]
    onset_us: int | None = None
    recommended: Mapping[str, Sequence[str]] = field(default_factory=dict)
    cut: bool = False
    notices: Sequence[str] = ()
    fault: str = ""

    @property
    def normal(self) -> "LogRecording":
        """The part before the known fault."""
        if self.onset_us is None:
            return self
        return replace(self, messages=[message for message in self.messages if message.time_us < self.onset_us])

    def split(self, share: float) -> tuple["LogRecording", "LogRecording"]:
        """The first share of its messages, and the rest."""
        count = round(share * len(self.messages))
        first = replace(self, messages=self.messages[:count])
        rest = replace(self, messages=self.messages[count:])
        return first, rest

    def by_topic(self) -> dict[str, list[LoggedMessage]]:
        """The messages of each topic."""
        groups: dict[str, list[LoggedMessage]] = {}
        for message in self.messages:
            groups.setdefault(message.topic, []).append(message)
        return groups


def read_recording(path: Path, fault: str = "", *, required: bool = True) -> LogRecording:
    """Read a recorded flight.

    Args:
        path: The file.
        fault: "TOPIC:FIELD" of a number whose first value other than 0 marks the start of a known fault; "" = none.
        required: Whether the file must have that number.

    Raises:
        BadInputError: The file cannot be read, or lacks a required field.
    """
    topic, _, number = fault.rpartition(":")
    if fault and not (topic and number):
        raise BadInputError(f"--fault: {fault!r}: allowed: TOPIC:FIELD, a number that is 0 before the fault")
    reader = open_flight_log(path)
    messages = _by_frame(list(reader.messages([])))
    # The topic that tells of the fault is not monitored; in a table, the column.
    onset = None
    if fault:
        topics = {message.topic for message in messages}
        if required:
            check_topics(path, [topic], topics)
        onset = _onset([message for message in messages if message.topic == topic], number)
        if topics != {topic}:
            messages = [message for message in messages if message.topic != topic]
    is_cut = getattr(reader, "is_cut", None)
    cut = is_cut is not None and is_cut()
    notices = [f"{path.name}: {notice}" for notice in getattr(reader, "notices", ())]
    of_mavfi = [message for message in messages if message.topic == FAULT_TOPIC]
    if not fault and required and _onset(of_mavfi, FAULT_FIELD) is not None:
        option = f"--fault {FAULT_TOPIC}:{FAULT_FIELD}"
        notices.append(f"{path.name}: a flight with a fault; with {option}, alarms after it are not false")
    return LogRecording(path.name, messages, onset, getattr(reader, "recommended", {}), cut, notices, fault)


def _onset(messages: Sequence[LoggedMessage], number: str) -> int | None:
    """Time of the first message (us) in which a number is not 0."""
    for message in messages:
        message.layout.check(number)
        try:
            if message.layout.locate(message.data, number).value(message.data) != 0:
                return message.time_us
        except AbsentError as error:
            raise BadInputError(f"--fault: {error}") from None
    return None


# ---- sources of ROS messages ----------------------------------------------------------------------------------------
_TRANSFORMS = ("tf2_msgs/TFMessage", "tf/tfMessage")
"""Types of messages with a list of transforms."""
_TRANSFORM = "geometry_msgs/TransformStamped"
_STAMP = 12
"""Bytes of sequence number and stamp at the start of a header."""
_POSE = 7 * 8
"""Bytes of a translation and a rotation."""
_COUNT = struct.Struct("<I")


def _by_frame(messages: list[LoggedMessage]) -> list[LoggedMessage]:
    """The messages with topics that tell several frames apart.

    Each transform becomes a message of `topic[child frame]`.  Of another topic whose messages have headers with several
    frames, those after the first in order of names are named `topic[frame]`.
    """
    frames: dict[str, set[str]] = {}
    layouts: dict[Definition, Definition] = {}
    split = []
    for message in messages:
        try:
            if not isinstance(message.layout, Definition):
                split.append((message, ""))
            elif message.layout.kind in _TRANSFORMS:
                split += [(transform, "") for transform in list(_transforms(message, message.layout, layouts))]
            else:
                frame = _frame(message.layout, message.data)
                frames.setdefault(message.topic, set()).add(frame)
                split.append((message, frame))
        except struct.error:
            raise MavfiError(f"{message.topic}: a message is not a {message.layout.kind}: it is too short") from None
    renamed = []
    for message, frame in split:
        if frame and frame != min(frames[message.topic]):
            renamed.append(replace(message, topic=f"{message.topic}[{frame}]"))
        else:
            renamed.append(message)
    return renamed


def _transforms(
    message: LoggedMessage, layout: Definition, layouts: dict[Definition, Definition]
) -> Iterator[LoggedMessage]:
    """Each transform of a message as a message; `layouts` holds the layout of transforms by that of messages."""
    if layout not in layouts:
        layouts[layout] = copy(layout)
        layouts[layout].kind = _TRANSFORM
    data = message.data
    (count,) = _COUNT.unpack_from(data)
    begin = _COUNT.size
    for _ in range(count):
        _, end = _text(data, begin + _STAMP)
        child, end = _text(data, end)
        end += _POSE
        yield LoggedMessage(f"{message.topic}[{child}]", message.time_us, layouts[layout], data[begin:end])
        begin = end


def _frame(layout: Definition, data: bytes) -> str:
    """The frame that a message is about: that of its child, as of odometry, or of its header; "" = it has none."""
    members = layout.types[layout.kind]
    if not members or members[0].kind != "std_msgs/Header":
        return ""
    frame, end = _text(data, _STAMP)
    if len(members) > 1 and members[1].name == "child_frame_id":
        frame, _ = _text(data, end)
    return frame


def _text(data: bytes, offset: int) -> tuple[str, int]:
    """The text at an offset, and the offset behind it."""
    (size,) = _COUNT.unpack_from(data, offset)
    begin = offset + _COUNT.size
    return data[begin : begin + size].decode(errors="replace"), begin + size


# ---- numbers ---------------------------------------------------------------------------------------------------------
def values_of(messages: Sequence[LoggedMessage], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Values of some numbers of messages of one topic, and whether a message has them. Shapes (messages, names)."""
    layout = messages[0].layout
    if isinstance(layout, RecordLayout) and all(message.layout is layout for message in messages):
        return _columns_of(layout, messages, names)
    values = np.full((len(messages), len(names)), np.nan)
    present = np.zeros(values.shape, np.bool_)
    for row, message in enumerate(messages):
        for column, name in enumerate(names):
            try:
                values[row, column] = message.layout.locate(message.data, name).value(message.data)
            except (AbsentError, BadInputError, KeyError):  # this message does not have it, or its type
                continue
            present[row, column] = True
    return values, present


def _columns_of(
    layout: RecordLayout, messages: Sequence[LoggedMessage], names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """`values_of` messages of one layout, whose numbers have the same place in each."""
    content = np.frombuffer(b"".join(message.data for message in messages), np.uint8)
    rows = content.reshape(len(messages), -1)
    values = np.empty((len(messages), len(names)))
    for column, name in enumerate(names):
        leaf = layout.locate(b"", name)
        dtype = np.dtype("<" + FORMATS[leaf.kind])
        part = np.ascontiguousarray(rows[:, leaf.offset : leaf.offset + dtype.itemsize])
        with np.errstate(invalid="ignore"):  # a corrupted float32 may be a signalling NaN
            values[:, column] = part.view(dtype)[:, 0]
    return values, np.ones(values.shape, np.bool_)


# ---- wrapped numbers -------------------------------------------------------------------------------------------------
_UNSIGNED_RANGES = (2.0**16, 2.0**32, 2.0**64)
_NEAR = 1.0 / 16.0
"""Wrapped values are within this share of the end of the range, all others within it of the beginning."""
_RARE = 0.01
"""Largest share of wrapped values; where they are frequent, they are normal."""


def without_wrapped(recording: LogRecording) -> tuple[LogRecording, list[str]]:
    """A recording of the training without messages in which an unsigned number has passed below 0, and which they are.

    A single value at the end of the range would be the largest of all normal values, and hide every smaller error.
    """
    wrapped_ids: set[int] = set()
    notices = []
    for topic, messages in recording.by_topic().items():
        layout = messages[0].layout
        if not isinstance(layout, RecordLayout):
            continue
        names = layout.numbers(b"", 0)
        values, _ = values_of(messages, names)
        for column, name in enumerate(names):
            rows = np.flatnonzero(_is_wrapped(values[:, column]))
            if not len(rows):
                continue
            wrapped_ids.update(id(messages[row]) for row in rows)
            first = messages[rows[0]]
            notices.append(
                f"{recording.name}: not trained on {len(rows)} of {len(messages)} messages of {topic}: {name} is at "
                f"the end of an unsigned range, first {values[rows[0], column]:.0f} at {1e-6 * first.time_us:.3f} s"
            )
    kept = [message for message in recording.messages if id(message) not in wrapped_ids]
    return replace(recording, messages=kept), notices


def _is_wrapped(values: np.ndarray) -> np.ndarray:
    """Which values of a number are rare ones at the end of an unsigned range, far from all others. Shape (n,)."""
    is_finite = np.isfinite(values)
    for limit in _UNSIGNED_RANGES:
        is_high: np.ndarray = is_finite & (values >= limit - _NEAR * limit) & (values < limit)
        is_low = is_finite & (values >= 0.0) & (values <= _NEAR * limit)
        is_whole = values[is_high] == np.floor(values[is_high])
        if 0 < is_high.sum() <= _RARE * len(values) and is_whole.all() and (is_high | is_low | ~is_finite).all():
            return is_high
    return np.zeros(len(values), np.bool_)


# ---- time ------------------------------------------------------------------------------------------------------------
def longest_gap_us(times_us: Sequence[int] | np.ndarray) -> int:
    """Longest time without a message that is still flight (us), from the rate of the log.

    One second, unless longer times without a message are usual: at a rate of 1 Hz or less, or in messages that come in
    bursts.
    """
    gaps = np.diff(np.array(times_us, np.int64)).astype(np.float64)
    long_gaps = gaps[gaps >= 0.9 * _SHORTEST_LIMIT_US]
    if len(long_gaps) < _USUAL_GAPS:
        return _SHORTEST_LIMIT_US
    usual = float(np.median(long_gaps))
    is_alike = (long_gaps >= usual / _ALIKE) & (long_gaps <= usual * _ALIKE)
    if is_alike.mean() < 0.5:
        return _SHORTEST_LIMIT_US
    return max(_SHORTEST_LIMIT_US, round(_SPARE * usual))


def exposure_s(times_us: Sequence[int] | np.ndarray, longest_us: int) -> float:
    """Duration of some messages without longer gaps (s)."""
    gaps = np.diff(np.array(times_us, np.int64)).astype(np.float64)
    return 1e-6 * float(gaps[(gaps > 0) & (gaps <= longest_us)].sum())


# ---- topics that fall silent -----------------------------------------------------------------------------------------
_MIN_REGULAR = 10
"""Fewest messages from which the rate of a topic is known well enough to notice that it falls silent."""
_REGULAR_SHARE = 0.9
"""Share of the times between messages of a regular topic that are at most `_SPARE` times the usual one."""


class Silence(NamedTuple):
    """A time without messages of a topic, in which those of others go on.

    Attributes:
        topic: The topic.
        begin_us: Time of its last message before (us).
        end_us: Time of its next message, or of the last message of all (us).
        lasts: Whether there is no next message.
    """

    topic: str
    begin_us: int
    end_us: int
    lasts: bool

    def text(self) -> str:
        """What is silent, and when."""
        end = f"{1e-6 * self.end_us:.3f} s"
        if self.lasts:
            end = f"the end, {end}"
        return f"{self.topic} silent from {1e-6 * self.begin_us:.3f} s to {end}"


def silences(recording: LogRecording, training: Sequence[LogRecording]) -> list[Silence]:
    """Where topics of a regular rate fall silent, for longer than they do in normal recordings.

    Args:
        recording: The recording.
        training: Normal recordings.
    """
    times_us = _times_by_topic(recording)
    if not times_us:
        return []
    all_us = np.sort(np.concatenate(list(times_us.values())))
    all_gap_us = longest_gap_us(all_us)
    usual_us = dict.fromkeys(times_us, 0.0)
    for normal in training:
        for topic, times in _times_by_topic(normal).items():
            if topic in usual_us and len(times) > 1:
                usual_us[topic] = max(usual_us[topic], _SPARE * float(np.diff(times).max()))
    silent = []
    for topic, times in times_us.items():
        gaps = np.diff(times)
        if len(times) < _MIN_REGULAR or np.mean(gaps <= _SPARE * np.median(gaps)) < _REGULAR_SHARE:
            continue
        limit_us = max(longest_gap_us(times), usual_us[topic])
        ends = np.append(times[1:], all_us[-1])
        for begin, end in zip(times, ends, strict=True):
            if end - begin <= limit_us:
                continue
            # without a pause of the whole recording
            between = all_us[(all_us >= begin) & (all_us <= end)]
            if 1e6 * exposure_s(between, all_gap_us) > limit_us:
                silent.append(Silence(topic, int(begin), int(end), bool(begin == times[-1])))
    return sorted(silent, key=lambda silence: silence.begin_us)


def _times_by_topic(recording: LogRecording) -> dict[str, np.ndarray]:
    """Times of the messages of each topic (us), in order."""
    times_us = {}
    for topic, messages in recording.by_topic().items():
        times_us[topic] = np.sort(np.array([message.time_us for message in messages], np.int64))
    return times_us
