"""Which numbers of recorded flights are monitored, and why the others are not."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np

from mavfi.errors import BadInputError, allowed, hint
from mavfi.extras.logs.mapping import NO_MAPPING, UsedMapping, choose_mapping, nearest_mapping
from mavfi.extras.logs.recording import LogRecording, values_of
from mavfi.extras.shared.foreign import (
    COUNTER,
    QUATERNION,
    SMALLEST_SAMPLE,
    TURNS,
    Numbers,
    Topic,
    foreign_spec,
    recognise,
)
from mavfi.extras.shared.log_readers import LONGEST_LIST, LoggedMessage

COUNTS = "counts messages or time (see --kinds)"
CONSTANT = "constant in the training"
_NOT_RECOMMENDED = "not recommended (see --fields)"
_NOT_WANTED = "not in --fields"
_NOT_MAPPED = "not in the mapping"
_LATEST_BEGIN = 0.5
"""Largest share of the messages of a training before the first finite value of a monitored field."""
_KINDS = (*TURNS, QUATERNION, "number")
"""What a field can be declared as."""


class NotMonitored(NamedTuple):
    """A number, or a whole topic, that is not monitored.

    Attributes:
        topic: Its topic.
        field: Its name; "" = the whole topic.
        reason: Why.
    """

    topic: str
    field: str
    reason: str


class Wanted(NamedTuple):
    """What to monitor.

    Attributes:
        fields: "TOPIC:FIELD" or "FIELD"; empty = the recommended ones of the format, or all.
        kinds: What fields are, see `parse_kinds`; that of all others is recognised.
        mapping: Mapping to states of missions, see `choose_mapping`; None = none.
        only_mapped: Whether nothing but mapped fields is monitored, unless there are `fields`.
    """

    fields: Sequence[str] = ()
    kinds: Mapping[str, str] = {}
    mapping: str | None = None
    only_mapped: bool = False


EVERYTHING = Wanted()


@dataclass(frozen=True)
class LogSelection:
    """What is monitored.

    Attributes:
        topics: Monitored fields by topic, and which of them are angles and quaternions.
        not_monitored: All other numbers, with the reason.
        mapping: Which monitored fields become states of missions.
        late: Monitored fields, by topic, that are not finite at the beginning of a recording of the training.
    """

    topics: Mapping[str, Topic]
    not_monitored: Sequence[NotMonitored] = ()
    mapping: UsedMapping = NO_MAPPING
    late: Mapping[str, Collection[str]] = field(default_factory=dict)


def parse_kinds(texts: Sequence[str]) -> dict[str, str]:
    """What fields are, by name or pattern, from texts like "ATTITUDE:yaw=rad" or "q*=quaternion".

    Raises:
        BadInputError: Another form, or an unknown kind.
    """
    kinds = {}
    for text in texts:
        pattern, _, kind = text.rpartition("=")
        if not pattern or kind not in _KINDS:
            raise BadInputError(f"--kinds: {text!r}: allowed: FIELD=KIND with a KIND of {', '.join(_KINDS)}")
        kinds[pattern] = kind
    return kinds


def select(
    training: Sequence[LogRecording], judged: Sequence[LogRecording] = (), wanted: Wanted = EVERYTHING
) -> LogSelection:
    """Monitored fields by topic: those that are finite in the training, from their first finite value on.

    In the recordings to be judged they only need to exist: there a value that is not finite is an alarm.

    Args:
        training: Normal recordings.
        judged: Recordings to be judged; empty = they come later.
        wanted: What to monitor.

    Raises:
        BadInputError: A wanted field cannot be monitored, or there is none at all.
    """
    selector = _Selector(training, judged, wanted)
    for name in selector.names:
        selector.add(name)
    topics = selector.topics
    # Refuse what the user has named in vain.
    cut = cut_text([*training, *judged])
    if cut:
        cut = f" ({cut})"
    fields = [f"{name}:{field}" for name, topic in topics.items() for field in topic.names]
    _check_wanted(wanted.fields, fields, selector.left_out, cut)
    if not topics:
        files = ", ".join(recording.name for recording in [*training, *judged])
        needs = f"allowed: topics with {SMALLEST_SAMPLE} messages or more in the training, with finite numbers"
        reasons = summary(selector.left_out)[:_MAX_EXAMPLES]
        raise BadInputError("; ".join([f"{files}: no numbers in common{cut}", needs, *reasons]))
    for pattern in wanted.kinds:
        if not any(_matches(pattern, field) for field in fields):
            raise BadInputError(f"--kinds: {pattern}: no monitored field; allowed: {allowed(fields, pattern)}")
    mapping = selector.mapping
    if mapping.name:
        monitored = {name: topic.names for name, topic in topics.items()}
        mapping = choose_mapping(wanted.mapping or mapping.name, monitored)
    return LogSelection(topics, selector.left_out, mapping, selector.late)


class _Selector:
    """Selects the fields of one topic after the other.

    Args:
        training: See `select`.
        judged: See `select`.
        wanted: See `select`.

    Attributes:
        names: All topics, in the order of their first appearance.
        mapping: The mapping to states of missions.
        topics: See `LogSelection`, those added so far; so is `late`.
        left_out: What is not monitored of them.
    """

    def __init__(self, training: Sequence[LogRecording], judged: Sequence[LogRecording], wanted: Wanted) -> None:
        self._wanted = wanted
        self._default_reason = _NOT_RECOMMENDED
        if wanted.fields:
            self._default_reason = _NOT_WANTED
        elif wanted.only_mapped:
            self._default_reason = _NOT_MAPPED
        self._faults = {recording.fault for recording in (*training, *judged)}
        self._recommended = next((recording.recommended for recording in training if recording.recommended), {})
        self._judged = {recording.name: recording.by_topic() for recording in judged}
        # messages of each topic in the training, with the name of the recording
        self._normal: dict[str, list[tuple[str, list[LoggedMessage]]]] = {}
        for recording in training:
            for topic, messages in recording.by_topic().items():
                self._normal.setdefault(topic, []).append((recording.name, messages))
        self.names = list(
            dict.fromkeys([*self._normal, *(name for topics in self._judged.values() for name in topics)])
        )
        self.topics: dict[str, Topic] = {}
        self.late: dict[str, set[str]] = {}
        self.left_out: list[NotMonitored] = []
        self.mapping = NO_MAPPING
        if wanted.mapping is not None:
            self.mapping = self._usable_mapping(wanted.mapping)

    def _usable_mapping(self, name: str) -> UsedMapping:
        """The mapping of this name, see `choose_mapping`, to numbers that can be monitored."""
        available = {topic: self._numbers(topic) for topic in self._normal}
        refusals: list[str] = []
        while True:
            try:
                mapping = choose_mapping(name, available)
            except BadInputError as error:
                raise BadInputError("; ".join([str(error), *refusals[:_MAX_REASONS]])) from None
            if self._wanted.only_mapped and not mapping.states:
                files = dict.fromkeys(file for recordings in self._normal.values() for file, _ in recordings)
                needs = "; ".join([nearest_mapping(available), *refusals[:_MAX_REASONS]])
                raise BadInputError(
                    f"{', '.join(files)}: the rules apply to states of missions, and no shipped mapping fits "
                    f"({needs}); allowed: --mapping FILE, see docs/how-to/logs.md"
                )
            before = len(refusals)
            for topic, numbers in available.items():
                reasons = self._reasons_against(topic, [n for n in numbers if f"{topic}:{n}" in mapping.fields])
                available[topic] = [number for number in numbers if number not in reasons]
                refusals += [f"{topic}:{number} {reason}" for number, reason in reasons.items()]
            if len(refusals) == before:
                return mapping

    def _numbers(self, topic: str) -> list[str]:
        """Numbers of a topic of the training."""
        example = self._normal[topic][0][1][0]
        return example.layout.numbers(example.data, LONGEST_LIST)

    def _reason_against(self, topic: str) -> str:
        """Why a topic cannot be monitored; "" = it can."""
        if topic not in self._normal:
            return "not in the training"
        if sum(len(messages) for _, messages in self._normal[topic]) < SMALLEST_SAMPLE:
            return f"fewer than {SMALLEST_SAMPLE} messages in the training"
        if self._judged and not any(topic in topics for topics in self._judged.values()):
            return f"silent in {', '.join(self._judged)}"
        return ""

    def _reasons_against(self, topic: str, names: Sequence[str]) -> dict[str, str]:
        """Why fields of a topic cannot be monitored, by field; notes in `late` those that begin late."""
        if self._reason_against(topic):
            return dict.fromkeys(names, self._reason_against(topic))
        reasons: dict[str, str] = {}
        for recording, messages in self._normal[topic]:
            values, present = values_of(messages, names)
            for column, name in enumerate(names):
                if not present[:, column].all():
                    reasons.setdefault(name, f"absent in messages of {recording}")
                    continue
                begin, reason = _first_valid(values[:, column], messages, recording)
                if reason:
                    reasons.setdefault(name, reason)
                elif begin:
                    self.late.setdefault(topic, set()).add(name)
        for topics in self._judged.values():
            for name in names:
                try:
                    if topic in topics:
                        topics[topic][0].layout.check(name)
                except BadInputError:
                    reasons.setdefault(name, "not in the recordings to be judged")
        return reasons

    def _constant(self, topic: str, names: Sequence[str]) -> list[str]:
        """Fields that do not change in any recording of the training, such as outputs to which nothing is connected."""
        varies = np.zeros(len(names), np.bool_)
        for _, messages in self._normal[topic]:
            values, _ = values_of(messages, names)
            for column in range(len(names)):
                finite = values[np.isfinite(values[:, column]), column]
                varies[column] |= bool((finite != finite[:1]).any())
        return [name for name, is_signal in zip(names, varies, strict=True) if not is_signal]

    def _candidates(self, topic: str, numbers: Sequence[str]) -> set[str]:
        """Numbers of a topic that are wanted, or mapped; by default those that are recommended."""
        candidates = {name for name in numbers if f"{topic}:{name}" in self.mapping.fields}
        if self._wanted.fields:
            return candidates.union(name for name in numbers if {name, f"{topic}:{name}"} & {*self._wanted.fields})
        if self._wanted.only_mapped:
            return candidates
        if self._recommended:
            # the same fields belong to all instances and sources of a topic
            plain_topic = re.sub(r"(\.\d+)+$|\[\w+\]$", "", topic)
            return candidates.union(set(numbers).intersection(self._recommended.get(plain_topic, ())))
        return set(numbers)

    def add(self, topic: str) -> None:
        """Select what is monitored of a topic."""
        reason = self._reason_against(topic)
        if reason:
            self.left_out.append(NotMonitored(topic, "", reason))
            return
        # What is wanted, and what may be further components of a quaternion, as far as it can be monitored.
        numbers = self._numbers(topic)
        candidates = self._candidates(topic, numbers)
        near: set[str] = set()
        for index, name in enumerate(numbers):
            if name in candidates:
                near.update(numbers[max(index - 3, 0) : index + 4])
        reasons = self._reasons_against(topic, [name for name in numbers if name in near])
        reasons |= {name: "tells of the fault" for name in numbers if f"{topic}:{name}" in self._faults}
        usable = [name for name in numbers if name in near and name not in reasons]
        kinds = self._kinds_of(topic, usable)
        # Counters, clocks and what never changes are no signal, unless the user has named them; rules and custom
        # detectors may read them.
        if self._wanted.mapping is None and not self._wanted.fields:
            reasons |= {name: COUNTS for name in usable if kinds.get(name) == COUNTER}
            constant = self._constant(topic, [name for name in usable if kinds.get(name) != QUATERNION])
            reasons |= dict.fromkeys(constant, CONSTANT)
        # The sign of a quaternion follows from all of its components: none is monitored alone.
        components = [name for name in usable if kinds.get(name) == QUATERNION]
        for start in range(0, len(components), 4):
            if candidates.intersection(components[start : start + 4]):
                candidates.update(components[start : start + 4])
        reasons |= dict.fromkeys(set(numbers) - candidates, self._default_reason)
        self.left_out += [NotMonitored(topic, name, reasons[name]) for name in numbers if name in reasons]
        names = [name for name in usable if name not in reasons]
        if names:
            self.topics[topic] = Topic(foreign_spec(topic, names), kinds)
            self.late[topic] = self.late.get(topic, set()).intersection(names)

    def _kinds_of(self, topic: str, names: Sequence[str]) -> dict[str, str]:
        """What fields of a topic are, as declared by the user, or recognised."""
        declared: dict[str, str] = {}
        for pattern, kind in self._wanted.kinds.items():
            declared |= {name: kind for name in names if _matches(pattern, f"{topic}:{name}")}
        components = [name for name, kind in declared.items() if kind == QUATERNION]
        if len(components) % 4:
            raise BadInputError(
                f"--kinds: {', '.join(components)}: allowed: {QUATERNION} for all four components of one"
            )
        others = [name for name in names if name not in declared]
        tables = []
        for _, messages in self._normal[topic]:
            times_us = np.array([message.time_us for message in messages], np.int64)
            tables.append(Numbers(others, values_of(messages, others)[0], times_us))
        units: Mapping[str, str] = getattr(self._normal[topic][0][1][0].layout, "units", {})
        return recognise(tables, units) | declared


def _first_valid(values: np.ndarray, messages: Sequence[LoggedMessage], recording: str) -> tuple[int, str]:
    """Index from which on a number of a recording is finite, and why it cannot be monitored ("" = it can)."""
    is_finite = np.isfinite(values)
    if not is_finite.any():
        return 0, f"never finite in {recording}"
    # Not finite at the beginning: the value is not yet known, as before an estimator has converged.
    begin = int(np.argmax(is_finite))
    if begin > _LATEST_BEGIN * len(messages):
        begin = 0
    if is_finite[begin:].all():
        return begin, ""
    first = messages[begin + int(np.argmin(is_finite[begin:]))]
    return begin, f"not finite in {recording}, first at {1e-6 * first.time_us:.2f} s"


def _matches(pattern: str, field: str) -> bool:
    """Whether a pattern with "*" and "?", in which brackets are those of an index, means a field, "TOPIC:FIELD"."""
    escaped = pattern.replace("[", "[[]")
    if ":" not in pattern:
        escaped = f"*:{escaped}"
    return fnmatchcase(field, escaped)


def cut_text(recordings: Sequence[LogRecording]) -> str:
    """Which files are cut; "" = none."""
    names = [recording.name for recording in recordings if recording.cut]
    if names:
        return f"{', '.join(dict.fromkeys(names))}: cut, the last message is not complete"
    return ""


def _check_wanted(wanted: Sequence[str], monitored: Sequence[str], left_out: Sequence[NotMonitored], cut: str) -> None:
    """Refuse wanted fields that are not monitored, say why, and name the nearest ones."""
    possible = [*monitored, *(f"{item.topic}:{item.field}" for item in left_out if item.reason == _NOT_WANTED)]
    for name in wanted:
        topic, _, path = name.rpartition(":")
        if any(name in (field, field.rpartition(":")[2]) for field in monitored):
            continue
        reason = "no such number in messages of the training"
        for item in left_out:
            if topic in ("", item.topic) and item.field in ("", path) and (topic or item.field):
                reason = item.reason
        names = possible
        if not topic:
            names = [field.rpartition(":")[2] for field in possible]
        raise BadInputError(f"--fields: {name}: {reason}{cut}{hint(name, names)}; allowed: {allowed(names, name)}")


# ---- what is said about it -------------------------------------------------------------------------------------------
_WIDTH = 80
_MIN_NAMES = 3
"""Names that a line has in any case, if there are so many."""
_MAX_REASONS = 8
_MAX_EXAMPLES = 3
"""Most lines of reasons, and of those in a refusal."""


def summary(not_monitored: Sequence[NotMonitored]) -> list[str]:
    """What is not monitored, by reason."""
    by_reason: dict[str, list[str]] = {}
    for item in not_monitored:
        name = item.topic
        if item.field:
            name = f"{item.topic}:{item.field}"
        by_reason.setdefault(item.reason.partition(", first at")[0], []).append(name)
    # A field that is not finite, or absent, says more than one that nobody has asked for.
    reasons = sorted(by_reason, key=lambda reason: reason in (_NOT_WANTED, _NOT_RECOMMENDED, _NOT_MAPPED))
    lines = []
    for reason in reasons[:_MAX_REASONS]:
        lines.append(shortened(f"not monitored, {reason}: ", by_reason[reason]))
    if len(reasons) > _MAX_REASONS:
        lines.append(f"not monitored, {len(reasons) - _MAX_REASONS} more reasons: see --json")
    return lines


def shortened(head: str, names: Sequence[str]) -> str:
    """A line of `_WIDTH` characters with as many names as it can hold, `_MIN_NAMES` at least, and how many more."""
    count = len(names)
    while True:
        line = head + ", ".join(names[:count])
        if count < len(names):
            line += f" and {len(names) - count} more"
        if len(line) <= _WIDTH or count <= _MIN_NAMES:
            return line
        count -= 1
