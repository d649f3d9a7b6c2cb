"""Which numbers of recorded flights are monitored, and why the others are not."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np

from mavfi.detectors.foreign import SMALLEST_SAMPLE, foreign_spec
from mavfi.errors import BadInputError, allowed, hint
from mavfi.extras.logs.circular import KINDS, Geometry, Numbers, component_groups, recognise
from mavfi.extras.logs.counting import COUNTS, counts
from mavfi.extras.logs.mapping import NO_MAPPING, UsedMapping, choose_mapping, nearest_mapping
from mavfi.extras.logs.recording import LogRecording, values_of
from mavfi.flight.log_readers import LONGEST_LIST, LoggedMessage, Probe

_NOT_RECOMMENDED = "not recommended (see --fields)"
_NOT_WANTED = "not in --fields"
_NOT_MAPPED = "not in the mapping"
_LATEST_BEGIN = 0.5
"""Largest share of the messages of a training before the first finite value of a monitored field."""


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
        probes: Monitored fields by topic.
        geometries: Angles and quaternions among them, by topic.
        not_monitored: All other numbers, with the reason.
        mapping: Which monitored fields become states of missions.
        late: Monitored fields, by topic, that are not finite at the beginning of a recording of the training.
    """

    probes: Mapping[str, Probe]
    geometries: Mapping[str, Geometry]
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
        if not pattern or kind not in KINDS:
            raise BadInputError(f"--kinds: {text!r}: allowed: FIELD=KIND with a KIND of {', '.join(KINDS)}")
        kinds[pattern] = kind
    return kinds


def select(
    training: Sequence[LogRecording], judged: Sequence[LogRecording], wanted: Wanted = EVERYTHING
) -> LogSelection:
    """Monitored fields by topic: those that are finite in the training, from their first finite value on.

    In the recordings to be judged they only need to exist: there a value that is not finite is an alarm.

    Args:
        training: Normal recordings.
        judged: Recordings to be judged.
        wanted: What to monitor.

    Raises:
        BadInputError: A wanted field cannot be monitored, or there is none at all.
    """
    by_topic = _Topics(training, judged, wanted)
    probes: dict[str, Probe] = {}
    geometries: dict[str, Geometry] = {}
    for topic in by_topic.names:
        part = by_topic.monitored(topic)
        if part is not None:
            probes[topic], geometries[topic] = part
    # Refuse what the user has named in vain.
    cut = cut_text([*training, *judged])
    if cut:
        cut = f" ({cut})"
    _check_wanted(wanted.fields, probes, by_topic.left_out, cut)
    if not probes:
        files = ", ".join(recording.name for recording in [*training, *judged])
        raise BadInputError(
            f"{files}: no numbers in common{cut}; allowed: topics with {SMALLEST_SAMPLE} messages or more "
            f"in the training, with finite numbers{_examples(by_topic.left_out)}"
        )
    for pattern in wanted.kinds:
        if pattern not in by_topic.used_kinds:
            fields = [f"{topic}:{field.name}" for topic, probe in probes.items() for field in probe.spec.header]
            raise BadInputError(f"--kinds: {pattern}: no monitored field; allowed: {allowed(fields, pattern)}")
    mapping = by_topic.mapping
    if mapping.name:
        monitored = {topic: [field.name for field in probe.spec.header] for topic, probe in probes.items()}
        mapping = choose_mapping(wanted.mapping or mapping.name, monitored)
    return LogSelection(probes, geometries, by_topic.left_out, mapping, by_topic.late)


