"""Mirrors of the loop's states in standard ROS message types, for rviz, bags and third-party nodes.

Frames follow REP-103 and REP-105: `map` is the world (ENU, z up), `base_link` the vehicle (x forward, y left, z up),
`camera_optical` the camera (z forward, x right, y down).  A mirror without subscribers costs nothing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from mavfi.config import CameraConfig
from mavfi.faults.sensor.failures import Failures
from mavfi.faults.sensor.fault import SensorFault
from mavfi.hosts.loop.plant import Plant
from mavfi.hosts.ros1.convert import MAP, to_stamp
from mavfi.hosts.ros1.plan import Plan
from mavfi.kernels.planning.trajectory import POINT_WIDTH
from mavfi.numerics.elementary import cos, sin, tan
from mavfi.numerics.rotations import rotation_matrix
from mavfi.states import State, floats

VEHICLE, OPTICAL = "base_link", "camera_optical"
TO_OPTICAL = (0.5, -0.5, 0.5, -0.5)
"""Rotation of `camera_optical` in `base_link`, w x y z."""
_FLOAT32 = 7  # sensor_msgs/PointField.FLOAT32


def ros_type(name: str) -> Any:
    """Message class by ROS name, e.g. "sensor_msgs/Image"."""
    package, kind = name.split("/")
    return getattr(import_module(f"{package}.msg"), kind)


@dataclass(frozen=True, slots=True)
class Standard:
    """One mirror of a state: topic, ROS type, frame, and function that fills a message from state and camera."""

    state: str
    topic: str
    kind: str
    frame: str
    fill: Callable[[Any, State, CameraConfig], None]

    def message(self, state: State, time_us: int, camera: CameraConfig) -> Any:
        """The message of one value."""
        message = ros_type(self.kind)()
        stamped = message if hasattr(message, "header") else _first(message)
        to_stamp(stamped.header.stamp, time_us)
        stamped.header.frame_id = self.frame
        self.fill(message, state, camera)
        return message


def _first(transforms: Any) -> Any:
    """The transform of a TFMessage, which carries the header."""
    transform = ros_type("geometry_msgs/TransformStamped")()
    transform.child_frame_id = VEHICLE
    transforms.transforms = [transform]
    return transform


class Mirror:
    """Publishes one standard message per value while it has subscribers."""

    def __init__(self, standard: Standard, camera: CameraConfig) -> None:
        self._standard, self._camera = standard, camera
        self._publisher = _publisher(standard.topic, standard.kind)

    def publish(self, state: State, time_us: int) -> None:
        """Publish a value if there are subscribers."""
        if self._publisher.get_num_connections() > 0:
            self._publisher.publish(self._standard.message(state, time_us, self._camera))


def mirrors_of(state: str, plan: Plan) -> list[Mirror]:
    """Advertise and return the mirrors of one state."""
    return [Mirror(standard, plan.scenario.camera) for standard in STANDARDS if standard.state == state]


# ---- conversion of states to standard messages -------------------------------------------------------------------
def _xyz(target: Any, values: np.ndarray) -> None:
    target.x, target.y, target.z = (float(value) for value in values)


def _turn(target: Any, wxyz: np.ndarray | tuple[float, ...]) -> None:
    target.w, target.x, target.y, target.z = (float(value) for value in wxyz)


def _odometry(message: Any, state: State, camera: CameraConfig) -> None:
    values = floats(state.header, 13)
    to_map = np.empty((3, 3))
    rotation_matrix(values[6:10], to_map)
    message.child_frame_id = VEHICLE
    _xyz(message.pose.pose.position, values[:3])
    _turn(message.pose.pose.orientation, values[6:10])
    _xyz(message.twist.twist.linear, values[3:6] @ to_map)
    _xyz(message.twist.twist.angular, values[10:13])


def _transform(message: Any, state: State, camera: CameraConfig) -> None:
    values = floats(state.header, 13)
    transform = message.transforms[0].transform
    _xyz(transform.translation, values[:3])
    _turn(transform.rotation, values[6:10])


def _image(message: Any, state: State, camera: CameraConfig) -> None:
    """Depth along the optical axis, as in rectified depth images (the state holds distances along the rays)."""
    height, width = camera.height, camera.width
    depth = np.zeros(height * width, np.float32)
    ranges = state.elements["range"][: height * width]
    depth[: len(ranges)] = ranges * cosines(camera)[: len(ranges)]
    message.height, message.width, message.encoding, message.step = height, width, "32FC1", 4 * width
    message.data = depth.tobytes()


def cosines(camera: CameraConfig) -> np.ndarray:
    """Ratio of depth along the optical axis to distance along the ray, per pixel. Shape (height * width,)."""
    focal = focal_length(camera)
    across = (np.arange(camera.width) + 0.5 - 0.5 * camera.width) / focal
    down = (np.arange(camera.height) + 0.5 - 0.5 * camera.height) / focal
    ratios: np.ndarray = 1.0 / np.sqrt(1.0 + across[None, :] ** 2 + down[:, None] ** 2)
    return ratios.ravel()


def focal_length(camera: CameraConfig) -> float:
    """Focal length of the depth camera (pixels)."""
    return 0.5 * camera.width / tan(0.5 * camera.field_of_view)


def fill_camera_info(message: Any, camera: CameraConfig) -> None:
    """Fill in a `sensor_msgs/CameraInfo`, except its header: pinhole model without distortion."""
    focal, cx, cy = focal_length(camera), 0.5 * camera.width - 0.5, 0.5 * camera.height - 0.5
    message.height, message.width, message.distortion_model = camera.height, camera.width, "plumb_bob"
    message.D = [0.0] * 5
    message.K = [focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0]
    message.R = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    message.P = [focal, 0.0, cx, 0.0, 0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0]


def _point_cloud(message: Any, state: State, camera: CameraConfig) -> None:
    kind = ros_type("sensor_msgs/PointField")
    message.fields = [kind(axis, 4 * place, _FLOAT32, 1) for place, axis in enumerate("xyz")]
    message.height, message.width = 1, len(state.elements)
    message.point_step, message.row_step = 12, 12 * len(state.elements)
    message.data, message.is_dense = state.elements.tobytes(), False


def _path(message: Any, state: State, camera: CameraConfig) -> None:
    kind = ros_type("geometry_msgs/PoseStamped")
    for vertex in floats(state.elements, 3).reshape(-1, 3):
        pose = kind(header=message.header)
        _xyz(pose.pose.position, vertex)
        pose.pose.orientation.w = 1.0
        message.poses.append(pose)


def _trajectory(message: Any, state: State, camera: CameraConfig) -> None:
    message.joint_names = [VEHICLE]
    start = 0.0
    for point in floats(state.elements, POINT_WIDTH).reshape(-1, POINT_WIDTH):
        message.points.append(_point(point, start))
        start += float(point[10])


def _waypoint(message: Any, state: State, camera: CameraConfig) -> None:
    message.joint_names = [VEHICLE]
    message.points = [_point(floats(state.header, POINT_WIDTH), 0.0)]


def _point(values: np.ndarray, start: float) -> Any:
    """One point of a multi-DOF trajectory."""
    point = ros_type("trajectory_msgs/MultiDOFJointTrajectoryPoint")()
    transform, velocity, acceleration = (
        ros_type(f"geometry_msgs/{kind}")() for kind in ("Transform", "Twist", "Twist")
    )
    _xyz(transform.translation, values[:3])
    half = 0.5 * float(values[3])
    level = math.isfinite(half)
    _turn(transform.rotation, (cos(half), 0.0, 0.0, sin(half)) if level else (1.0, 0.0, 0.0, 0.0))
    _xyz(velocity.linear, values[4:7])
    _xyz(acceleration.linear, values[7:10])
    point.transforms, point.velocities, point.accelerations = [transform], [velocity], [acceleration]
    to_duration(point.time_from_start, start)
    return point


def to_duration(duration: Any, seconds: float) -> None:
    """Set a `genpy.Duration`; out-of-range values become 0."""
    if abs(seconds) < 2**31:
        duration.secs = math.floor(seconds)
        duration.nsecs = min(999_999_999, int(1e9 * (seconds - duration.secs)))


def _command(message: Any, state: State, camera: CameraConfig) -> None:
    values = floats(state.header, 4)
    _xyz(message.twist.linear, values[:3])
    message.twist.angular.z = float(values[3])


def _imu(message: Any, state: State, camera: CameraConfig) -> None:
    _fill_imu(message, floats(state.header, 6))


def _fill_imu(message: Any, values: np.ndarray) -> None:
    message.orientation_covariance[0] = -1.0
    _xyz(message.linear_acceleration, values[:3])
    _xyz(message.angular_velocity, values[3:])


STANDARDS = (
    Standard("sensor.depth", "/camera/depth/image_rect", "sensor_msgs/Image", OPTICAL, _image),
    Standard(
        "sensor.depth", "/camera/depth/camera_info", "sensor_msgs/CameraInfo", OPTICAL,
        lambda message, _, camera: fill_camera_info(message, camera),
    ),
    Standard("sensor.odometry", "/odometry", "nav_msgs/Odometry", MAP, _odometry),
    Standard("sensor.odometry", "/tf", "tf2_msgs/TFMessage", MAP, _transform),
    Standard("perception.odometry", "/odometry", "nav_msgs/Odometry", MAP, _odometry),
    Standard("perception.odometry", "/tf", "tf2_msgs/TFMessage", MAP, _transform),
    Standard("sensor.imu", "/imu/data", "sensor_msgs/Imu", VEHICLE, _imu),
    Standard("perception.point_cloud", "/points", "sensor_msgs/PointCloud2", MAP, _point_cloud),
    Standard("planning.path", "/path", "nav_msgs/Path", MAP, _path),
    Standard("planning.trajectory", "/trajectory", "trajectory_msgs/MultiDOFJointTrajectory", MAP, _trajectory),
    Standard("planning.waypoint", "/reference", "trajectory_msgs/MultiDOFJointTrajectory", MAP, _waypoint),
    Standard("control.command", "/command", "geometry_msgs/TwistStamped", MAP, _command),
)  # fmt: skip
"""All mirrors of states; the world also publishes `/clock`, `/tf_static` and, unless it is a state, `/imu/data`."""


def camera_transform() -> Any:
    """Pose of the camera on the vehicle, for `/tf_static`."""
    message = ros_type("tf2_msgs/TFMessage")()
    transform = ros_type("geometry_msgs/TransformStamped")()
    transform.header.frame_id, transform.child_frame_id = VEHICLE, OPTICAL
    _turn(transform.transform.rotation, TO_OPTICAL)
    message.transforms = [transform]
    return message


def imu_message(values: np.ndarray, time_us: int) -> Any:
    """A `sensor_msgs/Imu` without orientation: specific force (m/s^2), rates (rad/s), body frame. Shape (6,)."""
    message = ros_type("sensor_msgs/Imu")()
    to_stamp(message.header.stamp, time_us)
    message.header.frame_id = VEHICLE
    _fill_imu(message, values)
    return message


class Senses:
    """Publishes clock, IMU and camera transform: the transform once (latched), the others at each control period.

    With an estimator (`estimating`), the IMU is a sensor of the loop: only the loop samples it, and the mirror of
    `sensor.imu` publishes the samples.  Without one, it fails here as it does for the flight controller.
    """

    def __init__(self, plant: Plant, estimating: bool, fault: SensorFault | None = None) -> None:
        self._plant = plant
        self._failures = Failures()
        if fault is not None:
            self._failures.begin(fault)
        self._clock = _publisher("/clock", "rosgraph_msgs/Clock")
        self._imu = None if estimating else _publisher("/imu/data", "sensor_msgs/Imu")
        self._static = _publisher("/tf_static", "tf2_msgs/TFMessage", latch=True)
        self._static.publish(camera_transform())

    def publish(self, time_us: int) -> None:
        """Publish for one instant; the IMU is sampled only while it has subscribers."""
        clock = ros_type("rosgraph_msgs/Clock")()
        to_stamp(clock.clock, time_us)
        self._clock.publish(clock)
        if self._imu is not None and self._imu.get_num_connections() > 0:
            self._imu.publish(imu_message(self._failures.imu(time_us, self._plant.imu()), time_us))


def _publisher(topic: str, kind: str, *, latch: bool = False) -> Any:
    import rospy

    return rospy.Publisher(topic, ros_type(kind), queue_size=10, tcp_nodelay=True, latch=latch)
