"""Selection of the monitored numbers of messages, and their conversion to states of a detector."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mavfi.detectors.foreign import foreign_spec, foreign_state
from mavfi.errors import BadInputError, allowed
from mavfi.extras.logs.reader import Layout
from mavfi.faults.levels.message.definition import AbsentError
from mavfi.states import State, StateSpec

_MOST_FIELDS = 64
LONGEST_LIST = 16
"""Longer lists in messages are left out."""


@dataclass(frozen=True)
class Probe:
    """Extracts the monitored fields of a topic's messages, as a state of `spec`."""

    definition: Layout
    spec: StateSpec

    def read(self, message: bytes) -> State | None:
        """The field values; None if the message lacks any of them."""
        try:
            leaves = [self.definition.locate(message, field.name) for field in self.spec.header]
        except AbsentError:
            return None
        return foreign_state(self.spec, [float(leaf.value(message)) for leaf in leaves])


def make_probes(first: Mapping[str, tuple[Layout, bytes]], wanted: Sequence[str]) -> dict[str, Probe]:
    """The probe of each topic.

    Args:
        first: Definition and one message, by topic.
        wanted: Field paths, each for every topic that has it, or `topic:path` for one topic; empty = all numbers.

    Raises:
        BadInputError: A field that no topic has or that is not numeric; no fields at all; too many.
    """
    fields: dict[str, list[str]] = {topic: [] for topic in first}
    for name in wanted:
        _assign(name, first, fields)
    if not wanted:
        fields = {topic: definition.numbers(message, LONGEST_LIST) for topic, (definition, message) in first.items()}
    count = sum(map(len, fields.values()))
    if not 0 < count <= _MOST_FIELDS:
        raise BadInputError(f"--fields: {count} numbers in {', '.join(first)}; allowed: 1 to {_MOST_FIELDS}, name them")
    return {topic: Probe(first[topic][0], foreign_spec(topic, paths)) for topic, paths in fields.items() if paths}


def _assign(name: str, first: Mapping[str, tuple[Layout, bytes]], fields: dict[str, list[str]]) -> None:
    """Assign a requested field to its topics."""
    topic, colon, path = name.rpartition(":")
    if colon and _full(topic, first) not in first:
        raise BadInputError(f"field {name}: topic {topic}: not watched; allowed: {allowed(first)}")
    refusal: BadInputError | None = None
    found = False
    for candidate in [_full(topic, first)] if colon else list(first):
        try:
            first[candidate][0].check(path)
        except BadInputError as error:
            refusal = refusal or error
        else:
            fields[candidate].append(path)
            found = True
    if not found and refusal is not None:
        raise refusal


def _full(topic: str, first: Mapping[str, tuple[Layout, bytes]]) -> str:
    """Name of a topic, with the slash of ROS if it was omitted."""
    return topic if topic in first else "/" + topic.removeprefix("/")
