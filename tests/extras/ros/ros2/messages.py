"""Messages of twelve types, with a number in each whose bit is flipped, and their words for comparison."""

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


class Messages:
    """Messages by name of their type, e.g. "Imu"; `basic`: text of test_msgs/msg/BasicTypes."""

    def __init__(self, basic):
        self.store = get_typestore(Stores.LATEST)
        self.store.register(get_types_from_msg(basic, "test_msgs/msg/BasicTypes"))
        self.kinds, self.fields, self.bits, self.data = {}, {}, {}, {}
        self._make()

    def _add(self, kind, field, bit, **members):
        name = kind.rpartition("/")[2]
        self.kinds[name], self.fields[name], self.bits[name] = kind, field, bit
        self.data[name] = self.packed(kind, **members)

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

    def _make(self):
        t = self.store.types
        stamp = t["builtin_interfaces/msg/Time"](sec=5, nanosec=7)
        header = t["std_msgs/msg/Header"](stamp=stamp, frame_id="map")
        point = t["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=3.0)
        vector = t["geometry_msgs/msg/Vector3"](x=0.1, y=0.2, z=9.8)
        turn = t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.6, w=0.8)
        pose = t["geometry_msgs/msg/Pose"](position=point, orientation=turn)
        stamped = t["geometry_msgs/msg/PoseStamped"](header=header, pose=pose)
        twist = t["geometry_msgs/msg/Twist"](linear=vector, angular=vector)
        nine, thirty_six = np.arange(9.0), np.arange(36.0)
        dimension = t["std_msgs/msg/MultiArrayDimension"](label="a", size=3, stride=4)
        layout = t["std_msgs/msg/MultiArrayLayout"](dim=[dimension], data_offset=1)
        self._add(
            "std_msgs/msg/Float64MultiArray", "layout.dim[0].stride", 30, layout=layout, data=np.array([1.0, 2.0])
        )
        self._add("std_msgs/msg/String", "data[2]", 1, data="hello")
        self._add(
            "sensor_msgs/msg/JointState",
            "name[1][30]",
            2,
            header=header,
            name=["a", "b" * 40],
            position=np.array([1.0, 2.0]),
            velocity=np.zeros(0),
            effort=np.array([3.0]),
        )
        self._add(
            "sensor_msgs/msg/LaserScan",
            "ranges[17]",
            30,
            header=header,
            angle_min=0.0,
            angle_max=1.0,
            angle_increment=0.5,
            time_increment=0.0,
            scan_time=0.25,
            range_min=0.0,
            range_max=9.0,
            ranges=np.arange(40, dtype=np.float32),
            intensities=np.zeros(0, np.float32),
        )
        column = t["sensor_msgs/msg/PointField"](name="x", offset=0, datatype=7, count=1)
        self._add(
            "sensor_msgs/msg/PointCloud2",
            "data[99999]",
            7,
            header=header,
            height=1,
            width=1000,
            fields=[column, column],
            is_bigendian=False,
            point_step=100,
            row_step=100_000,
            data=np.arange(100_000).astype(np.uint8),
            is_dense=True,
        )
        self._add(
            "sensor_msgs/msg/Imu",
            "angular_velocity_covariance[8]",
            62,
            header=header,
            orientation=turn,
            orientation_covariance=nine,
            angular_velocity=vector,
            angular_velocity_covariance=nine,
            linear_acceleration=vector,
            linear_acceleration_covariance=nine,
        )
        self._add(
            "nav_msgs/msg/Odometry",
            "pose.pose.orientation.w",
            63,
            header=header,
            child_frame_id="base",
            pose=t["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=thirty_six),
            twist=t["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=thirty_six),
        )
        self._add("nav_msgs/msg/Path", "poses[2].pose.position.x", 52, header=header, poses=[stamped] * 3)
        info = t["nav_msgs/msg/MapMetaData"](map_load_time=stamp, resolution=0.5, width=4, height=2, origin=pose)
        self._add(
            "nav_msgs/msg/OccupancyGrid", "data[5]", 6, header=header, info=info, data=np.arange(8, dtype=np.int8)
        )
        self._add("geometry_msgs/msg/Twist", "angular.z", 51, linear=vector, angular=vector)
        point = t["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=np.array([1.0, 2.0]),
            velocities=np.array([3.0]),
            accelerations=np.zeros(0),
            effort=np.zeros(0),
            time_from_start=t["builtin_interfaces/msg/Duration"](sec=1, nanosec=2),
        )
        self._add(
            "trajectory_msgs/msg/JointTrajectory",
            "points[1].positions[1]",
            61,
            header=header,
            joint_names=["a", "b"],
            points=[point] * 2,
        )
        self._add("test_msgs/msg/BasicTypes", "int64_value", 63, **BASIC)


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
