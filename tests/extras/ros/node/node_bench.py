"""Test bench for nodes of ROS 1: a master, and programs that end with it."""

import os
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.node.master import URI_VARIABLE, Master
from mavfi.extras.ros.node.peer import Peer
from mavfi.extras.ros.ros1 import finder

PORT = 11311
MASTER_URI = f"http://127.0.0.1:{PORT}"
DRIVER = "/mavfi_driver"
TARGET = "/usr/lib/robot_state_publisher/robot_state_publisher"
URDF = """<robot name="arm"><link name="base"/><link name="upper"/><link name="lower"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.5"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.3 0 0"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""
POSITION = [0.5, 0.25]
_POLL_S = 0.01
_LAST_WORDS_S = 2.0
_START_PATIENCE_S = 60.0
"""Time limit for the start of a program (s)."""


class NodeBench:
    """A ROS master in the (private) network of this process, and ROS programs; their logs go to `folder`."""

    def __init__(self, folder: Path) -> None:
        finder.require()
        self._folder = folder
        self._processes: list[subprocess.Popen[bytes]] = []
        self._peers: list[Peer] = []

    def __enter__(self) -> "NodeBench":
        try:
            self.start(["/usr/bin/rosmaster", "--core", "-p", str(PORT)])
            self.master = self._wait_for_master()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for peer in self._peers:
            peer.close()
        for process in reversed(self._processes):
            process.kill()
            process.wait(_LAST_WORDS_S)

    def _wait_for_master(self) -> Master:
        end = time.monotonic() + _START_PATIENCE_S
        while True:
            try:
                return Master(MASTER_URI)
            except BadInputError:
                if time.monotonic() > end:
                    raise MavfiError(f"rosmaster: is not there after {_START_PATIENCE_S:g} s") from None
                time.sleep(_POLL_S)

    def start(self, command: list[str], extra: Mapping[str, str] | None = None) -> "subprocess.Popen[bytes]":
        """Start a program that ends with the bench; `extra`: additional environment variables."""
        # Debian's ROS modules, the master of this bench, and logs in its folder
        variables = {
            **os.environ,
            **finder.environment(),
            URI_VARIABLE: MASTER_URI,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(self._folder),
            "ROS_LOG_DIR": str(self._folder),
            "OMP_NUM_THREADS": "1",
            **(extra or {}),
        }

        # a name below /usr is looked for in all folders with ROS packages
        name = command[0]
        program = name
        if name.startswith("/usr/"):
            program = str(finder.find_file(name.lstrip("/")))

        # start it, with a log of its own
        log = self._folder / f"{len(self._processes)}-{Path(name).name}.log"
        try:
            with log.open("wb") as output:
                process = subprocess.Popen(
                    [program, *command[1:]],
                    env=variables,
                    stdout=output,
                    stderr=output,
                    stdin=subprocess.DEVNULL,
                    cwd=self._folder,
                )
        except OSError as error:
            raise BadInputError(f"{name}: cannot be started ({error.strerror})") from None
        self._processes.append(process)
        return process

    def peer(self, name: str = DRIVER) -> Peer:
        """A participant of the graph that publishes the inputs."""
        self._peers.append(Peer(self.master, name))
        return self._peers[-1]

    def wait_for_node(self, name: str, process: "subprocess.Popen[bytes]") -> None:
        """Wait until a node is registered and responds; `MavfiError` if its process ends first, or on timeout."""
        end = time.monotonic() + _START_PATIENCE_S
        while time.monotonic() < end:
            if process.poll() is not None:
                raise MavfiError(f"node {name}: ended with exit code {process.returncode} before it was tried")
            try:
                self.master.node_pid(name)
                return
            except MavfiError:
                time.sleep(_POLL_S)
        raise MavfiError(f"node {name}: is not there after {_START_PATIENCE_S:g} s")
