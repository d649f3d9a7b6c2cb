"""Connections of a node to the topics of its flight."""

import socket
import subprocess
import sys
import time

import pytest

from mavfi.extras.ros.ros1 import finder
from tests.extras.ros.ros1.needs import environment, ros

pytestmark = ros
PUBLISHER = """
from mavfi.extras.ros.ros1 import finder
finder.enable()
import rospy
from std_msgs.msg import String
rospy.init_node("publisher")
talking = rospy.Publisher("/talk", String, queue_size=1)
rospy.spin()
"""
SUBSCRIBER = """
import sys
from types import SimpleNamespace
from mavfi.extras.ros.ros1 import finder
finder.enable()
import rospy
from rospy.impl.registration import RegManager
from std_msgs.msg import String
from mavfi.extras.ros.ros1.ports import Ports

lost, kept = [], RegManager.publisher_update
def race(self, topic, uris):
    if topic == "/talk" and uris and not lost:
        lost.append(uris)  # queued before an older list of the same topic
    else:
        kept(self, topic, uris)
RegManager.publisher_update = race

rospy.init_node("subscriber")
ports = Ports("subscriber", SimpleNamespace(patience_s=float(sys.argv[1]), graph=SimpleNamespace(routes={})))
ports._subscribers.append(rospy.Subscriber("/talk", String))  # without a flight's message types
ports.wait_until_connected()
print(len(lost), ports._subscribers[0].get_num_connections())
"""


@pytest.fixture
def variables():
    """Variables of a shell with a ROS master of its own."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = str(taken.getsockname()[1])
    shell = {**environment(), "ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
    master = subprocess.Popen(
        [finder.find_file("usr/bin/rosmaster"), "--core", "-p", port], env=shell, stdout=subprocess.DEVNULL
    )
    end = time.monotonic() + 30
    while time.monotonic() < end:
        with socket.socket() as trial:
            if trial.connect_ex(("127.0.0.1", int(port))) == 0:
                break
        time.sleep(0.05)
    yield shell
    master.kill()
    master.wait(30)


def test_a_lost_list_of_publishers_is_sent_again(variables):
    publisher = subprocess.Popen([sys.executable, "-c", PUBLISHER], env=variables)
    try:
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", SUBSCRIBER, "30"],
            env=variables,
            capture_output=True,
            text=True,
            timeout=60,
        )
    finally:
        publisher.kill()
        publisher.wait(30)
    assert (done.stdout, done.returncode) == ("1 1\n", 0), done.stderr
