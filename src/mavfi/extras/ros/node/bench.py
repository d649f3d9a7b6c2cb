"""Test bench for a foreign node: starts a ROS master and the node, sends its inputs, and receives its outputs."""

import hashlib
import json
import os
import queue
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.registers import inject
from mavfi.extras.ros.node.config import NodeConfig
from mavfi.extras.ros.node.master import URI_VARIABLE, Master, absolute
from mavfi.extras.ros.node.message import Composer
from mavfi.extras.ros.node.peer import Peer, TopicSource
from mavfi.extras.ros.processes import (
    absolute_python_path,
    adopt_orphans,
    end_all,
    end_with_parent,
    loopback_up,
    private_network,
)
from mavfi.extras.ros.ros1 import finder
from mavfi.faults.fault import RegisterFault, fault_from_json
from mavfi.faults.levels.message.definition import Definition
from mavfi.flight.log_readers import LONGEST_LIST
from mavfi.outcomes import Effect
from mavfi.record import Injection

PORT = 11311
MASTER_URI = f"http://127.0.0.1:{PORT}"
DRIVER = "/mavfi_driver"
_POLL_S = 0.01
_SLICE_S = 0.05
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


class NodeDriver:
    """Sends inputs to a node one at a time, and waits for each output; `definition`: message definition of outputs."""

    def __init__(self, bench: NodeBench, node: NodeConfig) -> None:
        self._node = node
        self._patience = node.patience_s
        self._composer = Composer(node.inputs.type)
        self._outlet = bench.peer().advertise(absolute(node.inputs.topic), self._composer.header)
        self._sequence_number = 0
        self._answers: queue.Queue[bytes] = queue.Queue()
        self._is_over = threading.Event()
        self._source = self._connect(bench.master, absolute(node.name), absolute(node.outputs.topic))
        self.definition = self._source.definition()
        threading.Thread(target=self._listen, daemon=True).start()

    def _connect(self, master: Master, node: str, output: str) -> TopicSource:
        """Wait until the node subscribes to its input and publishes its output."""
        end = time.monotonic() + self._patience
        source = None
        while source is None or self._outlet.reader(node) is None:
            try:
                source = source or TopicSource(node, master.node_uri(node), output)
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
        self._sequence_number += 1
        if "std_msgs/Header header" not in self._composer.header["message_definition"].partition("=====")[0]:
            return fields
        now = time.time_ns()
        stamp = {"sec": now // 1_000_000_000, "nanosec": now % 1_000_000_000}
        return {**fields, "header": {**fields.get("header", {}), "seq": self._sequence_number, "stamp": stamp}}


# ---- a trial ---------------------------------------------------------------------------------------------------------

_TRIAL_PATIENCE_S = 300.0
_PACE_S = 0.005
"""Pause between two rounds of inputs while the injection is prepared, as the tracer needs processor time (s)."""
_DYING_S = 0.5
"""Time limit from the end of a process's connections to its own (s)."""
_MAX_DIFFERENCES = 4


@dataclass
class NodeTrial:
    """The result of a trial.

    Attributes:
        effect: Label of an `Effect`: "masked" = no output differs, "sdc" = some do, "crash" = the process ended,
            "hang" = an output is missing, "unknown" = inconclusive; `reason` explains the last three.
        outputs: Hash of the output to each input, before the injection.
        inputs_sent: Number of inputs since the injection.
        differing: Hashes of the outputs that differ.
        differences: Sample of differing numbers: path, before, after.
        injection: The injection, as plain data.
    """

    effect: str = Effect.MASKED.label
    reason: str = ""
    outputs: list[str] = field(default_factory=list)
    inputs_sent: int = 0
    differing: list[str] = field(default_factory=list)
    differences: list[dict[str, Any]] = field(default_factory=list)
    injection: dict[str, Any] | None = None


def run_trial(node: NodeConfig, golden: tuple[str, ...] = (), fault: RegisterFault | None = None) -> NodeTrial:
    """Run a trial in a private network; `golden`: hash of the output to each input, empty = unknown.

    Raises:
        BadInputError: ROS is not installed, no private network, unknown program or type, ptrace refused.
        MavfiError: The node does not start, or the trial's process ended without a result.
    """
    # a process of its own, in a private network, gets one order on its stdin
    fault_data = None
    if fault is not None:
        fault_data = fault.to_json()
    order = {"node": node.to_json(), "golden": golden, "fault": fault_data}
    command = [*private_network(), sys.executable, "-m", "mavfi.extras.ros.node.bench"]
    process = subprocess.run(
        command,
        input=json.dumps(order).encode(),
        capture_output=True,
        timeout=_TRIAL_PATIENCE_S,
        check=False,
        env={**os.environ, "PYTHONPATH": absolute_python_path()},
        start_new_session=True,
    )

    # its answer is the trial, or why there is none
    try:
        answer = json.loads(process.stdout)
    except ValueError:
        reason = f"exit code {process.returncode}"
        lines = process.stderr.decode(errors="replace").strip().splitlines()
        if lines:
            reason = lines[-1]
        raise MavfiError(f"node {node.name}: the trial ended without a result ({reason})") from None
    if "refused" in answer:
        raise BadInputError(answer["refused"])
    if "failed" in answer:
        raise MavfiError(answer["failed"])
    return NodeTrial(**answer)


class _Session:
    """A trial, within its own process."""

    def __init__(self, node: NodeConfig, golden: tuple[str, ...], bench: NodeBench) -> None:
        self._node = node
        self._earlier_hashes = golden
        self._trial = NodeTrial()
        self._process = bench.start(list(node.command))
        bench.wait_for_node(node.name, self._process)
        self._drive = NodeDriver(bench, node)
        self._golden: list[bytes] = []

    def run(self, fault: RegisterFault | None) -> NodeTrial:
        """Run the complete trial."""
        trial = self._trial
        if not self._learn() or fault is None:
            return trial

        # inject while the node computes: the tracer needs it to run, which it does only while it gets inputs
        done: list[Injection | Exception] = []
        injecting = threading.Thread(target=self._inject, args=(fault, done))
        injecting.start()
        while injecting.is_alive() and self._ask_all(injecting.is_alive):
            time.sleep(_PACE_S)
        injecting.join()
        injection = done[0]
        if isinstance(injection, BadInputError):
            raise injection
        if isinstance(injection, Exception):
            return self._unknown(str(injection))
        trial.injection = injection.to_json()

        # what the fault does to the outputs from now on
        for _ in range(self._node.cycles):
            if not self._ask_all():
                break
        if injection.activated:
            return trial
        return self._unknown("the register was not injected")

    def _unknown(self, reason: str) -> NodeTrial:
        """Mark the trial as inconclusive, unless an effect has been observed."""
        if self._trial.effect == Effect.MASKED.label:
            self._trial.effect = Effect.UNKNOWN.label
            self._trial.reason = reason
        return self._trial

    def _learn(self) -> bool:
        """Collect the golden outputs; False if they differ from those of earlier trials."""
        for number in range(len(self._node.inputs.messages)):
            output = self._drive.ask(number)
            if output is None:
                raise MavfiError(
                    f"node {self._node.name}: answers no message on {self._node.outputs.topic} to input {number} "
                    f"within {self._node.patience_s:g} s"
                )
            self._golden.append(output)
        self._trial.outputs = [_hash(output) for output in self._golden]
        if self._earlier_hashes and tuple(self._trial.outputs) != self._earlier_hashes:
            self._unknown("before the injection its output is not the golden one")
            return False
        return True

    def _inject(self, fault: RegisterFault, done: list[Injection | Exception]) -> None:
        try:
            done.append(inject(self._process.pid, fault)[0])
        except Exception as error:  # noqa: BLE001 - evaluated by the main thread
            done.append(error)

    def _ask_all(self, is_held: Callable[[], bool] = bool) -> bool:
        """Send every input once and compare outputs; False if the node has terminated or hangs."""
        trial = self._trial
        for number, golden in enumerate(self._golden):
            output = self._drive.ask(number, is_held)
            trial.inputs_sent += 1
            if output is None:
                return self._gone()
            if output != golden:
                trial.effect = Effect.SDC.label
                trial.differing.append(_hash(output))
                if not trial.differences:
                    trial.differences = differences(self._drive.definition, golden, output)
        return True

    def _gone(self) -> bool:
        """Classify a missing output: the process terminated, or it hangs."""
        try:
            code = self._process.wait(_DYING_S)
        except subprocess.TimeoutExpired:
            self._trial.effect = Effect.HANG.label
            self._trial.reason = f"no output within {self._node.patience_s:g} s"
            return False
        self._trial.effect = Effect.CRASH.label
        if code < 0:
            self._trial.reason = signal.Signals(-code).name
        else:
            self._trial.reason = f"exit code {code}"
        return False


def _hash(output: bytes) -> str:
    return hashlib.sha256(output).hexdigest()


def differences(definition: Definition, golden: bytes, output: bytes) -> list[dict[str, Any]]:
    """Sample of numeric differences between two messages; empty if they differ otherwise, e.g. in length."""
    differing = []
    try:
        for path in definition.numbers(golden, LONGEST_LIST):
            before = definition.locate(golden, path).value(golden)
            after = definition.locate(output, path).value(output)
            if struct.pack("<d", before) != struct.pack("<d", after):
                differing.append({"field": path, "before": repr(before), "after": repr(after)})
    except (MavfiError, struct.error, OverflowError):
        return differing
    return differing[:_MAX_DIFFERENCES]


def main() -> None:
    """Read the trial's specification from stdin, and write its result to stdout."""
    # whatever is started here ends with this process
    end_with_parent(signal.SIGTERM)
    adopt_orphans()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    loopback_up()

    # the order
    order = json.load(sys.stdin)
    node = NodeConfig.model_validate(order["node"])
    fault: RegisterFault | None = None
    if order["fault"] is not None:
        any_fault = fault_from_json(order["fault"])
        assert isinstance(any_fault, RegisterFault)
        fault = any_fault

    # the trial, and the answer
    answer: dict[str, Any]
    try:
        with tempfile.TemporaryDirectory(prefix="mavfi-trial-") as folder, NodeBench(Path(folder)) as bench:
            for name, value in node.parameters.items():
                bench.master.call("setParam", name, value)
            answer = asdict(_Session(node, tuple(order["golden"]), bench).run(fault))
    except BadInputError as error:
        answer = {"refused": str(error)}
    except MavfiError as error:
        answer = {"failed": str(error)}
    finally:
        end_all()
    sys.stdout.write(json.dumps(answer))
    sys.stdout.flush()
    os._exit(0)  # without waiting for listening threads


if __name__ == "__main__":
    main()