class _Topics:
    """The topics of recordings.

    Args:
        training: See `select`.
        judged: See `select`.
        wanted: See `select`.

    Attributes:
        mapping: The mapping to states of missions.
        names: All topics, in the order of their first appearance.
        left_out: What is not monitored in the topics asked for so far.
        used_kinds: Patterns of the wanted kinds that a field of these topics has.
        late: Monitored fields of these topics that are not finite at the beginning of the training.
    """

    def __init__(self, training: Sequence[LogRecording], judged: Sequence[LogRecording], wanted: Wanted) -> None:
        self._training = [(recording.name, recording.by_topic()) for recording in training]
        self._judged = [(recording.name, recording.by_topic()) for recording in judged]
        self._wanted = wanted
        self._faults = {recording.fault for recording in (*training, *judged)}
        self._recommended: Mapping[str, Sequence[str]] = {}
        for recording in training:
            self._recommended = self._recommended or recording.recommended
        self.names = list(dict.fromkeys(topic for _, topics in (*self._training, *self._judged) for topic in topics))
        self.left_out: list[NotMonitored] = []
        self.used_kinds: set[str] = set()
        self.late: dict[str, set[str]] = {}
        self.mapping = NO_MAPPING
        if wanted.mapping is not None:
            self.mapping = self._usable_mapping(wanted.mapping)

    def _usable_mapping(self, name: str) -> UsedMapping:
        """The mapping of this name, see `choose_mapping`, to numbers that can be monitored."""
        available = self._available()
        refusals: list[str] = []
        while True:
            try:
                mapping = choose_mapping(name, available)
            except BadInputError as error:
                raise BadInputError("; ".join([str(error), *refusals[:_MAX_REASONS]])) from None
            if self._wanted.only_mapped and not mapping.states:
                needs = "; ".join([nearest_mapping(available), *refusals[:_MAX_REASONS]])
                raise BadInputError(
                    f"{', '.join(name for name, _ in self._training)}: the rules apply to states of missions, and no "
                    f"shipped mapping fits ({needs}); allowed: --mapping FILE, see docs/how-to/logs.md"
                )
            refused = 0
            for topic, numbers in available.items():
                read = [number for number in numbers if f"{topic}:{number}" in mapping.fields]
                reasons = self._reasons(topic, read)
                available[topic] = [number for number in numbers if number not in reasons]
                refused += len(reasons)
                refusals += [f"{topic}:{number} {reason}" for number, reason in reasons.items()]
            if not refused:
                return mapping

    def _reasons(self, topic: str, names: Sequence[str]) -> dict[str, str]:
        """Why numbers of a topic cannot be monitored, by name."""
        normal = [(name, topics[topic]) for name, topics in self._training if topic in topics]
        others = [topics[topic] for _, topics in self._judged if topic in topics]
        reason = self._reason_against(sum(len(messages) for _, messages in normal), others)
        if reason:
            return dict.fromkeys(names, reason)
        return _reasons_against_fields(normal, others, names)

    def _available(self) -> dict[str, list[str]]:
        """Numbers of each topic of the training."""
        available: dict[str, list[str]] = {}
        for _, topics in self._training:
            for topic, messages in topics.items():
                if topic not in available:
                    available[topic] = messages[0].layout.numbers(messages[0].data, LONGEST_LIST)
        return available

    def _candidates(self, topic: str, numbers: Sequence[str]) -> set[str]:
        """Numbers of a topic that are wanted, or mapped; by default those that are recommended."""
        mapped = {name for name in numbers if f"{topic}:{name}" in self.mapping.fields}
        if self._wanted.only_mapped and not self._wanted.fields:
            return mapped
        return mapped.union(_candidates(topic, numbers, self._wanted.fields, self._recommended))

    def monitored(self, topic: str) -> tuple[Probe, Geometry] | None:
        """What is monitored of a topic; None = nothing."""
        normal = [(name, topics[topic]) for name, topics in self._training if topic in topics]
        others = [topics[topic] for _, topics in self._judged if topic in topics]
        reason = self._reason_against(sum(len(messages) for _, messages in normal), others)
        if reason:
            self.left_out.append(NotMonitored(topic, "", reason))
            return None
        # The numbers that are wanted, or recommended, and what may be further components of a quaternion.
        example = normal[0][1][0]
        numbers = example.layout.numbers(example.data, LONGEST_LIST)
        candidates = self._candidates(topic, numbers)
        read = set(candidates)
        for group in component_groups(numbers):
            if candidates.intersection(group):
                read.update(group)
        # Those of them that are finite in the training and exist in the others.
        reasons = _reasons_against_fields(normal, others, [name for name in numbers if name in read])
        reasons |= {name: "tells of the fault" for name in numbers if f"{topic}:{name}" in self._faults}
        names = [name for name in numbers if name in read and name not in reasons]
        tables = [Numbers(names, values_of(messages, names)[0]) for _, messages in normal]
        units: Mapping[str, str] = getattr(example.layout, "units", {})
        declared = _declared(topic, names, self._wanted.kinds, self.used_kinds)
        # Counters and clocks are no signal, unless the user has named them; rules and custom detectors may read them.
        if self._wanted.mapping is None and not self._wanted.fields:
            times_us = [np.array([message.time_us for message in messages], np.int64) for _, messages in normal]
            for index, name in enumerate(names):
                if name not in declared and counts(name, [table.values[:, index] for table in tables], times_us):
                    reasons[name] = COUNTS
        geometry = recognise(tables, units, declared)
        # The sign of a quaternion follows from all of its components: none is monitored alone.
        for quaternion in geometry.quaternions:
            if candidates.intersection(quaternion):
                candidates.update(quaternion)
        self._leave_out(topic, numbers, candidates, reasons)
        names = [name for name in names if name in candidates and name not in reasons]
        if not names:
            return None
        late = {name for name in names for table in tables if not np.isfinite(table.values[0, table.names.index(name)])}
        if late:
            self.late[topic] = late
        return Probe(example.layout, foreign_spec(topic, names)), geometry.restricted(names)

    def _reason_against(self, count: int, others: Sequence[Sequence[LoggedMessage]]) -> str:
        """Why a topic with `count` messages in the training cannot be monitored; "" = it can."""
        if count == 0:
            return "not in the training"
        if count < SMALLEST_SAMPLE:
            return f"fewer than {SMALLEST_SAMPLE} messages in the training"
        if not others:
            return f"silent in {', '.join(name for name, _ in self._judged)}"
        return ""

    def _leave_out(
        self, topic: str, numbers: Sequence[str], candidates: Collection[str], reasons: Mapping[str, str]
    ) -> None:
        """Add to `left_out` the numbers of a topic that are no candidates, and those with a reason against them."""
        default_reason = _NOT_RECOMMENDED
        if self._wanted.fields:
            default_reason = _NOT_WANTED
        elif self._wanted.only_mapped:
            default_reason = _NOT_MAPPED
        for name in numbers:
            if name not in candidates:
                self.left_out.append(NotMonitored(topic, name, default_reason))
            elif name in reasons:
                self.left_out.append(NotMonitored(topic, name, reasons[name]))


