"""What the world publishes beside the states of the loop: the clock, the IMU, and where the camera is."""

from typing import Any

from mavfi.hosts.loop.plant import Plant
from mavfi.hosts.ros1.convert import to_stamp
from mavfi.hosts.ros1.mirrors import camera_transform, imu_message, ros_type

CLOCK, IMU, STATIC = "/clock", "/imu/data", "/tf_static"


class Senses:
    """Publishes at each control period."""

    def __init__(self, plant: Plant, estimating: bool) -> None:
        """Advertise.

        Args:
            plant: What is measured.
            estimating: Whether the IMU is one of the loop's sensors: each sample of it is then drawn by the loop alone,
                and published as the mirror of `sensor.imu`.
        """
        self._plant = plant
        self._clock = _publisher(CLOCK, "rosgraph_msgs/Clock")
        self._imu = None if estimating else _publisher(IMU, "sensor_msgs/Imu")
        self._static = _publisher(STATIC, "tf2_msgs/TFMessage", latch=True)
        self._static.publish(camera_transform())
        self._kind = ros_type("rosgraph_msgs/Clock")

    def publish(self, time_us: int) -> None:
        """Publish for one instant; the IMU is sampled only while somebody listens."""
        clock = self._kind()
        to_stamp(clock.clock, time_us)
        self._clock.publish(clock)
        if self._imu is not None and self._imu.get_num_connections() > 0:
            self._imu.publish(imu_message(self._plant.imu(), time_us))


def _publisher(topic: str, kind: str, *, latch: bool = False) -> Any:
    import rospy

    return rospy.Publisher(topic, ros_type(kind), queue_size=10, tcp_nodelay=True, latch=latch)
