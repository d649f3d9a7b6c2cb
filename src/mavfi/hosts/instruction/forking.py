"""Forked execution of instruction faults: injected runs branch off one golden flight at the injected calls.

The golden flight runs plain kernels.  At an injected call it waits while a forked child executes the call with the
fault and completes the flight.  If the child crashes, hangs or raises, a second child continues from the same instant
under the mission's policy for dead nodes (`hosts.loop.restarts`); by default as in a ROS graph: the node's result is
lost, and the node returns with initialized memory after the restart latency.  If protected code detects the fault, the
second child computes the step again, see `hosts.instruction.protected`.  The golden flight then continues to the
next injected call.

A false alarm of a detector before the fault causes recomputations, which shift the call numbers: the sampled call may
then end before the instruction's index, or have a narrower value there; so may one of a protected kernel, whose latency
is longer, if the fault was drawn in plain code.  With a detector or protection, the fault is therefore injected into
the first call at or after the sampled one that has such a bit, as a state fault is injected into the first publication
at or after its instant.
"""

import pickle
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NoReturn, TypeVar

from mavfi.detectors.custom import split_noting_calls
from mavfi.detectors.detector import Detector, part_of
from mavfi.errors import BadInputError, MavfiError
from mavfi.faults.fault import InstructionFault
from mavfi.faults.instruction import Ended, ForkPoint, MismatchError
from mavfi.faults.instruction.arena import arena, own
from mavfi.faults.instruction.plan import DATA, changed_nothing, check_fault
from mavfi.faults.instruction.variant import Variant, signature_of, variant_for
from mavfi.flight_log import FlightLog
from mavfi.hosts.host import Flight
from mavfi.hosts.instruction.case import DETECTED, WAITING, Case, ChildReport, Output, Published, case_of, flight_of
from mavfi.hosts.instruction.protected import alarm_of, is_detection, paired, repetition_of, rewriting_of
from mavfi.hosts.loop.assemble import new_loop, watch
from mavfi.hosts.loop.golden_prefix import GoldenPrefix, fly_until, prefix_of
from mavfi.hosts.loop.policy import INLINE, Recovery
from mavfi.hosts.loop.protection import check_flown
from mavfi.hosts.loop.restarts import Restarts
from mavfi.hosts.loop.scheduler import Loop
from mavfi.ir.build import name_of
from mavfi.ir.forked import WALL_CLOCK
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN
from mavfi.pipeline.kernel import Kernel
from mavfi.pipeline.memory import copied, same
from mavfi.sim.controller import is_rewindable
from mavfi.states import DETECTORS, State

TIMEOUT = 60.0
"""Wall-clock limit of an injected run (s): catches hangs that the instruction budget does not count."""
MAP_FUNCTIONS = frozenset({"insert_scan", "collect", "update_voxels", "apply_updates"})
"""Functions that write maps."""
Found = TypeVar("Found")
_ATTEMPTS = 3
"""Attempts under this limit: each finds the code that the previous child compiled in the cache."""


@dataclass(slots=True)
class Child:
    """The task of a forked process.

    `planned` states whether the injected call could write its own memory only.  `comparable` states whether, moreover,
    all differences from the golden flight are in results and memory of kernels, so that the flights are the same from
    an instant at which these are.  `in_time` states whether the result of a detected call is published without further
    latency.
    """

    point: ForkPoint
    case: Case
    dead: bool
    call_same: bool = False
    planned: bool = True
    comparable: bool = True
    output: Output | None = None
    in_time: bool = False


