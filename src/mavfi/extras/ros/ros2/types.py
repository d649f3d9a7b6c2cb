"""Decodes ROS 2 messages of any type, with definitions of `rosbags` and of the machine's own `.msg` files."""

import re
from typing import Any, Protocol

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mavfi.errors import BadInputError, allowed
from mavfi.faults.operations import Operation, When, check_number_operation

_STEP = re.compile(r"([A-Za-z_]\w*)((?:\[\d+\])*)(?:\.|$)")
"""A part of a field's path: name and indices."""
_DTYPES = {"bool": "?", "byte": "u1", "octet": "u1", "char": "u1", "float32": "f4", "float64": "f8"}
_STRINGS = ("string", "wstring")


class DefinesTypes(Protocol):
    """Knows definitions of message types, as an agent does."""

    def definition(self, kind: str) -> str:
        """Text of the `.msg` file; a BadInputError if there is none."""


class Decoder:
    """Reads serialized messages of one type.

    Args:
        kind: Its full name, e.g. "sensor_msgs/msg/JointState".
        definitions: Where definitions are that `rosbags` lacks.

    Raises:
        BadInputError: The type is not known.
    """

    def __init__(self, kind: str, definitions: DefinesTypes) -> None:
        self.kind = kind
        self._store = get_typestore(Stores.LATEST)
        self._require(kind, definitions)

    def _require(self, kind: str, definitions: DefinesTypes) -> None:
        """Make sure that the store has a type and all types inside it."""
        if kind not in self._store.fielddefs:
            types = get_types_from_msg(definitions.definition(kind), kind)
            for _, description in types[kind][1]:
                for inner in _messages_in(description):
                    self._require(inner, definitions)
            self._store.register({name: types[name] for name in types if name not in self._store.fielddefs})

    def check(self, field: str, operation: Operation, when: When) -> None:
        """Check that a fault fits the type; a BadInputError says what is allowed."""
        if when.condition is not None:
            self.dtype(when.condition.field)
        if not field:
            return
        dtype = self.dtype(field)
        if operation.name != "freeze":
            check_number_operation(operation, dtype)

    def dtype(self, path: str) -> str:
        """NumPy's name of the type of the number at a path; a BadInputError if there is none."""
        description: Any = (Nodetype.NAME, self.kind)
        for name, indices in _steps(path):
            node, details = description
            if node != Nodetype.NAME:
                raise BadInputError(f"field {path}: {name!r} is in no message; allowed: the path of a number")
            members = dict(self._store.fielddefs[details][1])
            if name not in members:
                raise BadInputError(
                    f"field {path}: no member {name!r} in {details}; allowed: {allowed(list(members), name)}"
                )
            description = members[name]
            for _ in indices:
                node, details = description
                if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                    description = details[0]
                elif node == Nodetype.BASE and details[0] in _STRINGS:
                    description = (Nodetype.BASE, ("uint8", 0))
                else:
                    raise BadInputError(f"field {path}: {name} is no list; allowed: without an index")
        node, details = description
        if node != Nodetype.BASE or details[0] in _STRINGS:
            raise BadInputError(
                f"field {path}: is no number; allowed: the path of one, e.g. {path}{_example(description)}"
            )
        return _DTYPES.get(details[0]) or np.dtype(details[0]).str.lstrip("<|")

    def number(self, data: bytes, path: str) -> float | None:
        """The number at a path in a message; None if the message has no such element."""
        value = self._value(data, path)
        if isinstance(value, str):
            value = ord(value)
        if value is None:
            return None
        return float(value)

    def text(self, data: bytes, path: str) -> str:
        """The text at a path."""
        return str(self._value(data, path))

    def _value(self, data: bytes, path: str) -> Any:
        value: Any = self._store.deserialize_cdr(data, self.kind)
        try:
            for name, indices in _steps(path):
                value = getattr(value, name)
                for index in indices:
                    value = value[index]
        except (AttributeError, IndexError):
            return None
        return value


def _steps(path: str) -> list[tuple[str, list[int]]]:
    """Names and indices of a path."""
    steps = []
    position = 0
    while position < len(path) or not path:
        match = _STEP.match(path, position)
        if match is None:
            raise BadInputError(f"field {path!r}: not understood; allowed: a path like pose.position.x or ranges[17]")
        name, indices = match.groups()
        steps.append((name, [int(index) for index in re.findall(r"\d+", indices)]))
        position = match.end()
    return steps


def _messages_in(description: Any) -> list[str]:
    """Message types in the description of a member."""
    node, details = description
    if node == Nodetype.NAME:
        return [details]
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _messages_in(details[0])
    return []


def _example(description: Any) -> str:
    """What could follow a path that is no number."""
    node, _ = description
    if node == Nodetype.NAME:
        return ".x"
    return "[0]"
