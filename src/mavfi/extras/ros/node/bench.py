"""Test bench for a foreign node: starts a ROS master and the node, sends its inputs, and receives its outputs."""

import os
import queue
import subprocess
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.node.config import NodeConfig
from mavfi.extras.ros.node.master import URI_VARIABLE, Master, absolute
from mavfi.extras.ros.node.message import Composer
from mavfi.extras.ros.node.peer import Peer
from mavfi.extras.ros.node.tcpros import Source
from mavfi.extras.ros.ros1 import finder

PORT = 11311
MASTER_URI = f"http://127.0.0.1:{PORT}"
DRIVER = "/mavfi_driver"
_POLL_S = 0.01
_SLICE_S = 0.05
_LAST_WORDS_S = 2.0
_START_PATIENCE_S = 60.0
"""Time limit for the start of a program (s)."""


class Bench:
    """A ROS master in the (private) network of this process, and ROS programs; their logs go to `folder`."""

    def __init__(self, folder: Path) -> None:
        finder.require()
        self._folder = folder
        self._processes: list[subprocess.Popen[bytes]] = []
        self._peers: list[Peer] = []

    def __enter__(self) -> "Bench":
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
        variables = {
            **os.environ, **finder.environment(), URI_VARIABLE: MASTER_URI, "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(self._folder), "ROS_LOG_DIR": str(self._folder), "OMP_NUM_THREADS": "1",
            **(extra or {}),
        }  # fmt: skip
        name = command[0]
        program = str(finder.find_file(name.lstrip("/"))) if name.startswith("/usr/") else name
        log = self._folder / f"{len(self._processes)}-{Path(name).name}.log"
        try:
            with log.open("wb") as output:
                process = subprocess.Popen(
                    [program, *command[1:]], env=variables, stdout=output, stderr=output,
                    stdin=subprocess.DEVNULL, cwd=self._folder,
                )  # fmt: skip
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


class Drive:
    """Sends inputs to a node one at a time, and waits for each output; `definition`: message definition of outputs."""

    def __init__(self, bench: Bench, node: NodeConfig) -> None:
        self._node, self._patience = node, node.patience_s
        self._composer = Composer(node.inputs.type)
        self._outlet = bench.peer().advertise(absolute(node.inputs.topic), self._composer.header)
        self._sent = 0
        self._answers: queue.Queue[bytes] = queue.Queue()
        self._is_over = threading.Event()
        self._source = self._connect(bench.master, absolute(node.name), absolute(node.outputs.topic))
        self.definition = self._source.definition()
        threading.Thread(target=self._listen, daemon=True).start()

    def _connect(self, master: Master, node: str, output: str) -> Source:
        """Wait until the node subscribes to its input and publishes its output."""
        end = time.monotonic() + self._patience
        source = None
        while source is None or self._outlet.reader(node) is None:
            try:
                source = source or Source(node, master.node_uri(node), output)
            except MavfiError as error:
                if time.monotonic() > end:
                    raise MavfiError(f"node {node}: {error}") from None
            if time.monotonic() > end:
                raise MavfiError(f"node {node}: does not read {self._outlet.topic} within {self._patience:g} s")
            time.sleep(_POLL_S)
        return source

    def _listen(self) -> None:
        for message in self._source.messages():
            self._answers.put(message)
        self._is_over.set()

    def ask(self, number: int, is_held: Callable[[], bool] = bool) -> bytes | None:
        """Send one input; returns the output without its ignored members, None = timeout.

        Time during which the tracer holds the node, as reported by `is_held`, does not count.
        """
        while not self._answers.empty():
            self._answers.get_nowait()
        self._outlet.send(self._composer.pack(self._stamped(self._node.inputs.messages[number])))
        end = time.monotonic() + self._patience
        while time.monotonic() < end and not self._is_over.is_set():
            if is_held():
                end = time.monotonic() + self._patience
            with suppress(queue.Empty):
                return self.definition.without(self._answers.get(timeout=_SLICE_S), self._node.outputs.ignore)
        return None

    def _stamped(self, fields: dict[str, Any]) -> dict[str, Any]:
        """The message, stamped with the current time if it has a header."""
        self._sent += 1
        if "std_msgs/Header header" not in self._composer.header["message_definition"].partition("=====")[0]:
            return fields
        now = time.time_ns()
        stamp = {"sec": now // 1_000_000_000, "nanosec": now % 1_000_000_000}
        return {**fields, "header": {**fields.get("header", {}), "seq": self._sent, "stamp": stamp}}