def cut_text(recordings: Sequence[LogRecording]) -> str:
    """Which files are cut; "" = none."""
    names = [recording.name for recording in recordings if recording.cut]
    if names:
        return f"{', '.join(dict.fromkeys(names))}: cut, the last message is not complete"
    return ""


def _candidates(
    topic: str, numbers: Sequence[str], requested: Sequence[str], recommended: Mapping[str, Sequence[str]]
) -> list[str]:
    """Numbers of a topic that are wanted; by default those that are recommended."""
    if requested:
        requested_names = [name.rpartition(":") for name in requested]
        return [path for topic_of_name, _, path in requested_names if topic_of_name in ("", topic) and path in numbers]
    if not recommended:
        return list(numbers)
    return [name for name in recommended.get(_without_instance(topic), ()) if name in numbers]


def _without_instance(topic: str) -> str:
    """Name of a topic without the number of its instance or source, to which the same fields belong."""
    return re.sub(r"(\.\d+)+$|\[\w+\]$", "", topic)


def _reasons_against_fields(
    normal: Sequence[tuple[str, Sequence[LoggedMessage]]],
    others: Sequence[Sequence[LoggedMessage]],
    names: Sequence[str],
) -> dict[str, str]:
    """Why fields of a topic cannot be monitored, by field."""
    reasons: dict[str, str] = {}
    for recording, messages in normal:
        values, present = values_of(messages, names)
        for column, name in enumerate(names):
            if not present[:, column].all():
                reasons.setdefault(name, f"absent in messages of {recording}")
                continue
            # Not finite at the beginning: the value is not yet known, as before an estimator has converged.
            is_finite = np.isfinite(values[:, column])
            begin = int(np.argmax(is_finite))
            if begin <= _LATEST_BEGIN * len(messages) and is_finite[begin:].all():
                continue
            if begin > _LATEST_BEGIN * len(messages) or not is_finite.any():
                begin = 0
            first = messages[begin + int(np.argmin(is_finite[begin:]))]
            reasons.setdefault(name, f"not finite in {recording}, first at {1e-6 * first.time_us:.2f} s")
    for messages in others:
        layout = messages[0].layout
        for name in names:
            try:
                layout.check(name)
            except BadInputError:
                reasons.setdefault(name, "not in the recordings to be judged")
    return reasons


