"""What tests against real ROS share: a private network, a master, Debian's robot_state_publisher, and a driver."""

import ctypes
import os
import threading
import time

import pytest

from mavfi.errors import MavfiError
from mavfi.extras.ros.node.message import Composer
from mavfi.extras.ros.processes import loopback_up
from mavfi.extras.ros.processes import private_network as find_private_network
from mavfi.extras.ros.ros1 import finder
from tests.extras.ros.node.node_bench import MASTER_URI, POSITION, TARGET, URDF, NodeBench

CLONE_NEWNET = 0x40000000  # of <linux/sched.h>
PERIOD_S = 0.01


@pytest.fixture(scope="package")
def ros():
    """ROS is there, and a private network can be had."""
    if finder.missing():
        pytest.skip(f"ROS 1 is not installed ({finder.missing()[0]} is missing)")
    try:
        find_private_network()
    except MavfiError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="package")
def private_network(ros):
    """This process has a network of its own, until the last of these tests is over."""
    libc = ctypes.CDLL(None, use_errno=True)
    before = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    if libc.unshare(CLONE_NEWNET) != 0:
        os.close(before)
        pytest.skip(f"no private network for this process ({os.strerror(ctypes.get_errno())})")
    loopback_up()
    yield
    assert libc.setns(before, CLONE_NEWNET) == 0
    os.close(before)


@pytest.fixture(scope="module")
def bench(private_network, tmp_path_factory):
    """A master, as the environment says."""
    before = os.environ.get("ROS_MASTER_URI")
    os.environ["ROS_MASTER_URI"] = MASTER_URI
    with NodeBench(tmp_path_factory.mktemp("ros")) as made:
        yield made
    if before is None:
        del os.environ["ROS_MASTER_URI"]
    else:
        os.environ["ROS_MASTER_URI"] = before


class Arm:
    """Debian's robot_state_publisher, and joint states for it, 100 a second, with these time stamps (ns).

    It keeps one message: of several that come at once on a busy machine it loses all but the last.
    """

    node = "/robot_state_publisher"

    def __init__(self, bench, extra=()):
        bench.master.call("setParam", "/robot_description", URDF)
        self.process = bench.start([TARGET, "_publish_frequency:=10000.0", *extra])
        self.master = bench.master
        bench.wait_for_node(self.node, self.process)
        composer = Composer("sensor_msgs/JointState")
        self.outlet = bench.peer("/driver").advertise("/joint_states", composer.header)
        self.composer, self.stamps, self.over = composer, [], threading.Event()
        until(lambda: self.outlet.reader(self.node))
        self.thread = threading.Thread(target=self._drive, daemon=True)
        self.thread.start()
        until(lambda: "/tf" in self.master.graph().topics)

    def _drive(self):
        while not self.over.wait(PERIOD_S):
            now = time.time_ns()
            self.stamps.append(now)
            header = {"seq": len(self.stamps), "stamp": {"sec": now // 10**9, "nanosec": now % 10**9}}
            self.outlet.send(
                self.composer.pack({"header": header, "name": ["shoulder", "elbow"], "position": POSITION})
            )


@pytest.fixture(scope="module")
def arm(bench):
    made = Arm(bench)
    yield made
    made.over.set()
    made.thread.join()


def until(condition, seconds=30.0):
    """Wait for a condition, and answer what it gave."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "did not come true in time"
        time.sleep(0.01)
    return found
