"""Publishes 100 times a second, for so many seconds: /takeoff without any number, and feedback of an action.

usage: signals.py SECONDS
"""

import sys

import rclpy
from std_msgs.msg import Empty
from test_msgs.action import Fibonacci

rclpy.init()
node = rclpy.create_node("signals")
takeoffs = node.create_publisher(Empty, "/takeoff", 10)
Feedback = Fibonacci.Impl.FeedbackMessage
steps = node.create_publisher(Feedback, "/count/_action/feedback", 10)


def publish():
    """Publish one of each."""
    takeoffs.publish(Empty())
    steps.publish(Feedback(feedback=Fibonacci.Feedback(sequence=[1, 2, 3])))


node.create_timer(0.01, publish)
clock = node.get_clock()
end = clock.now().nanoseconds + 1e9 * float(sys.argv[1])
while clock.now().nanoseconds < end:
    rclpy.spin_once(node, timeout_sec=0.1)
