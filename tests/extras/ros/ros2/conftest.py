"""What tests against real ROS 2 share: a private network, the installed distributions, and nodes in them.

A test that takes `ros2` is skipped where the distribution is not installed:

    def test_it(ros2):
        talker = ros2.start("talker.py", "--clock")      # of tests/extras/ros/ros2/nodes; ended with the module
        with AgentClient(ros2.installation) as agent: ...
        run(["ros", "list"])                             # finds the same installation

`private_network` moves the thread that runs the tests, and all processes that it starts, to a network with loopback
only and to an empty /dev/shm of their own.
"""

import ctypes
import fcntl
import os
import socket
import struct
import subprocess
import time
from pathlib import Path

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.ros.ros2.environment import ROOT_VARIABLE, find_installation
from tests.extras.ros.distributions import EACH

NODES = Path(__file__).with_name("nodes")
_CLONE_FS = 0x00000200  # of <linux/sched.h>
_CLONE_NEWNS = 0x00020000
_CLONE_NEWNET = 0x40000000
_MS_REC_PRIVATE = 0x4000 | 0x40000  # of <linux/mount.h>
_SET_FLAGS = 0x8914  # of <linux/sockios.h>
_UP_AND_MULTICAST = 0x1 | 0x1000  # of <linux/if.h>


@pytest.fixture(scope="package")
def private_network():
    """This thread has a network and a /dev/shm of its own, until the last of these tests is over."""
    libc = ctypes.CDLL(None, use_errno=True)
    before = {kind: os.open(f"/proc/thread-self/ns/{kind}", os.O_RDONLY) for kind in ("net", "mnt")}
    folder = Path.cwd()
    if libc.unshare(_CLONE_NEWNET | _CLONE_NEWNS) != 0:
        reason = os.strerror(ctypes.get_errno())
        for descriptor in before.values():
            os.close(descriptor)
        pytest.skip(f"no private network for this process ({reason})")
    assert libc.mount(b"none", b"/", None, _MS_REC_PRIVATE, None) == 0
    assert libc.mount(b"tmpfs", b"/dev/shm", b"tmpfs", 0, None) == 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, _SET_FLAGS, struct.pack("16sh14x", b"lo", _UP_AND_MULTICAST))
    yield
    assert libc.unshare(_CLONE_FS) == 0  # threads that still run share the folder and the root of this one
    for kind, flag in (("net", _CLONE_NEWNET), ("mnt", _CLONE_NEWNS)):
        assert libc.setns(before[kind], flag) == 0
        os.close(before[kind])
    os.chdir(folder)  # joining a file system moves to its root


class Ros2:
    """An installation, and its nodes that run."""

    def __init__(self, installation):
        self.installation = installation
        self._processes = []

    def start(self, script, *arguments, **variables):
        """Start a node: a script of `NODES` or a path, with additional environment variables."""
        command = [self.installation.python, str(NODES / script), *arguments]
        process = subprocess.Popen(command, env=self.installation.environment(**variables))
        self._processes.append(process)
        return process

    def close(self):
        """Kill all nodes."""
        for process in self._processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module", params=EACH)
def ros2(request, private_network, tmp_path_factory):
    """Each distribution, as the only one that mavfi finds."""
    with pytest.MonkeyPatch.context() as patch:
        for variable in ("AMENT_PREFIX_PATH", "ROS_DISTRO", "ROS_DOMAIN_ID"):
            patch.delenv(variable, raising=False)
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        try:
            installation = find_installation(request.param)
        except BadInputError as error:
            pytest.skip(str(error))
        if not str(installation.prefix).startswith("/opt/ros"):
            root = tmp_path_factory.mktemp("installation")
            (root / request.param).symlink_to(installation.prefix)
            patch.setenv(ROOT_VARIABLE, str(root))
            installation = find_installation(request.param)
        started = Ros2(installation)
        yield started
        started.close()


def until(condition, seconds=20.0):
    """Wait for a condition, and return its value."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end, "did not come true in time"
        time.sleep(0.01)
    return value


def has_ended(pid):
    """Whether a process has ended, even if nobody has waited for it yet."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True
