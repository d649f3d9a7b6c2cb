"""Message types of a ROS 2 graph in mavfi's process: standard ones of `rosbags`, others from the machine."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mavfi.errors import BadInputError, MavfiError, not_known
from mavfi.extras.shared.message_definition import Definition
from mavfi.faults.changes import Change
from mavfi.faults.operations import check_number_operation
from mavfi.plugins import reason

_STEP = re.compile(r"([A-Za-z_]\w*)((?:\[\d+\])*)(?:\.|$)")
"""A part of a field's path: name and indices."""
_DTYPES = {"bool": "?", "byte": "u1", "octet": "u1", "char": "u1", "float32": "f4", "float64": "f8"}
_STRINGS = ("string", "wstring")
NO_FIELD = "has no field; allowed: drop, delay, duplicate"
"""Why a number cannot be changed in a message without any, such as std_msgs/msg/Empty."""
_OF_NO_FIELD = "structure_needs_at_least_one_member"
"""The only member of such a message in languages that have no empty structures."""
_HEADER = "MSG: std_msgs/Header\n"


class TypeLibrary:
    """Definitions of message types such as "nav_msgs/msg/Odometry".

    Args:
        distribution: Whose standard types they are, e.g. "jazzy"; those of the latest one, if it is not known.
        fetch: Returns the text of the `.msg` file of a type that is not standard, see `AgentClient.definition`.
    """

    def __init__(self, distribution: str, fetch: Callable[[str], str]) -> None:
        name = f"ROS2_{distribution.upper()}"
        self.store: Any = get_typestore(Stores.__members__.get(name, Stores.LATEST))
        self._fetch = fetch

    def require(self, kind: str) -> None:
        """Make a type and its components known.

        Raises:
            BadInputError: A type is neither standard nor defined on the machine.
        """
        unknown = [kind]
        types: dict[str, Any] = {}
        while unknown:
            name = unknown.pop()
            if name in self.store.fielddefs or name in types:
                continue
            text = self._fetch(name)
            try:
                parsed = get_types_from_msg(text, name)
            except Exception as error:  # noqa: BLE001 - whatever the parser raises
                raise BadInputError(f"type {name}: its definition is not understood ({reason(error)})") from None
            types.update(parsed)
            for _, fields in parsed.values():
                unknown += [component for _, field in fields for component in _components(field)]
        if types:
            self.store.register(types)

    def definition(self, kind: str) -> Definition:
        """Definition of a known type in ROS 1, whose headers have a sequence number in addition."""
        text, _ = self.store.generate_msgdef(kind, ros_version=1)
        return Definition(kind.replace("/msg/", "/"), text.replace(_HEADER, f"{_HEADER}uint32 seq\n"))

    def to_ros1(self, kind: str, data: bytes) -> bytes:
        """A message of a known type in the serialization of ROS 1, in which `definition` locates numbers.

        Raises:
            MavfiError: It is not of this type.
        """
        try:
            return bytes(self.store.cdr_to_ros1(data, kind))
        except Exception as error:  # noqa: BLE001 - whatever generated code raises at damaged bytes
            raise MavfiError(f"a message of {len(data)} bytes is not a {kind} ({reason(error)})") from None


def _components(field: Any) -> list[str]:
    """Names of the message types in a field, as `rosbags` describes it."""
    node, detail = field
    if node == Nodetype.NAME:
        return [detail]
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _components(detail[0])
    return []


# ---- numbers in messages ---------------------------------------------------------------------------------------------
class Decoder:
    """Reads serialized messages of one type.

    Args:
        kind: Its full name, e.g. "sensor_msgs/msg/JointState".
        types: Where its definition is.

    Raises:
        BadInputError: The type is not known.
    """

    def __init__(self, kind: str, types: TypeLibrary) -> None:
        types.require(kind)
        self.kind = kind
        self._store = types.store

    def check(self, field: str, change: Change) -> None:
        """Check that a fault fits the type; a BadInputError says what is allowed."""
        if change.when.condition is not None:
            self.dtype(change.when.condition.field)
        if not field:
            return
        dtype = self.dtype(field)
        if change.operation.name != "freeze":
            check_number_operation(change.operation, dtype)

    def dtype(self, path: str) -> str:
        """NumPy's name of the type of the number at a path; a BadInputError if there is none."""
        description: Any = (Nodetype.NAME, self.kind)
        for name, indices in _steps(path):
            node, details = description
            if node != Nodetype.NAME:
                raise BadInputError(f"field {path}: {name!r} is in no message; allowed: the path of a number")
            members = dict(self._store.fielddefs[details][1])
            if not set(members) - {_OF_NO_FIELD}:
                raise BadInputError(f"field {path}: {details} {NO_FIELD}")
            if name not in members:
                raise BadInputError(f"field {path}: member of {details} {not_known(name, members)}")
            description = members[name]
            for index in indices:
                node, details = description
                if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                    description, length = details
                    if node == Nodetype.ARRAY and index >= length:
                        raise BadInputError(f"field {path}: {name} has {length} elements; allowed: 0 to {length - 1}")
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


def _example(description: Any) -> str:
    """What could follow a path that is no number."""
    node, _ = description
    if node == Nodetype.NAME:
        return ".x"
    return "[0]"