class ForkingFunction:
    """A kernel's or detector's function: plain except for injected calls.

    It counts its calls in the record of a flight.  Calls that repeat others for verification are not counted: faults
    address calls of first executions, as in flights without a detector.

    Attributes:
        forks: The injected runs that fork at its calls; None = none.
    """

    def __init__(self, name: str, function: Callable[..., Any], forks: "Forks | None" = None) -> None:
        self.forks = forks
        self._name, self._function = name, function
        self._loop: Loop | None = None

    def attach(self, loop: Loop) -> None:
        """Count calls in the record of a loop."""
        self._loop = loop
        loop.record.calls[self._name] = 0

    @contextmanager
    def replaced(self, function: Callable[..., Any]) -> Iterator[None]:
        """Call another function, which returns the same."""
        plain, self._function = self._function, function
        try:
            yield
        finally:
            self._function = plain

    def __call__(self, *args: Any) -> Any:
        """Call the function, with the fault if a child forked at this call."""
        loop, forks = self._loop, self.forks
        if loop is None or loop.repeating:
            return self._function(*args)
        call = loop.record.calls[self._name]
        loop.record.calls[self._name] = call + 1
        if forks is not None and forks.child is None:
            for case in forks.cases:
                if case.call == call and case.fault.entry == self._name:
                    injected, result = forks.inject(case, self._function, args)
                    if injected:
                        return result
        return self._function(*args)