def _declared(topic: str, names: Sequence[str], kinds: Mapping[str, str], used: set[str]) -> dict[str, str]:
    """Kinds of a topic's fields that the user has declared; adds the patterns that apply to `used`."""
    declared = {}
    for pattern, kind in kinds.items():
        for name in names:
            if pattern in (name, f"{topic}:{name}") or fnmatchcase(f"{topic}:{name}", _literal_brackets(pattern)):
                declared[name] = kind
                used.add(pattern)
    return declared


def _literal_brackets(pattern: str) -> str:
    """A pattern of names with "*" and "?", in which brackets are those of an index; without a topic, for all topics."""
    escaped = pattern.replace("[", "[[]")
    if ":" in pattern:
        return escaped
    return f"*:{escaped}"


def _check_wanted(
    wanted: Sequence[str], probes: Mapping[str, Probe], left_out: Sequence[NotMonitored], cut: str
) -> None:
    """Refuse wanted fields that are not monitored, say why, and name the nearest ones."""
    monitored = [(topic, field.name) for topic, probe in probes.items() for field in probe.spec.header]
    possible = [*monitored, *((item.topic, item.field) for item in left_out if item.reason == _NOT_WANTED)]
    for name in wanted:
        topic, _, path = name.rpartition(":")
        if any(path == monitored_path and topic in ("", owner) for owner, monitored_path in monitored):
            continue
        reason = "no such number in messages of the training"
        for item in left_out:
            if topic in ("", item.topic) and item.field in ("", path) and (topic or item.field):
                reason = item.reason
        # What could be named instead: in the same topic if there is one, and in the same form.
        topics = {owner for owner, _ in possible}
        names = []
        for owner, number in possible:
            if topic in topics and owner != topic:
                continue
            if topic:
                names.append(f"{owner}:{number}")
            else:
                names.append(number)
        raise BadInputError(f"--fields: {name}: {reason}{cut}{hint(name, names)}; allowed: {allowed(names, name)}")


def _examples(left_out: Sequence[NotMonitored]) -> str:
    """The first reasons, for a message."""
    reasons = [f"{item.topic} {item.field}".rstrip() + f" {item.reason}" for item in left_out[:3]]
    if not reasons:
        return ""
    return f" ({'; '.join(reasons)})"


# ---- what is said about it -------------------------------------------------------------------------------------------
_WIDTH = 80
_MIN_NAMES = 3
"""Names that a line has in any case, if there are so many."""
_MAX_REASONS = 8


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
