"""Message types of a ROS 2 graph in mavfi's process: standard ones of `rosbags`, others from the machine."""

from collections.abc import Callable
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mavfi.errors import BadInputError, MavfiError
from mavfi.faults.levels.message.definition import Definition
from mavfi.plugins import reason

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
