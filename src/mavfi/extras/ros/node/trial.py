"""One trial on a foreign node: start it, send inputs, inject a register fault, and compare its outputs.

`run_trial` runs this module as a process in a private network; no process of a trial outlives it.
"""

import hashlib
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.registers import inject
from mavfi.extras.ros.node.bench import Bench, Drive
from mavfi.extras.ros.node.config import NodeConfig
from mavfi.extras.ros.ros1.folder import own_path
from mavfi.extras.ros.ros1.supervisor import adopt_orphans, end_all, end_with_parent, loopback_up, private_network
from mavfi.faults.fault import RegisterFault, fault_from_json
from mavfi.faults.levels.message.definition import Definition
from mavfi.flight.log_readers import LONGEST_LIST
from mavfi.outcomes import Effect
from mavfi.record import Injection

_LONGEST_S = 300.0
_PACE_S = 0.005
"""Pause between two rounds of inputs while the injection is prepared, as the tracer needs processor time (s)."""
_DYING_S = 0.5
"""Time limit from the end of a process's connections to its own (s)."""
_MOST_DIFFERENCES = 4


@dataclass
class Trial:
    """The result of a trial.

    Attributes:
        effect: Label of an `Effect`: "masked" = no output differs, "sdc" = some do, "crash" = the process ended,
            "hang" = an output is missing, "unknown" = inconclusive; `reason` explains the last three.
        outputs: Hash of the output to each input, before the injection.
        asked: Number of inputs since the injection.
        differing: Hashes of the outputs that differ.
        differences: Sample of differing numbers: path, before, after.
        injection: The injection, as plain data.
    """

    effect: str = Effect.MASKED.label
    reason: str = ""
    outputs: list[str] = field(default_factory=list)
    asked: int = 0
    differing: list[str] = field(default_factory=list)
    differences: list[dict[str, Any]] = field(default_factory=list)
    injection: dict[str, Any] | None = None


def run_trial(node: NodeConfig, golden: tuple[str, ...] = (), fault: RegisterFault | None = None) -> Trial:
    """Run a trial in a private network; `golden`: hash of the output to each input, empty = unknown.

    Raises:
        BadInputError: ROS is not installed, no private network, unknown program or type, ptrace refused.
        MavfiError: The node does not start, or the trial's process ended without a result.
    """
    order = {"node": node.to_json(), "golden": golden, "fault": None if fault is None else fault.to_json()}
    command = [*private_network(), sys.executable, "-m", "mavfi.extras.ros.node.trial"]
    done = subprocess.run(
        command, input=json.dumps(order).encode(), capture_output=True, timeout=_LONGEST_S, check=False,
        env={**os.environ, "PYTHONPATH": own_path()}, start_new_session=True,
    )  # fmt: skip
    try:
        answer = json.loads(done.stdout)
    except ValueError:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        last = lines[-1] if lines else f"exit code {done.returncode}"
        raise MavfiError(f"node {node.name}: the trial ended without a result ({last})") from None
    if "refused" in answer:
        raise BadInputError(answer["refused"])
    if "failed" in answer:
        raise MavfiError(answer["failed"])
    return Trial(**answer)


class _Session:
    """A trial, within its own process."""

    def __init__(self, node: NodeConfig, golden: tuple[str, ...], bench: Bench) -> None:
        self._node, self._known, self._trial = node, golden, Trial()
        self._process = bench.start(list(node.command))
        bench.wait_for_node(node.name, self._process)
        self._drive = Drive(bench, node)
        self._golden: list[bytes] = []

    def run(self, fault: RegisterFault | None) -> Trial:
        """Run the complete trial."""
        trial = self._trial
        if not self._learn() or fault is None:
            return trial
        done: list[Injection | Exception] = []
        injecting = threading.Thread(target=self._inject, args=(fault, done))
        injecting.start()
        while injecting.is_alive() and self._ask_all(injecting.is_alive):
            time.sleep(_PACE_S)
        injecting.join()
        if isinstance(done[0], Exception):
            if isinstance(done[0], BadInputError):
                raise done[0]
            return self._unknown(str(done[0]))
        trial.injection = done[0].to_json()
        for _ in range(self._node.cycles):
            if not self._ask_all():
                break
        return trial if done[0].activated else self._unknown("the register was not injected")

    def _unknown(self, reason: str) -> Trial:
        """Mark the trial as inconclusive, unless an effect has been observed."""
        if self._trial.effect == Effect.MASKED.label:
            self._trial.effect, self._trial.reason = Effect.UNKNOWN.label, reason
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
        if self._known and tuple(self._trial.outputs) != self._known:
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
            trial.asked += 1
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
            code: int | None = self._process.wait(_DYING_S)
        except subprocess.TimeoutExpired:
            code = None
        if code is None:
            self._trial.effect, self._trial.reason = Effect.HANG.label, f"no output within {self._node.patience_s:g} s"
        else:
            name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
            self._trial.effect, self._trial.reason = Effect.CRASH.label, name
        return False


def _hash(output: bytes) -> str:
    return hashlib.sha256(output).hexdigest()


def differences(definition: Definition, golden: bytes, output: bytes) -> list[dict[str, Any]]:
    """Sample of numeric differences between two messages; empty if they differ otherwise, e.g. in length."""
    found = []
    try:
        for path in definition.numbers(golden, LONGEST_LIST):
            before, after = (definition.locate(data, path).value(data) for data in (golden, output))
            if struct.pack("<d", before) != struct.pack("<d", after):
                found.append({"field": path, "before": repr(before), "after": repr(after)})
    except (MavfiError, struct.error, OverflowError):
        return found
    return found[:_MOST_DIFFERENCES]


def main() -> None:
    """Read the trial's specification from stdin, and write its result to stdout."""
    end_with_parent(signal.SIGTERM)
    adopt_orphans()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    loopback_up()
    order = json.load(sys.stdin)
    node = NodeConfig.model_validate(order["node"])
    fault = None if order["fault"] is None else fault_from_json(order["fault"])
    assert fault is None or isinstance(fault, RegisterFault)
    answer: dict[str, Any]
    try:
        with tempfile.TemporaryDirectory(prefix="mavfi-trial-") as folder, Bench(Path(folder)) as bench:
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
