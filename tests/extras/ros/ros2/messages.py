"""Messages of twelve types, with a number in each whose bit is flipped, and their words for comparison."""

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STRUCK = {
    "std_msgs/msg/Float64MultiArray": ("layout.dim[0].stride", 30, 2),
    "std_msgs/msg/String": ("data[2]", 1, 0),
    "sensor_msgs/msg/JointState": ("name[1][30]", 2, 2),
    "sensor_msgs/msg/LaserScan": ("ranges[17]", 30, 40),
    "sensor_msgs/msg/PointCloud2": ("data[99999]", 7, 100_000),
    "sensor_msgs/msg/Imu": ("angular_velocity_covariance[8]", 62, 0),
    "nav_msgs/msg/Odometry": ("pose.pose.orientation.w", 63, 0),
    "nav_msgs/msg/Path": ("poses[2].pose.position.x", 52, 0),
    "nav_msgs/msg/OccupancyGrid": ("data[5]", 6, 8),
    "geometry_msgs/msg/Twist": ("angular.z", 51, 0),
    "trajectory_msgs/msg/JointTrajectory": ("points[1].positions[1]", 61, 2),
    "test_msgs/msg/BasicTypes": ("int64_value", 63, 0),
}
"""By type of message: a number in it, the bit that is flipped, and the length of its lists of numbers."""
MESSAGES_IN_A_LIST = 3


class Messages:
    """Messages by name of their type, e.g. "Imu"; `basic`: text of test_msgs/msg/BasicTypes."""

    def __init__(self, basic):
        self.store = get_typestore(Stores.LATEST)
        self.store.register(get_types_from_msg(basic, "test_msgs/msg/BasicTypes"))
        self.kinds, self.fields, self.bits, self.data = {}, {}, {}, {}
        for kind, (field, bit, length) in STRUCK.items():
            name = kind.rpartition("/")[2]
            self.kinds[name], self.fields[name], self.bits[name] = kind, field, bit
            members = self._members(kind, length)
            if name == "BasicTypes":
                members = BASIC
            self.data[name] = self.packed(kind, **members)

    def _members(self, kind, length):
        """Values of all members of a message."""
        return {name: self._value(node, length) for name, node in self.store.fielddefs[kind][1]}

    def _value(self, node, length):
        """A value of a member: numbers in a list count up, texts are long enough for any index above."""
        nodetype, detail = node
        if nodetype == Nodetype.NAME:
            return self.store.types[detail](**self._members(detail, length))
        if nodetype == Nodetype.BASE:
            name, _ = detail
            return {"string": "b" * 40, "bool": True}.get(name, 0.1 if name.startswith("float") else 1)
        element, size = detail
        if element[0] == Nodetype.BASE and element[1][0] != "string":
            return np.arange(size or length).astype(element[1][0])
        return [self._value(element, length) for _ in range(size or MESSAGES_IN_A_LIST)]

    def packed(self, kind, **members):
        """A serialized message."""
        return bytes(self.store.serialize_cdr(self.store.types[kind](**members), kind))

    def read(self, name, data):
        """The message with these bytes."""
        return self.store.deserialize_cdr(data, self.kinds[name])

    def differing_bits(self, name, data):
        """Number of bits in which the values of a message differ from those of the original."""
        pairs = zip(_words(self.read(name, self.data[name])), _words(self.read(name, data)), strict=True)
        return sum((int.from_bytes(a, "little") ^ int.from_bytes(b, "little")).bit_count() for a, b in pairs)


BASIC = {
    "bool_value": True,
    "byte_value": 1,
    "char_value": 2,
    "float32_value": 1.5,
    "float64_value": 2.5,
    "int8_value": -3,
    "uint8_value": 4,
    "int16_value": -5,
    "uint16_value": 6,
    "int32_value": -7,
    "uint32_value": 8,
    "int64_value": -9,
    "uint64_value": 10,
}
"""Values of a test_msgs/msg/BasicTypes."""


def _words(value):
    """The numbers and texts of a message, as bytes."""
    if hasattr(value, "__dataclass_fields__"):
        for name in value.__dataclass_fields__:
            yield from _words(getattr(value, name))
    elif isinstance(value, list):
        for element in value:
            yield from _words(element)
    elif isinstance(value, np.ndarray):
        yield value.tobytes()
    elif isinstance(value, str):
        yield value.encode()
    elif isinstance(value, float):
        yield np.float64(value).tobytes()
    else:
        yield (int(value) % 2**64).to_bytes(8, "little")
