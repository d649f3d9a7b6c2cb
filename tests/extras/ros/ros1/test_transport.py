"""Connections of a rospy node to the topics of its flight."""

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
from mavfi.extras.ros.ros1.transport import Ros1Transport
transport = Ros1Transport("publisher")
transport.publisher("/talk", b"welcome")
transport.wait(lambda: False, 60.0)
"""
SUBSCRIBER = """
from mavfi.extras.ros.ros1 import finder
finder.enable()
from rospy.impl.registration import RegManager
from mavfi.extras.ros.ros1.transport import Ros1Transport

lost, kept = [], RegManager.publisher_update
def race(self, topic, uris):
    if topic == "/talk" and uris and not lost:
        lost.append(uris)  # queued before an older list of the same topic
    else:
        kept(self, topic, uris)
RegManager.publisher_update = race

received = []
transport = Ros1Transport("subscriber")
transport.subscribe("/talk", received.append)
while not transport.wait(lambda: bool(received), 0.2):
    transport.reconnect(["/talk"])
print(len(lost), received)
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


def test_a_lost_list_of_publishers_is_sent_again_and_the_subscriber_is_greeted(variables):
    publisher = subprocess.Popen([sys.executable, "-c", PUBLISHER], env=variables)
    try:
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", SUBSCRIBER],
            env=variables,
            capture_output=True,
            text=True,
            timeout=60,
        )
    finally:
        publisher.kill()
        publisher.wait(30)
    assert (done.stdout, done.returncode) == ("1 [b'welcome']\n", 0), done.stderr
