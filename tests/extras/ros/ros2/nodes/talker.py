"""Publishes joint states at 50 Hz on /joint_states (reliable) and a count on /count (best effort); serves /add.

usage: talker.py [--name NAME] [--clock] [--wild N]
    --clock: publishes /clock too, from 1000 s on
    --wild:  every N-th joint state has a position[1] of a million
"""

import argparse
import math

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Int32
from std_srvs.srv import SetBool

options = argparse.ArgumentParser()
options.add_argument("--name", default="talker")
options.add_argument("--clock", action="store_true")
options.add_argument("--wild", type=int)
arguments = options.parse_args()
rclpy.init()
node = rclpy.create_node(arguments.name)
joints = node.create_publisher(JointState, "/joint_states", 10)
counts = node.create_publisher(Int32, "/count", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
node.create_service(SetBool, "/switch", lambda request, response: response)
clock = None
if arguments.clock:
    clock = node.create_publisher(Clock, "/clock", 10)
tick = 0


def publish():
    """Publish all that is due."""
    global tick
    tick += 1
    state = JointState(name=["shoulder", "elbow"], position=[math.sin(0.1 * tick), 0.25 + 0.01 * (tick % 2)])
    state.header.stamp.sec = tick
    if arguments.wild and tick % arguments.wild == 0:
        state.position[1] = 1e6
    joints.publish(state)
    counts.publish(Int32(data=tick))
    if clock is not None:
        message = Clock()
        message.clock.sec = 1000 + tick // 50
        message.clock.nanosec = tick % 50 * 20_000_000
        clock.publish(message)


node.create_timer(0.02, publish)
rclpy.spin(node)