class Forks(ABC):
    """Injected runs that fork off a golden flight, with or without a detector.

    Attributes:
        cases: The faults, in order.
        published: Publications so far, with their instants (us), in order; None = not recorded.
        child: Task of this process if it is a forked child; None = it flies the golden flight.
        loop: The loop of the golden flight.

    Raises:
        BadInputError: The scenario has no such kernel.
    """

    loop: Loop
    published: list[Published] | None = None

    def __init__(
        self, scenario: Scenario, faults: Sequence[InstructionFault], detector: Detector | None
    ) -> None:  # fmt: skip
        self.cases = [case_of(fault, scenario, detector) for fault in faults]
        self.child: Child | None = None
        self._awaited: dict[str, list[Case]] = {}
        self._detector, self._rewriting = detector, rewriting_of(scenario)
        self._shifts = detector is not None or self._rewriting is not None

    @abstractmethod
    def restarts(self) -> Restarts:
        """Restarts of the loop's nodes; called in a child whose node dies."""

    # ---- injection --------------------------------------------------------------------------------------------------
    def inject(self, case: Case, function: Any, args: tuple[Any, ...]) -> tuple[bool, Any]:
        """Fork at an injected call; returns (False, None) in the golden flight, (True, result) in a child."""
        variant = variant_for(function, args, self._rewriting)
        try:
            fault = self._fault_in(case.fault, variant, function, args)
        except (MismatchError, IndexError):
            if not self._shifts:
                raise
            case.call += 1  # call numbers have shifted: the arguments of this call have other types or values
            return False, None
        if self._shifts and not _has_bit(variant, fault, args):
            case.call += 1
            return False, None
        variant.own_report()
        case.time_us = self.loop.now
        ended = self._fork(case, dead=False)
        if ended is None:
            return True, self._injected_call(variant, fault, function, args)
        case.value = variant.report()
        _settle(case, ended)
        if case.how == WAITING:
            return False, None
        if case.how != "done":
            repetition = self._repetition(function, args)
            case.detail = repetition if case.how == DETECTED else case.detail
            ended = self._fork(case, dead=True)
            if ended is None:
                assert self.child is not None  # this is one
                self.child.in_time = repetition == "vote"
                self._end_detector(case)
                return True, function(*args)
            case.report = _report_of(ended)
        if case.kernel:
            self._awaited.setdefault(case.kernel, []).append(case)
        return False, None

    def _end_detector(self, case: Case) -> None:
        """End the detector of a child whose call was of it."""
        if not case.kernel and self._detector is not None:
            down_us = round(1e6 * case.fault.restart_s)
            self.restarts().detector_dies(self._detector, self.loop.now, down_us)

    def _repetition(self, function: Any, args: tuple[Any, ...]) -> str:
        """See `repetition_of`."""
        plan = self.loop.scenario.protection
        return "" if plan is None else repetition_of(plan, name_of(function), signature_of(args))

    def _fault_in(
        self, fault: InstructionFault, variant: Variant, function: Any, args: tuple[Any, ...]
    ) -> InstructionFault:
        """The fault in the code of a call: itself, or its counterpart in protected code."""
        if self._rewriting is not None and fault.ir_sha256 != variant.ir_sha256:
            plain = variant_for(function, args)
            if fault.ir_sha256 == plain.ir_sha256:
                return paired(fault, plain, variant, args)
        check_fault(fault, variant, function)
        return fault

    def _fork(self, case: Case, *, dead: bool) -> Ended | None:
        """None in the child; in the golden flight the child's termination, retried after a wall-clock timeout."""
        for _ in range(_ATTEMPTS):
            point = ForkPoint()
            ended = split_noting_calls(point, TIMEOUT)
            if ended is None:
                self.child, self.loop.forked = Child(point, case, dead), True
            if ended is None or ended.detail != WALL_CLOCK:
                break
        return ended

    def _injected_call(
        self, variant: Variant, fault: InstructionFault, function: Any, args: tuple[Any, ...]
    ) -> Any:  # fmt: skip
        """The call with the fault; a child whose data equals the golden data ends here, as its remainder is golden."""
        child = self.child
        assert child is not None  # called in children only
        placed = arena().place(args)  # preserves strides, which a copy may not: they select the compiled variant
        copies = tuple(copied(argument) for argument in args) if placed is None else placed.args
        golden, before = own((function(*copies), copies)), own(args)  # the injected call reuses the arena
        try:
            result = variant.inject(fault.index, *fault.masks, fault.budget, *args)
        except SystemError as error:
            if not is_detection(error):
                raise
            child.point.finish(pickle.dumps(ChildReport(None, None, call_same=False, detected=True)))
        child.call_same = same((result, args), golden)
        if not child.call_same and self._repetition(function, args):
            child.point.finish(pickle.dumps(ChildReport(None, None, call_same=False, detected=True)))
        report = variant.report()
        child.planned = report is not None and report.planned
        child.comparable = child.planned and _is_contained(fault.entry, before, golden[1], args)
        if self._shifts and changed_nothing(report):
            child.point.finish(pickle.dumps(ChildReport(None, None, call_same=True, missed=True)))
        if child.call_same and report is not None and (report.planned or report.site.value_class in DATA):
            child.point.finish(pickle.dumps(ChildReport(None, None, call_same=True)))
        return result

    def stepped(self, kernel: Kernel, states: list[State], now: int) -> None:
        """Store the output of an injected step; terminates the node of a step that crashed, repeats a detected one."""
        child = self.child
        if child is None:
            for case in self._awaited.pop(kernel.name, ()):
                case.golden = Output.of(kernel, states)
        elif child.case.kernel == kernel.name:
            if child.dead:
                child.dead = False
                if child.case.how == DETECTED:
                    self.loop.record.alarms.append(alarm_of(kernel, states, now))
                    if not child.in_time:
                        self.restarts().recompute(kernel.name, now, states)
                    return
                self.restarts().die(kernel.name, now, round(1e6 * child.case.fault.restart_s))
            elif child.output is None:
                child.output = Output.of(kernel, states)

    def run(self, fly: Callable[[], Found]) -> Found:
        """Call `fly`; in a child, an exception is its report."""
        try:
            return fly()
        except BaseException:
            if self.child is None:
                raise
            with self.child.point.guard():
                raise

    def report(self, log: FlightLog, watched: Mapping[str, FlightLog] | None = None) -> NoReturn:
        """End this child with the log of its flight, and those with detectors, by arm, as far as they are known."""
        assert self.child is not None  # called in children only
        child = self.child
        report = ChildReport(log, child.output, child.call_same, published=self.published, watched=watched or {})
        child.point.finish(pickle.dumps(report))


