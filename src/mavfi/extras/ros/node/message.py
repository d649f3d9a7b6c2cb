"""Serializes messages of standard types from plain data, e.g. of a YAML file, with type definitions of `rosbags`."""

from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mavfi.errors import BadInputError, allowed, not_known

_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms"
_FLOATS = ("float32", "float64")
_DTYPES = {"byte": "int8", "char": "uint8", "octet": "uint8"}


@cache
def _store() -> Any:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(_TRANSFORMS, "tf2_msgs/msg/TFMessage"))
    return store


class Composer:
    """Serializes messages of one type, e.g. "sensor_msgs/JointState".

    Raises:
        BadInputError: It is not a standard type.
    """

    def __init__(self, kind: str) -> None:
        package, _, name = kind.rpartition("/")
        self._name = f"{package}/msg/{name}"
        if self._name not in _store().fielddefs:
            kinds = [full.replace("/msg/", "/") for full in _store().fielddefs]
            raise BadInputError(f"type {not_known(kind, kinds)}")
        text, md5sum = _store().generate_msgdef(self._name, ros_version=1)
        self.header = {"type": kind, "md5sum": md5sum, "message_definition": text}
        self._kind = kind

    def pack(self, fields: dict[str, Any]) -> bytes:
        """Serialize a message, given as plain data by field name; missing fields are zero or empty.

        Raises:
            BadInputError: The type lacks a given field, or a value does not fit its field.
        """
        return bytes(_store().serialize_ros1(self._make(self._name, fields, self._kind), self._name))

    def _make(self, name: str, fields: Any, path: str) -> Any:
        _, definition = _store().fielddefs[name]
        names = [field for field, _ in definition]
        if not isinstance(fields, dict):
            raise BadInputError(f"message {path}: {fields!r}: allowed: names and values of {allowed(names)}")
        for field in fields:
            if field not in names:
                raise BadInputError(f"message {path}: member {not_known(field, names)}")
        values = {field: self._value(kind, fields.get(field), f"{path}.{field}") for field, kind in definition}
        return _store().types[name](**values)

    def _value(self, kind: Any, value: Any, path: str) -> Any:
        """The value of a field in the form that rosbags serializes; None = zero or empty."""
        # rosbags describes a field as (kind of node, its details): a message, a scalar, or (element, length) of a list
        node, details = kind
        if node == Nodetype.NAME:
            return self._make(details, {} if value is None else value, path)
        if node == Nodetype.BASE:
            return _scalar(details[0], value, path)
        inner, length = details
        items = value
        if value is None:
            items = [None] * length
        if not isinstance(items, (list, tuple)) or (length and len(items) != length):
            count = ""
            if length:
                count = f" of {length}"
            raise BadInputError(f"message {path}: {value!r}: allowed: a list{count}")
        if inner[0] == Nodetype.NAME or inner[1][0] == "string":
            return [self._value(inner, item, path) for item in items]
        base = inner[1][0]
        return np.array([_scalar(base, item, path) for item in items], _DTYPES.get(base, base))


def _scalar(base: str, value: Any, path: str) -> Any:
    wanted: type = int
    if base == "string":
        wanted = str
    elif base in _FLOATS:
        wanted = float
    if value is None:
        return wanted()
    if isinstance(value, wanted) or (wanted is float and isinstance(value, int)):
        return wanted(value)
    raise BadInputError(f"message {path}: {value!r}: allowed: {base}")
