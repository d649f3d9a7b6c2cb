"""Test bench for a stack: runs its trials, each in a network, mounts and processes of its own."""

import math
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import reduce
from operator import and_
from pathlib import Path
from typing import Any, NamedTuple, cast

from mavfi.errors import BadInputError
from mavfi.extras.registers import inject
from mavfi.extras.registers.fault import RegisterFault
from mavfi.extras.ros.processes import descendants, is_traced
from mavfi.extras.ros.ros2.environment import find_installation
from mavfi.extras.ros.ros2.interposer.page import ControlPage, InterposedFault, Report, Side
from mavfi.extras.ros.ros2.stack.clients import (
    DriverClient,
    LauncherClient,
    StackProcesses,
    StartError,
    with_python,
)
from mavfi.extras.ros.ros2.stack.config import StackConfig
from mavfi.extras.ros.ros2.stack.inputs import inputs_of
from mavfi.extras.ros.ros2.stack.outputs import LOST, Outputs, compare, digest_of, status_of
from mavfi.extras.ros.ros2.stack.watching import Publication, alarms_of, train
from mavfi.extras.shared.foreign import Monitor
from mavfi.faults.fault import Fault
from mavfi.levels.message.fault import MessageFault
from mavfi.outcomes import Effect
from mavfi.record import AlarmRecord, Injection

_FOLDER = Path(__file__).parent
_DOMAIN = "71"
"""ROS domain of a trial: its network is its own, so that every trial may have the same."""
_LONGEST_S = 600.0
"""Time limit for inputs with times of their own, or of a script (s)."""
_POLL_S = 0.002
_ATTEMPTS = 3
"""How often a run is tried whose outputs differ before the fault."""
_SETTLE_S = 0.1
"""Time in which nodes of one stack find each other, after the driver has found them (s)."""
_CYCLES_AFTER = 3
"""How often the inputs are played after a register was injected."""
_MOST_CYCLES = 200
_MOST_INPUTS = 2000
"""Limits of how often the inputs are played until one is, and of the number of inputs in all."""
_PROFILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
"""Environment variables of Fast DDS: the file with its settings, and its name before version 3."""


@dataclass(frozen=True, slots=True)
class StackTrial:
    """The result of a trial.

    Attributes:
        effect: Label of an `Effect`: "masked" = no output differs, "sdc" = some do, "crash" = a process has ended,
            "hang" = outputs have ceased, "unknown" = nothing was injected; `reason` explains the last three.
        reason: In words; "" = none.
        digest: Hash of the outputs; of those of the error-free run, if they do not differ from it.
        messages: Number of outputs.
        differing: Number of differing outputs.
        differences: The first values that differ, as plain data.
        injections: What was changed.
        status: Status of the mission by the user's verdict; "" without one.
        alarms: Alarms of the detector of each arm.
        seconds: Duration of the trial (s).
        start_s: Of this, until all topics were connected (s).
    """

    effect: str
    reason: str
    digest: str
    messages: int
    differing: int
    differences: tuple[dict[str, Any], ...]
    injections: tuple[Injection, ...]
    status: str
    alarms: dict[str, tuple[AlarmRecord, ...]]
    seconds: float
    start_s: float


class PlayedRun(NamedTuple):
    """A run of the stack: its outputs, the numbers in each message by topic, how it ended, and what was changed."""

    cycles: list[Outputs]  # outputs, each time that the inputs were played
    publications: list[Publication]  # the same in the order of their arrival
    numbers: dict[str, list[list[tuple[str, str, int]]]]
    lasting: Counter[str]  # programs that the stack's commands had started and that lived at the end
    ended: str  # how a process of the stack ended; "" = all lived
    has_ceased: bool
    reports: list[Report]
    register: Injection | Exception | None
    armed_s: float  # wall-clock time at which the fault was armed (s since 1970)
    seconds: float
    start_s: float

    @property
    def outputs(self) -> Outputs:
        """All outputs."""
        return joined(self.cycles)


