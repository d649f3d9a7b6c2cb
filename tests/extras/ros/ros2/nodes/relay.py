"""Takes a message of each type and publishes it."""

import importlib

import rclpy
from rclpy.qos import QoSProfile

TYPES = {
    "std_msgs": ("Float64MultiArray", "String"),
    "sensor_msgs": ("JointState", "LaserScan", "PointCloud2", "Imu"),
    "nav_msgs": ("Odometry", "Path", "OccupancyGrid"),
    "geometry_msgs": ("Twist",),
    "trajectory_msgs": ("JointTrajectory",),
    "test_msgs": ("BasicTypes",),
}


def main():
    rclpy.init()
    node = rclpy.create_node("relay")
    qos = QoSProfile(depth=100)
    for package, names in TYPES.items():
        for name in names:
            kind = getattr(importlib.import_module(f"{package}.msg"), name)
            publisher = node.create_publisher(kind, f"/out/{name}", qos)
            node.create_subscription(kind, f"/in/{name}", publisher.publish, qos)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
