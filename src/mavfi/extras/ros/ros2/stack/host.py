"""The host `ros2_stack`: a ROS 2 stack of the user's own.  A run is a trial: start it, play inputs, compare outputs.

A mission consists of error-free runs whose outputs must agree, followed by runs with a fault.  Where outputs come in
the stack's own time, or a register is hit at the machine's instant, a run is not bit-reproducible; `masked` means that
all outputs equal those of the error-free run.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mavfi.errors import BadInputError, SpecMismatchError
from mavfi.extras.ros.ros2.environment import find_installation
from mavfi.extras.ros.ros2.stack.bench import StackTrial
from mavfi.extras.ros.ros2.stack.bench_process import BenchClient, alarms_from
from mavfi.extras.ros.ros2.stack.config import StackConfig
from mavfi.extras.ros.ros2.stack.sampling import (
    MessageNumbers,
    StackMessageLevel,
    StackRegisterLevel,
    TopicMessages,
)
from mavfi.faults.fault import Fault
from mavfi.flight.host import ArmSetup, DetectorChoice, Host, Recorded, RunResult, one_by_one
from mavfi.mission import MissionSpec
from mavfi.outcomes import DUE, Effect
from mavfi.plugins import require_allowed
from mavfi.record import End, FlightRecord, KernelEffect

_DIED = tuple(effect.label for effect in DUE)
_MISSIONS = 2


@dataclass(frozen=True, slots=True)
class StackMission:
    """A stack with the digests of its scripts, in place of a `Scenario`."""

    stack: StackConfig

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {"stack": self.stack.to_json(), "files": files_of(self.stack)}

    def key(self) -> str:
        """Identifying hash."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()


def files_of(stack: StackConfig) -> dict[str, str]:
    """Digests of the files that a stack's commands, inputs and verdict name, by name."""
    names = [word for command in (*stack.commands, stack.inputs.script) for word in command]
    names.append(stack.inputs.bag)
    if isinstance(stack.verdict, str):
        names.append(stack.verdict.rpartition(":")[0])
    else:
        names += stack.verdict
    digests = {}
    for name in filter(None, names):
        path = Path(name)
        if path.suffix:  # scripts and recordings; programs belong to the installation
            with suppress(OSError):
                digests[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return digests


class Ros2StackHost(Host):
    """Trials of a ROS 2 stack."""

    name = "ros2_stack"
    levels = frozenset({"message", "register"})
    deterministic = False
    flies = False
    trains = True
    config = StackConfig
    config_key = "stack"
    samplings: Mapping[str, Any] = {"message": StackMessageLevel, "register": StackRegisterLevel}

    def __init__(self, stack: StackConfig | None = None) -> None:
        if stack is None:
            raise BadInputError("host ros2_stack: allowed: with the key stack, which says what is under test")
        self._stack = stack

    @classmethod
    def campaign_defaults(cls, under_test: StackConfig) -> dict[str, Any]:
        """See `Host.campaign_defaults`: missions that can be flown side by side, named after the first program."""
        command = under_test.commands[0]
        scripts = [word for word in command if word.endswith(".py")]
        name = Path((scripts or list(command))[0]).stem
        return {"environments": [name], "missions": _MISSIONS}

    def resolve(self, spec: MissionSpec) -> StackMission:
        """The stack, in place of a scenario."""
        return StackMission(self._stack)

    def check_stored(self, scenario: Mapping[str, Any]) -> None:
        """See `Host.check_stored`."""
        for name, digest in scenario["files"].items():
            if files_of(self._stack).get(name) != digest:
                raise SpecMismatchError(f"{name}: is absent, or another file than that of the campaign")

    def check(self) -> None:
        """See `Host.check`: includes the error-free runs."""
        self._check_allowed()
        find_installation(self._stack.distribution)
        bench = BenchClient(self._stack)
        try:
            bench.golden()
        finally:
            bench.close()

    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> "StackRuns":
        """The runs of a mission, without fast-forward."""
        self._check_allowed()
        detectors = {arm: setup.choice for arm, setup in arms.items() if setup.choice is not None}
        return StackRuns(self._stack, detectors)

    def _check_allowed(self) -> None:
        """Check that the programs, which a file names, may be run."""
        for command in self._stack.commands:
            require_allowed("key 'stack'", command[0])


class StackRuns:
    """The runs of one mission, all by one bench.

    The arms watch the same runs: a detector is an observer, and cannot change what the stack does.
    """

    def __init__(self, stack: StackConfig, detectors: Mapping[str, DetectorChoice]) -> None:
        self._stack = stack
        self._detectors = detectors
        self._bench: BenchClient | None = None
        self._last: tuple[Fault, StackTrial] | None = None

    def golden(self, arm: str, *, profile: bool = False) -> RunResult:
        """The error-free run, with the messages in it.

        Raises:
            BadInputError: Its outputs are not the same each time.
        """
        golden = self._running_bench().golden()
        alarms = alarms_from(golden["alarms"].get(arm, ()))
        record = FlightRecord(
            End.FLOWN,
            golden["status"],
            golden["digest"],
            alarms=alarms,
            alarms_total=len(alarms),
            extra={"outputs": golden["outputs"]},
        )
        messages = tuple(
            TopicMessages(topic, tuple(tuple(MessageNumbers(*numbers) for numbers in message) for message in messages))
            for topic, messages in golden["numbers"].items()
        )
        return RunResult(record, messages)

    def register_golden(self, arm: str, flight: Recorded) -> None:
        """See `MissionFlights.register_golden`; no operation, as no stack is run elsewhere."""

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """See `one_by_one`."""

        def run(arm: str, fault: Fault) -> RunResult:
            if self._last is None or self._last[0] != fault:
                self._last = fault, self._running_bench().trial(fault)
            return RunResult(record_of_trial(self._last[1], arm))

        return one_by_one(runs, run)

    def _running_bench(self) -> BenchClient:
        """The bench, which is started when it is needed first."""
        if self._bench is None:
            self._bench = BenchClient(self._stack, self._detectors)
        return self._bench


def record_of_trial(trial: StackTrial, arm: str) -> FlightRecord:
    """The record of a run in an arm; its digest is that of its outputs, so that error-free outputs count as masked."""
    alarms = trial.alarms.get(arm, ())
    record = FlightRecord(
        End.FLOWN,
        trial.status,
        trial.digest,
        injections=trial.injections,
        alarms=alarms,
        alarms_total=len(alarms),
        extra={
            "outputs": trial.messages,
            "differing": trial.differing,
            "differences": list(trial.differences),
            "reason": trial.reason,
        },
    )
    if trial.effect == Effect.UNKNOWN.label:
        return replace(record, end=End.UNKNOWN, status="", digest="", error=trial.reason)
    if trial.effect in _DIED:
        kernel = KernelEffect(trial.effect, trial.reason)
        return replace(record, end=End.DUE, digest="", kernel=kernel, error=trial.reason)
    return record
