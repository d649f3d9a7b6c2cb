"""One trial on a foreign node: start it, drive it, strike a register, and say what became of its output.

`run_trial` starts a process in a private network, which runs this module; nothing of a trial outlives it.
"""

import ctypes
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
from mavfi.faults.message.definition import Definition
from mavfi.faults.register import RegisterInjection, Request, inject
from mavfi.hosts.node.bench import Bench, Drive
from mavfi.hosts.node.private import private_network
from mavfi.hosts.ros1.folder import own_path
from mavfi.hosts.ros1.supervisor import end_all, loopback_up

MASKED, SDC, CRASH, HANG, UNKNOWN = "masked", "sdc", "crash", "hang", "unknown"
OUTCOMES = (MASKED, SDC, CRASH, HANG, UNKNOWN)
"""What a strike did: no output differs; some do; the process ended; it gave no output; it could not be judged."""
_PARENT_DIED, _SUBREAPER = 1, 36  # PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER of <linux/prctl.h>
_LONGEST_S = 300.0
_PACE_S = 0.005
"""Between two rounds of inputs while the strike is prepared: the tracer wants the processor, too (s)."""
_DYING_S = 0.5
"""How long a process takes from the end of its connections to its own (s)."""
_MOST_DIFFERENCES = 4
_LONGEST_LIST = 16


@dataclass(frozen=True)
class Order:
    """A trial.

    Attributes:
        node: Name of the node.
        command: Starts it.
        parameters: Of the parameter server.
        input_topic: Where inputs are published.
        input_type: Their type.
        messages: Inputs, as plain data.
        output: Topic of outputs.
        ignored: Members of the output that do not count.
        patience_s: After so long without output the node hangs (s).
        cycles: How often all inputs are sent after the strike.
        golden: Hash of the output to each input; empty = not known yet.
        strike: Request to the register injector, without the process; None = nothing strikes.
    """

    node: str
    command: tuple[str, ...]
    parameters: dict[str, Any]
    input_topic: str
    input_type: str
    messages: tuple[dict[str, Any], ...]
    output: str
    ignored: tuple[str, ...]
    patience_s: float
    cycles: int
    golden: tuple[str, ...] = ()
    strike: dict[str, Any] | None = None


@dataclass
class Result:
    """What became of it.

    Attributes:
        outcome: One of OUTCOMES.
        reason: Why it could not be judged, or how the process ended.
        outputs: Hash of the output to each input, before the strike.
        asked: Inputs from the strike on.
        differing: How many of their outputs differ.
        differences: Some numbers that differ: path, before, after.
        injection: What the register injector did.
    """

    outcome: str = MASKED
    reason: str = ""
    outputs: list[str] = field(default_factory=list)
    asked: int = 0
    differing: int = 0
    differences: list[dict[str, Any]] = field(default_factory=list)
    injection: dict[str, Any] | None = None


def run_trial(order: Order) -> Result:
    """Run a trial in a private network.

    Args:
        order: The trial.

    Raises:
        BadInputError: ROS is not installed, no private network, a program or type is not known, ptrace is refused.
        MavfiError: The node does not come up, or the trial's process ended without a result.
    """
    command = [*private_network(), sys.executable, "-m", "mavfi.hosts.node.trial"]
    done = subprocess.run(
        command, input=json.dumps(asdict(order)).encode(), capture_output=True, timeout=_LONGEST_S, check=False,
        env={**os.environ, "PYTHONPATH": own_path()}, start_new_session=True,
    )  # fmt: skip
    try:
        answer = json.loads(done.stdout)
    except ValueError:
        told = done.stderr.decode(errors="replace").strip().splitlines()
        last = told[-1] if told else f"exit code {done.returncode}"
        raise MavfiError(f"node {order.node}: the trial ended without a result ({last})") from None
    if "refused" in answer:
        raise BadInputError(answer["refused"])
    if "failed" in answer:
        raise MavfiError(answer["failed"])
    return Result(**answer)


