"""The process of a test bench, and its client.

    python -m mavfi.extras.ros.ros2.stack.bench_process

is a process in a private network that gets its orders as lines of JSON (`BenchClient` is its other end), so that the
page of the interposer and the tracer of registers are in the same user namespace as the stack.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mavfi.config import STORED
from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.registers.fault import RegisterFault
from mavfi.extras.ros.processes import end_with_parent, private_network
from mavfi.extras.ros.ros2.interposer.page import InterposedFault
from mavfi.extras.ros.ros2.stack.bench import StackBench, StackTrial
from mavfi.extras.ros.ros2.stack.clients import ANSWER_S
from mavfi.extras.ros.ros2.stack.config import StackConfig
from mavfi.faults.fault import Fault, fault_from_json
from mavfi.record import AlarmRecord, Injection


class BenchClient:
    """A bench in a process of its own, in a private network.

    Raises:
        BadInputError: No private network can be had, there is no such ROS 2 installation, or the stack cannot be run.
        MavfiError: The bench has ended.
    """

    def __init__(self, stack: StackConfig, detectors: Mapping[str, Sequence[str]] | None = None) -> None:
        command = [*private_network(), sys.executable, "-m", "mavfi.extras.ros.ros2.stack.bench_process"]
        python_path = os.pathsep.join(path for path in sys.path if path)
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": python_path},
            start_new_session=True,
        )
        self._end = weakref.finalize(self, _end_process, self._process)
        self.forks: list[bool] = self._ask({"stack": stack.to_json(), "detectors": detectors or {}})["forks"]

    def golden(self) -> dict[str, Any]:
        """Digest, status and numbers of the error-free run, as plain data."""
        return self._ask({"do": "golden"})

    def trial(self, fault: Fault | None) -> StackTrial:
        """Run a trial."""
        fault_data = None
        if fault is not None:
            fault_data = fault.to_json()
        trial = self._ask({"do": "trial", "fault": fault_data})
        trial["injections"] = tuple(Injection.from_json(data) for data in trial["injections"])
        trial["differences"] = tuple(trial["differences"])
        trial["alarms"] = {arm: alarms_from(alarms) for arm, alarms in trial["alarms"].items()}
        return StackTrial(**trial)

    def close(self) -> None:
        """End it."""
        self._end()

    def _ask(self, order: dict[str, Any]) -> dict[str, Any]:
        assert self._process.stdin is not None and self._process.stdout is not None  # pipes
        with suppress(BrokenPipeError):  # the missing answer tells
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
            self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            assert self._process.stderr is not None  # a pipe
            lines = self._process.stderr.read().decode(errors="replace").strip().splitlines() or ["no message"]
            raise MavfiError(f"bench of the stack: has ended ({lines[-1]})")
        answer: dict[str, Any] = json.loads(line)
        if "refused" in answer:
            raise BadInputError(answer["refused"])
        if "failed" in answer:
            raise MavfiError(answer["failed"])
        return answer


def alarms_from(data: Sequence[Mapping[str, Any]]) -> tuple[AlarmRecord, ...]:
    """Alarms from plain data."""
    return tuple(AlarmRecord.from_json(dict(alarm)) for alarm in data)


def _end_process(process: "subprocess.Popen[bytes]") -> None:
    """Let a bench end."""
    for stream in (process.stdin, process.stdout, process.stderr):
        if stream is not None:
            with suppress(OSError):
                stream.close()
    try:
        process.wait(ANSWER_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def main() -> None:
    """Meet the orders on stdin until it is closed; the first one has the stack."""
    # It ends with its parent, and what it starts ends with it.
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a verdict prints is no answer

    bench: StackBench | None = None
    with tempfile.TemporaryDirectory(prefix="mavfi-stack-") as folder:
        try:
            for line in sys.stdin:
                order = json.loads(line)
                try:
                    if bench is None:
                        stack = StackConfig.model_validate(order["stack"], context=STORED)
                        bench = StackBench(stack, Path(folder), order["detectors"])
                        answer: dict[str, Any] = {"forks": bench.forks}
                    else:
                        answer = _meet(bench, order)
                except BadInputError as error:
                    answer = {"refused": str(error)}
                except MavfiError as error:
                    answer = {"failed": str(error)}
                answers.write(json.dumps(answer).encode() + b"\n")
                answers.flush()
        finally:
            if bench is not None:
                bench.close()


def _meet(bench: StackBench, order: Mapping[str, Any]) -> dict[str, Any]:
    """The answer to an order."""
    if order["do"] == "golden":
        return bench.golden_summary()
    fault: InterposedFault | RegisterFault | None = None
    if order["fault"] is not None:
        fault = bench.injectable(fault_from_json(order["fault"]))
    trial = bench.trial(fault)
    alarms = {arm: [alarm.to_json() for alarm in alarms] for arm, alarms in trial.alarms.items()}
    injections = [injection.to_json() for injection in trial.injections]
    return {**asdict(trial), "injections": injections, "alarms": alarms}


if __name__ == "__main__":
    main()
