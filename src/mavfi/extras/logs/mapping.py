"""Which fields of recorded messages are which states of missions, so that rules and custom detectors can read them.

A mapping is a YAML file, see `LogMapping`; those in configs/log_mappings are shipped.  The world's frame is that of
mavfi: x forward, y left, z up; an autopilot's frame of north, east and down has the opposite y and z.
"""

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from pydantic import Field, field_validator

from mavfi.config import Config, names, shipped
from mavfi.errors import BadInputError, not_known
from mavfi.states import STATES, State, StateSpec, new_state

FOLDER = "log_mappings"
"""Folder of the shipped mappings in configs."""
_SOURCE = re.compile(r"(-?)\s*(?:(\S+):)?([^\s:]+)(?:\s+(\S+))?")
"""A number of a message: sign, topic, path, unit."""
_FACTORS = {
    "deg": math.pi / 180.0,
    "cdeg": math.pi / 18_000.0,
    "deg/s": math.pi / 180.0,
    "cdeg/s": math.pi / 18_000.0,
    "cm": 0.01,
    "mm": 0.001,
    "cm/s": 0.01,
    "mm/s": 0.001,
    "ms": 0.001,
}
"""Units that are converted to those of mavfi, with their factors."""


class FieldSource(NamedTuple):
    """Where the number of a field comes from.

    Attributes:
        topic: Its topic.
        path: Its path in messages of this topic; "" = none, `factor` is the number itself.
        factor: Number of the field / number of the message.
    """

    topic: str
    path: str
    factor: float

    @property
    def name(self) -> str:
        """The number, as in messages for the user."""
        return f"{self.topic}:{self.path}"


class StateMapping(Config):
    """How messages of a topic become a state of missions."""

    state: str = Field(description="name of the state, see `mavfi states`")
    topic: str = Field(description="topic whose messages become this state")
    fields: dict[str, str | float] = Field(
        description="by field of the state: a number in the topic or TOPIC:FIELD, with a sign before and a unit behind "
        'it ("-vy", "ATTITUDE:yaw deg"), or a constant',
        min_length=1,
    )

    @field_validator("fields")
    @classmethod
    def _check_fields(cls, fields: dict[str, str | float]) -> dict[str, str | float]:
        for name, text in fields.items():
            if isinstance(text, str):
                match = _SOURCE.fullmatch(text)
                if match is None or (match[4] and match[4] not in _FACTORS):
                    raise ValueError(f"{name}: {text!r}: allowed: [-][TOPIC:]FIELD [{', '.join(_FACTORS)}]")
        return fields

    def sources(self) -> dict[str, FieldSource]:
        """Where each mapped field comes from."""
        sources = {}
        for name, text in self.fields.items():
            if not isinstance(text, str):
                sources[name] = FieldSource("", "", float(text))
                continue
            match = _SOURCE.fullmatch(text)
            assert match is not None  # checked before
            factor = _FACTORS.get(match[4] or "", 1.0)
            if match[1]:
                factor = -factor
            sources[name] = FieldSource(match[2] or self.topic, match[3], factor)
        return sources


class LogMapping(Config):
    """Which messages become which states of missions; of several mappings to a state, the first that fits counts."""

    name: str
    states: list[StateMapping] = Field(min_length=1)
    counters: list[str] = Field([], description="TOPIC:FIELD of numbers that stay or grow by one")

    @field_validator("states")
    @classmethod
    def _check_states(cls, states: list[StateMapping]) -> list[StateMapping]:
        for mapping in states:
            if mapping.state not in STATES:
                raise ValueError(f"{mapping.state!r}: no such state; `mavfi states` lists all")
            fields = [field.name for field in STATES[mapping.state].header]
            for name in mapping.fields:
                if name not in fields:
                    raise ValueError(f"{mapping.state}: field {not_known(name, fields)}")
        return states


class UsedMapping(NamedTuple):
    """What applies of a mapping to recordings.

    Attributes:
        name: Its name; "" = none.
        states: Mapping of each state that can be made.
        counters: Numbers that stay or grow by one.
        missing: States that cannot be made, and the first topic or number that is absent.
    """

    name: str
    states: Mapping[str, StateMapping]
    counters: Sequence[str]
    missing: Mapping[str, str]

    @property
    def fields(self) -> set[str]:
        """All numbers that are read, as "TOPIC:FIELD"."""
        sources = [source for mapping in self.states.values() for source in mapping.sources().values()]
        return {source.name for source in sources if source.path} | set(self.counters)


NO_MAPPING = UsedMapping("", {}, (), {})
_MAX_NAMED = 4
"""Most numbers that a line names."""