class ForksFromTakeOff(Forks):
    """Forks off a golden flight that is flown from take-off.

    Raises:
        BadInputError: The scenario cannot be flown, or it has no such kernel.
    """

    def __init__(
        self, scenario: Scenario, faults: Sequence[InstructionFault], detector: Detector | None = None,
        recovery: Recovery = INLINE, *, record: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(scenario, faults, detector)
        if not is_rewindable(scenario.flight_controller):
            text = "faults in instructions fork the flight, which this controller does not allow; allowed: cascade"
            raise BadInputError(f"flight_controller: {scenario.flight_controller}: {text}")
        self.published = [] if record else None
        made: list[ForkingFunction] = []

        def forking(name: str, function: Callable[..., Any]) -> ForkingFunction:
            made.append(ForkingFunction(name, function, self))
            return made[-1]

        sites = [case for case in self.cases if case.fault.has_site]
        names = tuple(dict.fromkeys(case.fault.entry for case in sites if case.fault.kernel not in DETECTORS))
        self.loop = new_loop(scenario, functions=PLAIN.instrumented(names, forking))
        for source in {case.fault.kernel for case in sites if case.fault.kernel in DETECTORS}:
            part = part_of(detector, source)
            entries = {case.fault.entry for case in sites if case.fault.kernel == source}
            part.instrument({name: forking(name, part.compiled[name]) for name in entries})
        for function in made:
            function.attach(self.loop)
        watch(self.loop, detector, recovery)
        if self.published is not None:
            self.loop.taps.recorders.append(self._note)
        self._restarts = Restarts(self.loop, scenario.dead_node)
        self.loop.after_step.append(self.stepped)

    def _note(self, state: State, now: int) -> None:
        assert self.published is not None  # a recorder only then
        self.published.append((state.copy(), now))

    def restarts(self) -> Restarts:
        """See `Forks.restarts`."""
        return self._restarts

    # ---- completion -------------------------------------------------------------------------------------------------
    def fly_all(self) -> tuple[Flight, list[Flight]]:
        """The golden flight, and the injected runs in order; does not return in children."""
        golden = self._fly(lambda: False)
        assert golden is not None  # `_fly` never stops early
        check_flown(self.loop.scenario.protection)
        return golden, [flight_of(case, golden) for case in self.cases]

    def fly_to_injections(self) -> tuple[GoldenPrefix, list[Case]]:
        """Fly until all cases are complete; does not return in children."""
        self._fly(self._all_known)
        return prefix_of(self.loop), self.cases

    def _all_known(self) -> bool:
        return self.child is None and not self._awaited and all(case.how != WAITING for case in self.cases)

    def _fly(self, enough: Callable[[], bool]) -> Flight | None:
        """Fly to the end, or until `enough`; a child reports and exits."""
        try:
            golden = self.run(lambda: fly_until(self.loop, enough))
        finally:
            for source in DETECTORS:
                part = part_of(self._detector, source)
                if part is not None:
                    part.instrument({})
        if self.child is not None:
            assert golden is not None  # `enough` is never true in a child
            self.report(golden.log)
        return golden


def _report_of(ended: Ended) -> ChildReport:
    if ended.how != "done":
        raise MavfiError(f"the flight with a restarted node ended with {ended.how} ({ended.detail})")
    report: ChildReport = pickle.loads(ended.payload)
    return report


def _settle(case: Case, ended: Ended) -> None:
    """Note how the child with the injected call ended; a case whose instruction it missed waits for the next call."""
    case.how, case.detail = ended.how, ended.detail
    if ended.how == "done":
        case.report = _report_of(ended)
        if case.report.missed:
            case.call, case.how, case.report = case.call + 1, WAITING, None
        elif case.report.detected:
            case.how = DETECTED


def _has_bit(variant: Variant, fault: InstructionFault, args: tuple[Any, ...]) -> bool:
    """Whether a call reaches the instruction's index with a value that has such a bit; without forking."""
    _, (site,) = variant.resolve([fault.index], *copied(args))
    keep, flip = fault.masks
    return site is not None and (flip | ~keep) % (1 << site.width) != 0


def _is_contained(entry: str, before: Any, golden: Any, injected: Any) -> bool:
    """Whether a call changed no argument that checkpoints do not compare, other than as without the fault.

    They compare the memory of kernels.  Inputs are not memory, so they must be as before; of maps they compare the
    cells, but not their stamps and counters.
    """
    if isinstance(golden, tuple):
        return all(_is_contained(entry, *parts) for parts in zip(before, golden, injected, strict=True))
    return same(golden, injected) or (entry not in MAP_FUNCTIONS and not same(before, golden))
