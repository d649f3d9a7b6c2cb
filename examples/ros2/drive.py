"""A node to try faults on: publishes a velocity on /cmd_vel, 20 times a second."""

import rclpy
from geometry_msgs.msg import Twist


def main():
    """Publish until Ctrl-C."""
    rclpy.init()
    node = rclpy.create_node("driver")
    publisher = node.create_publisher(Twist, "/cmd_vel", 10)

    def publish():
        command = Twist()
        command.linear.x = 0.5
        publisher.publish(command)

    node.create_timer(0.05, publish)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