def choose_mapping(name: str, available: Mapping[str, Collection[str]]) -> UsedMapping:
    """The mapping with a name or in a file; without a name, the shipped one from which most states can be made.

    Args:
        name: Name or path; "" = choose.
        available: Numbers by topic.

    Raises:
        BadInputError: Unknown name, an invalid file, or no state can be made.
    """
    candidates = [name]
    if not name:
        candidates = names(FOLDER)
    used = [_fitting(shipped(FOLDER, LogMapping, candidate), available) for candidate in candidates]
    best = max(used, key=lambda mapping: (len(mapping.states), len(mapping.fields)))
    if best.states:
        return best
    if name:
        reasons = "; ".join(f"{state}: {reason}" for state, reason in best.missing.items())
        raise BadInputError(f"--mapping: {name}: nothing can be mapped ({reasons})")
    return NO_MAPPING


def _fitting(mapping: LogMapping, available: Mapping[str, Collection[str]]) -> UsedMapping:
    """What applies of a mapping."""
    states: dict[str, StateMapping] = {}
    missing: dict[str, str] = {}
    for part in mapping.states:
        if part.state in states:
            continue
        absent = next(
            (
                source.name
                for source in part.sources().values()
                if source.path and source.path not in available.get(source.topic, ())
            ),
            "",
        )
        if absent:
            missing.setdefault(part.state, f"no {absent}")
        else:
            states[part.state] = part
            missing.pop(part.state, None)
    counters = [
        name for name in mapping.counters if name.rpartition(":")[2] in available.get(name.rpartition(":")[0], ())
    ]
    return UsedMapping(mapping.name, states, counters, missing)


def nearest_mapping(available: Mapping[str, Collection[str]]) -> str:
    """Why no shipped mapping fits, in a line: what that one lacks of which most numbers exist, or what each needs.

    Args:
        available: Numbers by topic.
    """
    tried = [shipped(FOLDER, LogMapping, name) for name in names(FOLDER)]
    most = 0
    text = "; ".join(f"{mapping.name} needs {mapping.states[0].topic}" for mapping in tried)
    for mapping in tried:
        sources = {source.name: source for part in mapping.states for source in part.sources().values() if source.path}
        lacking = [name for name, source in sources.items() if source.path not in available.get(source.topic, ())]
        if len(sources) - len(lacking) > most:
            most = len(sources) - len(lacking)
            text = f"nearest: {mapping.name}, which lacks {', '.join(lacking[:_MAX_NAMED])}"
            if len(lacking) > _MAX_NAMED:
                text += f" and {len(lacking) - _MAX_NAMED} more"
    return text


class Mapper:
    """Makes states of missions from states of topics; fields that are not mapped are 0.

    Args:
        used: What applies of a mapping.
    """

    def __init__(self, used: UsedMapping) -> None:
        self._by_topic: dict[str, list[tuple[StateSpec, dict[str, FieldSource]]]] = {}
        for name, mapping in used.states.items():
            self._by_topic.setdefault(mapping.topic, []).append((STATES[name], mapping.sources()))
        self._sources = {name: mapping.sources() for name, mapping in used.states.items()}
        self._last: dict[str, dict[str, float]] = {}

    def start(self) -> None:
        """Forget everything at the start of a recording."""
        self._last = {}

    def made_of(self, state: State) -> Iterator[State]:
        """The states that become of a message: with the latest numbers of other topics, as soon as there are any."""
        topic = state.spec.name
        for spec, sources in self._by_topic.get(topic, ()):
            values = {topic: values_by_name(state)}
            others = {source.topic for source in sources.values() if source.path} - {topic}
            if not others <= set(self._last):
                continue
            values |= {other: self._last[other] for other in others}
            made = new_state(spec.name)
            for name, source in sources.items():
                number = source.factor
                if source.path:
                    number *= values[source.topic][source.path]
                made.header[name] = number
            yield made

    def has(self, state: str, fields: Collection[str]) -> bool:
        """Whether these fields of a state are mapped."""
        return self._sources.get(state, {}).keys() >= set(fields)

    def accept(self, state: State) -> None:
        """Remember the numbers of a message."""
        self._last[state.spec.name] = values_by_name(state)

    def name_of(self, field: str) -> str:
        """The number of a message, "TOPIC:FIELD", that became a field "state.field"; else the field itself."""
        state, _, name = field.rpartition(".")
        source = self._sources.get(state, {}).get(name)
        if source is None or not source.path:
            return field
        return source.name

    def memory(self) -> dict[str, Any]:
        """What it remembers."""
        return dict(self._last)

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Inverse of `memory`."""
        self._last = dict(memory)


def values_by_name(state: State) -> dict[str, float]:
    """The numbers of a state's header."""
    names_of_fields = [field.name for field in state.spec.header]
    return dict(zip(names_of_fields, map(float, state.header[0].item()), strict=True))
