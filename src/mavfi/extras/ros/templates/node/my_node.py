"""A ROS 2 node: limits the velocity of each message on /cmd_in, and sends it on as /cmd_out."""

import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node

LARGEST_SPEED = 1.0
"""Of a component (m/s)."""


class MyNode(Node):
    """Answers each message with one."""

    def __init__(self):
        super().__init__("my_node")
        self.publisher = self.create_publisher(Twist, "/cmd_out", 10)
        self.create_subscription(Twist, "/cmd_in", self.limit, 10)

    def limit(self, message):
        """Send a message on, limited."""
        for axis in ("x", "y", "z"):
            speed = getattr(message.linear, axis)
            setattr(message.linear, axis, max(-LARGEST_SPEED, min(LARGEST_SPEED, speed)))
        self.publisher.publish(message)


def main():
    """Run until Ctrl-C."""
    rclpy.init()
    rclpy.spin(MyNode())


if __name__ == "__main__":
    main()