class _Trial:
    """A trial from the inside."""

    def __init__(self, order: Order, bench: Bench) -> None:
        self._order, self._result = order, Result()
        self._process = bench.start(list(order.command))
        bench.wait_for_node(order.node, self._process)
        inputs = (order.input_topic, order.input_type, order.messages)
        self._drive = Drive(bench, order.node, inputs, order.output, order.ignored, order.patience_s)
        self._golden: list[bytes] = []

    def run(self) -> Result:
        """All of it."""
        result = self._result
        if not self._learn() or self._order.strike is None:
            return result
        injections: list[RegisterInjection | Exception] = []
        striker = threading.Thread(target=self._strike, args=(injections,))
        striker.start()
        while striker.is_alive() and self._ask_all(striker.is_alive):
            time.sleep(_PACE_S)
        striker.join()
        if isinstance(injections[0], Exception):
            if result.outcome == MASKED:
                result.outcome, result.reason = UNKNOWN, str(injections[0])
            if isinstance(injections[0], BadInputError):
                raise injections[0]
            return result
        result.injection = injections[0].to_json()
        for _ in range(self._order.cycles):
            if not self._ask_all():
                break
        if not injections[0].hit and result.outcome == MASKED:
            result.outcome, result.reason = UNKNOWN, "the register was not struck"
        return result

    def _learn(self) -> bool:
        """The outputs of the node as it should be; False if they are not what they were in other runs."""
        for number in range(len(self._order.messages)):
            output = self._drive.ask(number)
            if output is None:
                raise MavfiError(
                    f"node {self._order.node}: answers no message on {self._order.output} to input {number} within "
                    f"{self._order.patience_s:g} s"
                )
            self._golden.append(output)
        self._result.outputs = [hashlib.sha256(output).hexdigest() for output in self._golden]
        if self._order.golden and tuple(self._result.outputs) != tuple(self._order.golden):
            self._result.outcome, self._result.reason = UNKNOWN, "before the strike its output is not the golden one"
            return False
        return True

    def _strike(self, done: list[RegisterInjection | Exception]) -> None:
        assert self._order.strike is not None
        try:
            done.append(inject(Request(self._process.pid, **self._order.strike))[0])
        except Exception as error:  # noqa: BLE001 - the other thread judges it
            done.append(error)

    def _ask_all(self, is_held: Callable[[], bool] = bool) -> bool:
        """Send every input once, and compare; False when the node is no more."""
        result = self._result
        for number, golden in enumerate(self._golden):
            output = self._drive.ask(number, is_held)
            result.asked += 1
            if output is None:
                return self._gone()
            if output != golden:
                result.outcome = SDC
                result.differing += 1
                if not result.differences:
                    result.differences = differences(self._drive.definition, golden, output)
        return True

    def _gone(self) -> bool:
        """No output came: the process ended, or it hangs."""
        try:
            code: int | None = self._process.wait(_DYING_S)
        except subprocess.TimeoutExpired:
            code = None
        if code is None:
            self._result.outcome, self._result.reason = HANG, f"no output within {self._order.patience_s:g} s"
        else:
            name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
            self._result.outcome, self._result.reason = CRASH, name
        return False


def differences(definition: Definition, golden: bytes, output: bytes) -> list[dict[str, Any]]:
    """Some numbers in which two messages of a type differ; empty if they differ otherwise, e.g. in length."""
    found = []
    try:
        for path in definition.numbers(golden, _LONGEST_LIST):
            before, after = (definition.locate(data, path).value(data) for data in (golden, output))
            if struct.pack("<d", before) != struct.pack("<d", after):
                found.append({"field": path, "before": repr(before), "after": repr(after)})
    except (MavfiError, struct.error, OverflowError):
        return found
    return found[:_MOST_DIFFERENCES]


def main() -> None:
    """Read an order from stdin, write the result to stdout."""
    libc = ctypes.CDLL(None)
    libc.prctl(_PARENT_DIED, signal.SIGTERM)
    libc.prctl(_SUBREAPER, 1)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    loopback_up()
    data = json.load(sys.stdin)
    order = Order(**data)
    answer: dict[str, Any]
    try:
        with tempfile.TemporaryDirectory(prefix="mavfi-trial-") as folder, Bench(Path(folder)) as bench:
            for name, value in order.parameters.items():
                bench.master.call("setParam", name, value)
            answer = asdict(_Trial(order, bench).run())
    except BadInputError as error:
        answer = {"refused": str(error)}
    except MavfiError as error:
        answer = {"failed": str(error)}
    finally:
        end_all()
    sys.stdout.write(json.dumps(answer))
    sys.stdout.flush()
    os._exit(0)  # threads that listen need not be waited for


if __name__ == "__main__":
    main()