class PlayedInputs(NamedTuple):
    """What the driver says of each time that the inputs were played, and the injection into a register."""

    cycles: list[dict[str, Any]]
    register: Injection | Exception | None = None


def joined(cycles: Sequence[Outputs]) -> Outputs:
    """Outputs of several cycles as one."""
    if len(cycles) == 1:
        return cycles[0]
    return {topic: [message for outputs in cycles for message in outputs[topic]] for topic in cycles[0]}


# ---- the bench -------------------------------------------------------------------------------------------------------
class StackBench:
    """Runs trials of a stack, in the namespaces of this process.

    Args:
        stack: The stack.
        folder: For logs of its processes.
        detectors: Name and profile of the detector of each arm that has one.
    """

    def __init__(self, stack: StackConfig, folder: Path, detectors: Mapping[str, Sequence[str]] | None = None) -> None:
        self._stack = stack
        self._detectors = dict(detectors or {})
        self._monitors: dict[str, Monitor] = {}
        self._folder = folder
        self._installation = find_installation(stack.distribution)
        self._page = ControlPage()
        self._inputs, self._content = inputs_of(stack)
        self._golden: PlayedRun | None = None
        self._lasting: Counter[str] = Counter()  # programs that live at the end of all error-free runs
        self._cycles: list[Outputs] = []  # error-free outputs for faults in registers
        self._learned: dict[str, dict[str, Any]] = {}  # type and quality of service of recorded topics
        discovery = {name: os.environ.get(name, str(_FOLDER / "discovery.xml")) for name in _PROFILES}
        plain = self._installation.environment(
            **discovery,
            ROS_DOMAIN_ID=_DOMAIN,
            ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
            ROS_LOCALHOST_ONLY="1",  # the same before Iron
            ROS_LOG_DIR=str(folder),
            OMP_NUM_THREADS="1",
            OPENBLAS_NUM_THREADS="1",
            PYTHONHASHSEED="0",
            PYTHONUNBUFFERED="1",
        )
        self._drivers = LauncherClient(self._installation.python, plain, "driver")
        variables = {**plain, **stack.variables, **self._page.environment()}
        self._processes = StackProcesses(stack, self._installation, variables)
        self._drivers.ask("ready")

    @property
    def forks(self) -> list[bool]:
        """Whether each command of the stack is forked."""
        return self._processes.forks

    def close(self) -> None:
        """End all processes."""
        self._page.disarm()
        self._processes.close()
        self._drivers.close()

    def injectable(self, fault: Fault) -> InterposedFault | RegisterFault:
        """A planned fault as `trial` takes it: inputs are changed where they are received, others when published."""
        if fault.level == RegisterFault.level:
            return cast(RegisterFault, fault)
        fault = cast(MessageFault, fault)  # the other level of the host
        side: Side = "publish"
        if fault.topic in (*self._stack.input_topics, *(entry["topic"] for entry in self._inputs)):
            side = "take"
        return InterposedFault(fault.topic, fault.field, fault.planned, side, fault.seed)

    def golden(self) -> PlayedRun:
        """The error-free run, after several equal ones.

        Raises:
            BadInputError: Their outputs differ, or are missing.
        """
        if self._golden is None:
            self._play(None)  # learns types and qualities of service
            runs = self._error_free_runs()
            for run in runs:
                is_silent = not all(run.outputs[output.topic] for output in self._stack.outputs)
                if run.ended or run.has_ceased or is_silent:
                    reason = run.ended or f"no output within {self._stack.patience_s:g} s"
                    raise BadInputError(f"stack: without a fault: {reason}; allowed: a stack that answers all inputs")
                self._check_readable(run.outputs)
                comparison = compare(runs[0].outputs, run.outputs, self._stack)
                if comparison.differing:
                    first = comparison.differences[0]
                    raise BadInputError(
                        f"stack: {comparison.differing} outputs differ between error-free runs, first {first.topic} "
                        f"message {first.message} {first.field}: {first.golden}, {first.value}; allowed: fields that "
                        "do not change by themselves (outputs.fields), or a tolerance"
                    )
            self._golden = runs[0]
            self._lasting = reduce(and_, (run.lasting for run in runs))
            publications = [run.publications for run in runs]
            for arm, (detector, profile) in self._detectors.items():
                self._monitors[arm] = train(detector, profile, publications)
        return self._golden

    def _error_free_runs(self) -> list[PlayedRun]:
        """The runs without a fault; one that lost messages since its nodes found each other too late is repeated."""
        runs = [self._play(None) for _ in range(self._stack.golden_runs)]
        for _ in range(_ATTEMPTS - 1):
            counts = [sum(map(len, run.outputs.values())) for run in runs]
            if min(counts) == max(counts):
                break
            runs[counts.index(min(counts))] = self._play(None)
        return runs

    def _check_readable(self, outputs: Outputs) -> None:
        """Raise a BadInputError if a message lacks a field that is compared."""
        for output in self._stack.outputs:
            for message in outputs[output.topic]:
                if set(message) == {"error"}:
                    raise BadInputError(f"stack.outputs: {output.topic}: {message['error']}")

    def golden_summary(self) -> dict[str, Any]:
        """What a campaign needs of the error-free run, as plain data."""
        golden = self.golden()
        return {
            "digest": digest_of(golden.outputs),
            "status": status_of(self._stack, golden.outputs),
            "outputs": sum(map(len, golden.outputs.values())),
            "numbers": golden.numbers,
            "alarms": {
                arm: [alarm.to_json() for alarm in alarms_of(monitor, golden.publications)]
                for arm, monitor in self._monitors.items()
            },
        }

    def trial(self, fault: InterposedFault | RegisterFault | None) -> StackTrial:
        """Run a trial; without a fault, as another error-free run."""
        golden = self.golden()
        expected = golden.cycles
        if fault is not None and not isinstance(fault, InterposedFault):
            expected = self._golden_cycles()
        for _ in range(_ATTEMPTS):
            run = self._play(fault)
            started_well = self._started_well(run, golden)
            if started_well:
                break
        comparison = compare(joined(expected[: len(run.cycles)]), run.outputs, self._stack)
        injections, problem = _injections(fault, run, has_times=not self._answers)
        digest = digest_of(golden.outputs)
        effect = Effect.MASKED
        reason = ""
        if comparison.differing:
            digest = digest_of(run.outputs)
            effect = Effect.SDC
        if run.ended:
            effect = Effect.CRASH
            reason = run.ended
        elif run.has_ceased:
            effect = Effect.HANG
            reason = f"no output within {self._stack.patience_s:g} s"
        if problem and effect is Effect.MASKED:
            effect = Effect.UNKNOWN
            reason = problem
        if not started_well:
            effect = Effect.UNKNOWN
            reason = f"outputs differed before the fault, in {_ATTEMPTS} attempts"
        return StackTrial(
            effect.label,
            reason,
            digest,
            sum(map(len, run.outputs.values())),
            comparison.differing,
            tuple(asdict(difference) for difference in comparison.differences),
            injections,
            self._status(run),
            {arm: alarms_of(monitor, run.publications) for arm, monitor in self._monitors.items()},
            run.seconds,
            run.start_s,
        )

    def _status(self, run: PlayedRun) -> str:
        """The status of a run with a fault: its outputs may be such that the user's verdict fails."""
        try:
            return status_of(self._stack, run.cycles[-1])
        except BadInputError:
            return LOST

    def _started_well(self, run: PlayedRun, golden: PlayedRun) -> bool:
        """Whether outputs were those of the error-free run until the fault came, or to the end if it did not.

        Nodes that find each other too late lose messages.  Of a register the instant is not known to the bench.
        """
        if isinstance(run.register, Injection) or run.ended:
            return True
        first_s = min((report.wall_s for report in run.reports if report.kind == "changed"), default=math.inf)
        before: dict[str, list[Any]] = {topic: [] for topic in golden.outputs}
        for publication in run.publications:
            if publication.wall_s < first_s:
                before[publication.topic].append(publication.data)
        expected = golden.outputs
        if first_s < math.inf:
            expected = {topic: messages[: len(before[topic])] for topic, messages in golden.outputs.items()}
        return compare(expected, before, self._stack).differing == 0

    def _play(self, fault: InterposedFault | RegisterFault | None, count: int = 1) -> PlayedRun:
        """Start the stack, play the inputs so many times, and end it."""
        began = time.monotonic()
        faults = []
        if isinstance(fault, InterposedFault):
            faults = [fault]
        self._page.arm(faults)
        armed_s = time.time()
        statuses: dict[int, int] = {}
        driver = DriverClient(self._drivers)
        try:
            # The driver's endpoints come first, so that those of the stack find them as soon as they are made.
            driver.wait()
            of_inputs = driver.ask("inputs", self._content, inputs=self._inputs)["numbers"]
            if self._learned:
                with_numbers = self._golden is None
                driver.ask("outputs", outputs=list(self._learned.values()), with_numbers=with_numbers)
            pids = self._processes.start(driver.pid, self._folder)
            script = self._connect(driver, pids)
            start_s = time.monotonic() - began
            played = self._play_inputs(driver, pids, script, fault, count)
            lasting = Counter(name for pid in pids for name in _command_lines(pid))
        finally:
            driver.close()
            statuses = self._processes.end()
            self._drivers.ask("end")

        # What it has published, and the numbers in all messages.
        cycles: list[Outputs] = []
        publications: list[Publication] = []
        counts = dict.fromkeys(self._learned, 0)
        for cycle in played.cycles:
            of_cycle: dict[str, list[Any]] = {topic: [] for topic in self._learned}
            for topic, data, wall_s in cycle["outputs"]:
                of_cycle[topic].append(data)
                counts[topic] += 1
                time_s = wall_s - armed_s
                if self._answers:
                    time_s = float(counts[topic])
                publications.append(Publication(topic, data, time_s, wall_s))
            cycles.append(of_cycle)
        numbers: dict[str, list[Any]] = {}
        for entry, of_message in zip(self._inputs, of_inputs, strict=True):
            numbers.setdefault(entry["topic"], []).append(of_message)
        numbers |= played.cycles[-1]["numbers"]
        ended = self._ended(statuses, pids)
        absent = self._lasting - lasting
        if not ended and absent:
            ended = f"{next(iter(absent))} has ended"
        has_ceased = not ended and self._has_ceased(played.cycles[-1], cycles[-1])
        return PlayedRun(
            cycles,
            publications,
            numbers,
            lasting,
            ended,
            has_ceased,
            self._page.reports(),
            played.register,
            armed_s,
            time.monotonic() - began,
            start_s,
        )

    def _connect(self, driver: DriverClient, pids: Sequence[int]) -> int:
        """Wait until the stack reads all inputs and publishes all topics, and start the script of the inputs.

        Returns:
            Process id of the script; 0 without one.

        Raises:
            StartError: The stack does not within its time limit.
        """
        stack = self._stack
        of_driver = {entry["topic"] for entry in self._inputs}
        of_stack = [topic for topic in stack.topics if topic not in {*of_driver, *stack.inputs.topics}]
        of_script = [topic for topic in stack.inputs.topics if stack.inputs.script]
        self._wait_for(driver, of_stack, pids)
        if self._stack.launch or len(pids) > 1:
            time.sleep(_SETTLE_S)
        script = self._start_script(driver.pid)
        if self._learned:
            return script

        # Types and qualities of service are known now: the next runs have these subscriptions from the beginning.
        self._wait_for(driver, of_script, pids)
        fields = {output.topic: list(output.fields) for output in stack.outputs}
        entries: list[dict[str, Any]] = [
            {"topic": topic, "kind": "", "reliable": None, "latched": False, "fields": fields.get(topic, [])}
            for topic in (*of_stack, *of_script)
        ]
        matched = driver.ask("outputs", outputs=entries, with_numbers=False)["outputs"]
        for entry, quality in zip(entries, matched, strict=True):
            self._learned[entry["topic"]] = {**entry, **quality}
        kinds = sorted({entry["kind"] for entry in (*self._inputs, *self._learned.values())})
        self._drivers.ask("load", kinds=kinds)
        self._processes.load(kinds)
        return script

    def _wait_for(self, driver: DriverClient, topics: Sequence[str], pids: Sequence[int]) -> None:
        """Wait until topics are published and all inputs are read; a process that ends is not waited for.

        Raises:
            StartError: They are not within the time limit.
        """
        limit_s = self._stack.start_s
        missing = driver.ask("await", waits_s=limit_s, topics=list(topics), pids=list(pids), limit_s=limit_s)["missing"]
        if missing:
            reason = self._ended(self._processes.end(), pids) or f"after {limit_s:g} s"
            raise StartError(f"stack: {', '.join(missing)} ({reason})")

    def _start_script(self, namespace: int) -> int:
        """Start the script of the inputs; returns its process id, 0 without one."""
        script = self._stack.inputs.script
        if not script:
            return 0
        command = with_python(script, self._installation)
        log = str(self._folder / "script.log")
        return int(self._drivers.ask("start", command=command, namespace=namespace, log=log)["pid"])

    def _play_inputs(
        self,
        driver: DriverClient,
        pids: Sequence[int],
        script: int,
        fault: InterposedFault | RegisterFault | None,
        count: int,
    ) -> PlayedInputs:
        """Play the inputs so many times; for a register, while it is injected."""
        if fault is not None and not isinstance(fault, InterposedFault):
            return self._play_while_injecting(driver, pids, script, fault)
        cycles = []
        for number in range(1, count + 1):
            golden = None
            if self._golden is not None:
                golden = [self._golden.outputs] * number
            cycles.append(self._play_cycle(driver, pids, script, golden, last=number == count))
        return PlayedInputs(cycles)

    def _play_cycle(
        self,
        driver: DriverClient,
        pids: Sequence[int],
        script: int,
        golden: Sequence[Outputs] | None,
        *,
        last: bool = True,
    ) -> dict[str, Any]:
        """Play all inputs; returns what the driver says.

        Args:
            driver: The driver.
            pids: Processes of the stack.
            script: Process of the script of the inputs; 0 = none.
            golden: Error-free outputs of all cycles up to this one; None = unknown.
            last: Whether outputs that nobody expects are waited for.
        """
        expected = None
        if golden is not None:
            expected = {topic: sum(len(outputs[topic]) for outputs in golden) for topic in self._learned}
        patience_s = self._stack.patience_s
        return driver.ask(
            "play",
            waits_s=_LONGEST_S + len(self._inputs) * patience_s,
            answers=[output.topic for output in self._stack.outputs if output.topic in self._learned],
            pids=list(pids),
            watched=script,
            patience_s=patience_s,
            expected=expected,
            settle=last,
        )

    @property
    def _answers(self) -> bool:
        """Whether each input waits for an output."""
        return bool(self._inputs) and all(entry["offset_s"] is None for entry in self._inputs)

    def _play_while_injecting(
        self, driver: DriverClient, pids: Sequence[int], script: int, fault: RegisterFault
    ) -> PlayedInputs:
        """Play the inputs again and again until a register is injected, and some times more.

        A tracer finds no instruction in a process that waits for messages.  Inputs at their own times are played once.
        """
        golden = self._golden_cycles()
        pid = pids[fault.seed % len(pids)]
        done: list[Injection | Exception] = []

        def run() -> None:
            try:
                done.append(inject(pid, fault)[0])
            except Exception as error:  # noqa: BLE001 - evaluated later
                done.append(error)

        # The inputs wait for the tracer, which takes longer to start than a stack to answer all of them.
        injecting = threading.Thread(target=run)
        injecting.start()
        while injecting.is_alive() and not is_traced(pid):
            time.sleep(_POLL_S)
        cycles: list[dict[str, Any]] = []
        left = _CYCLES_AFTER
        while left > 0 and len(cycles) < len(golden):
            if not injecting.is_alive():
                left -= 1
            is_last = left == 0 or len(cycles) + 1 == len(golden)
            cycle = self._play_cycle(driver, pids, script, golden[: len(cycles) + 1], last=is_last)
            cycles.append(cycle)
            if cycle["is_silent"] or cycle["is_gone"]:
                break
        injecting.join()
        return PlayedInputs(cycles, done[0])

    def _golden_cycles(self) -> list[Outputs]:
        """Error-free outputs of the inputs, played again and again; by cycle."""
        if not self._cycles:
            count = 1
            if self._answers:
                count = max(2, min(_MOST_CYCLES, _MOST_INPUTS // len(self._inputs)))
            run = self._play(None, count)
            if run.ended or run.has_ceased:
                raise BadInputError(f"stack: without a fault, inputs played {count} times: {run.ended or 'no output'}")
            self._cycles = run.cycles
        return self._cycles

    def _has_ceased(self, played: Mapping[str, Any], outputs: Outputs) -> bool:
        """Whether outputs have ceased, rather than that some were lost."""
        if self._answers:
            return bool(played["is_silent"])
        if self._golden is None:
            return False
        # Without answers to wait for, one missing message is taken as lost.
        topics = [output.topic for output in self._stack.outputs]
        missing = [len(self._golden.outputs[topic]) - len(outputs[topic]) for topic in topics]
        is_empty = not any(outputs[topic] for topic in topics)
        return all(count >= 2 for count in missing) or (is_empty and any(missing))

    def _ended(self, statuses: Mapping[int, int], pids: Sequence[int]) -> str:
        """How the first process of the stack that has ended by itself ended; "" = none has."""
        for index, pid in enumerate(pids):
            if pid not in statuses:
                continue
            code = os.waitstatus_to_exitcode(statuses[pid])
            if code < 0:
                return signal.Signals(-code).name
            return f"exit code {code}{self._last_line(index)}"
        return ""

    def _last_line(self, index: int) -> str:
        """The last line that a process wrote, in brackets."""
        with suppress(OSError):
            lines = (self._folder / f"{index}.log").read_text(errors="replace").strip().splitlines()
            if lines:
                return f" ({lines[-1][:200]})"
        return ""


def _command_lines(pid: int) -> Iterator[str]:
    """Command lines of the processes that a process has started, and of theirs."""
    for child in descendants(pid)[1:]:
        with suppress(OSError):
            words = Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
            if any(words):  # a process that has ended has none
                yield " ".join(word.decode(errors="replace") for word in words).strip()


def _injections(
    fault: InterposedFault | RegisterFault | None, run: PlayedRun, *, has_times: bool
) -> tuple[tuple[Injection, ...], str]:
    """What was changed, and why nothing was ("" = something was, or nothing was to be)."""
    if fault is None:
        return (), ""
    if not isinstance(fault, InterposedFault):
        if isinstance(run.register, BadInputError):
            raise run.register
        if not isinstance(run.register, Injection):
            return (), str(run.register)
        if run.register.activated:
            return (run.register,), ""
        return (run.register,), "the register was not injected"
    changed = tuple(
        Injection(
            "message",
            f"{fault.topic}.{fault.field}".rstrip("."),
            _time_of(report, run, has_times=has_times),
            report.bit,
            report.before,
            report.after,
            activated=True,
            details={"message": report.message, "operation": str(fault.change.operation), "type": report.dtype},
        )
        for report in run.reports
        if report.kind == "changed"
    )
    refused = [report.text for report in run.reports if report.kind == "refused"]
    problem = ""
    if not changed:
        problem = next(iter(refused), "the message was not reached")
    return changed, problem


def _time_of(report: Report, run: PlayedRun, *, has_times: bool) -> float:
    """Time from the start of a run to a change (s); the number of the message, if inputs wait for outputs."""
    if not has_times:
        return float(report.message)
    return max(0.0, report.wall_s - run.armed_s)
