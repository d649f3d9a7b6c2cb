"""A ROS 2 node: limits the positions of two joints and their change per message."""

import math

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState

LARGEST_POSITION = 2.0
LARGEST_STEP = 0.5


class Limiter(Node):
    """Answers each message on /in with one on /out."""

    def __init__(self):
        super().__init__("limiter")
        self.positions = [0.0, 0.0]
        self.publisher = self.create_publisher(JointState, "/out", 10)
        self.create_subscription(JointState, "/in", self.limit, 10)

    def limit(self, message):
        """Move towards the positions of a message, as far as is allowed."""
        for joint, position in enumerate(message.position):
            if math.isnan(position):
                raise ValueError("a position is NaN")
            target = max(-LARGEST_POSITION, min(LARGEST_POSITION, position))
            step = max(-LARGEST_STEP, min(LARGEST_STEP, target - self.positions[joint]))
            # a mistake that faults find: the search for the joint's gear never ends for tiny positions
            gear = abs(target)
            while 0.0 < gear < 1e-30:
                gear *= 1.0
            self.positions[joint] += step
        self.publisher.publish(JointState(name=message.name, position=self.positions))


def main():
    rclpy.init()
    rclpy.spin(Limiter())


if __name__ == "__main__":
    main()
