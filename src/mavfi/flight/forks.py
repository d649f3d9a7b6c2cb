"""Forked execution of instruction faults: injected runs branch off one golden flight at the injected calls.

The golden flight runs plain kernels.  At an injected call it waits while a forked child executes the call with the
fault and completes the flight.  If the child crashes, hangs or raises, a second child continues from the same instant
under the mission's policy for dead nodes (`flight.restarts`); by default as in a ROS graph: the node's result is
lost, and the node returns with initialized memory after the restart latency.  If protected code detects the fault, the
second child computes the step again, see `extras.hardening.protected`.  The golden flight then continues to the next
injected call.

How the golden flight comes to the injected calls is the `GoldenApproach`: from take-off, or from the last golden
checkpoint before each call, where children also end as soon as they converge to a known flight
(`flight.fast_forward`).  The records are the same.

A false alarm of a detector before the fault causes recomputations, which shift the call numbers: the sampled call may
then end before the instruction's index, or have a narrower value there; so may one of a protected kernel, whose latency
is longer, if the fault was drawn in plain code.  With a detector or protection, the fault is therefore injected into
the first call at or after the sampled one that has such a bit, as a state fault is injected into the first publication
at or after its instant.
"""

import math
import pickle
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, NoReturn, cast

import numpy as np

from mavfi.detectors.detector import Detector, split_noting_calls
from mavfi.errors import BadInputError, MavfiError
from mavfi.faults.fault import CallFault
from mavfi.flight.checkpoints import fill, put
from mavfi.flight.compose import new_loop, watch
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.fast_forward import (
    NO_DETECTOR,
    CallResult,
    CountedFunction,
    FastForward,
    FlightBranch,
    FlownArm,
    KnownFlight,
    check_prefix,
    fly_until,
)
from mavfi.flight.host import Flight
from mavfi.flight.loop import Listener, Loop
from mavfi.flight.restarts import Restarts
from mavfi.flight.targets import Targets
from mavfi.ir.forked import WALL_CLOCK, ChildEnd, ForkPoint
from mavfi.ir.injection.arena import arena, copy_result
from mavfi.ir.injection.table import DATA
from mavfi.ir.injection.variant import InjectionReport, MismatchError, Variant, changed_nothing, variant_for
from mavfi.mission import Scenario
from mavfi.pipeline.kernel import Kernel
from mavfi.pipeline.memory import Remembers, copied, same
from mavfi.record import FlightLog, KernelEffect
from mavfi.rewriting import check_flown, rewriter, rewriting_of
from mavfi.sim.controller import is_rewindable
from mavfi.states import State

TIMEOUT = 60.0
"""Wall-clock limit of an injected run (s): catches hangs that the instruction budget does not count."""
MAP_FUNCTIONS = frozenset({"insert_scan", "collect", "update_voxels", "apply_updates"})
"""Functions that write maps."""
_ATTEMPTS = 3
"""Attempts under this limit: each finds the code that the previous child compiled in the cache."""


# ---- one fault in progress ------------------------------------------------------------------------------------------
WAITING = "not_activated"
"""State of a case whose instruction has not been reached."""
DETECTED = "detected"
"""State of a case whose call was protected, and found a difference."""


Published = tuple[State, int]
"""A publication as received by consumers, and its instant (us)."""


@dataclass(frozen=True, slots=True)
class Output:
    """Output of one kernel step: header and elements of each publication, by name, and a hash of its memory."""

    states: dict[str, tuple[np.ndarray, np.ndarray]]
    memory: bytes

    @staticmethod
    def of(kernel: Kernel, states: Sequence[State]) -> "Output":
        """Output of the step that has just been executed."""
        published = {state.spec.name: (state.header.copy(), state.elements.copy()) for state in states}
        return Output(published, cast(Remembers, kernel).fingerprint())

    def same(self, other: "Output") -> bool:
        """Whether both are bit-identical, memory included."""
        return self.memory == other.memory and first_difference(self, other) is None


@dataclass(frozen=True, slots=True)
class ChildReport:
    """Report of a forked child process.

    Attributes:
        log: Log of its flight; None = no difference at the end of the injected call.
        output: Output of the injected step; None = none was computed.
        call_same: Whether result and arguments of the injected call are bit-identical to the golden ones.
        missed: Whether the call ended before the instruction was reached, or the value has no such bit.
        published: Publications of its flight from the start, in order; None = not recorded.
        detected: Whether protected code found a difference in the call, which has no result then.
        watched: Logs of the same flight with detectors, by arm, where they are known.
    """

    log: FlightLog | None
    output: Output | None
    call_same: bool
    missed: bool = False
    published: list[Published] | None = None
    detected: bool = False
    watched: Mapping[str, FlightLog] = field(default_factory=dict)


@dataclass(slots=True)
class FaultCase:
    """One fault in progress.

    Attributes:
        fault: The sampled fault.
        kernel: The injected kernel of the pipeline, "" = the detector or recovery; `call` of its function is injected,
            at `time_us` (us).
        value: The injected value, as reported by the machine code.
        how: How the call ended, or `WAITING`; `detail`: as in `KernelEffect`.
        report: Report of the child that completed the flight.
        golden: Error-free output of the kernel in the same step.
    """

    fault: CallFault
    kernel: str
    call: int
    time_us: int = 0
    value: InjectionReport | None = None
    how: str = WAITING
    detail: str = ""
    report: ChildReport | None = None
    golden: Output | None = None


def case_of(fault: CallFault, scenario: Scenario, detector: Detector | None = None) -> FaultCase:
    """The case of a fault before its injection; `BadInputError` if the mission lacks the kernel or detector."""
    target = Targets(scenario, detector).of_fault(fault)
    return FaultCase(fault, target.kernel, fault.call)


def flight_of(case: FaultCase, golden: Flight) -> Flight:
    """The injected run, given the golden one."""
    log = golden.log
    if case.report is not None and case.report.log is not None:
        log = case.report.log
    injection = case.fault.injection(case.value, case.time_us / 1e6, case.call)
    log = replace(log, injections=[injection], kernel=_effect(case, golden.log))
    return Flight(log, None, golden.world, golden.pipeline)


def _effect(case: FaultCase, golden: FlightLog) -> KernelEffect:
    """Effect on the kernel: relative to its golden output if both steps completed, else to the whole flight."""
    report = case.report
    if case.how != "done" or report is None:
        return KernelEffect(case.how, case.detail, None)
    difference = None
    if report.log is None:
        is_masked = True
    elif report.output is not None and case.golden is not None:
        is_masked = report.output.same(case.golden)
        difference = first_difference(case.golden, report.output)
    else:
        is_masked = report.call_same and report.log.digest() == golden.digest()
    effect = "masked" if is_masked else "sdc"
    return KernelEffect(effect, case.detail, difference)


def first_difference(golden: Output, injected: Output) -> dict[str, Any] | None:
    """The first published field that differs, as plain data; None = no difference.

    Returns:
        `state`, `field`, `element` (None for a header field), `before` (golden), `after`, `elements` (number of
        positions at which the field differs) and `largest` (largest difference; infinite if any is not finite).  For
        lists of different length: field `elements` with both lengths.
    """
    for state, (header, elements) in golden.states.items():
        if state not in injected.states:
            return _difference(state, "", None, len(elements), 0, 1, math.inf)
        other_header, other_elements = injected.states[state]
        length = len(elements)
        other_length = len(other_elements)
        difference = _in_fields(state, header, other_header, in_list=False)
        if difference is None and length != other_length:
            largest = float(abs(length - other_length))
            difference = _difference(state, "elements", None, length, other_length, 1, largest)
        if difference is None:
            difference = _in_fields(state, elements, other_elements, in_list=True)
        if difference is not None:
            return difference
    return None


def _in_fields(state: str, golden: np.ndarray, injected: np.ndarray, *, in_list: bool) -> dict[str, Any] | None:
    """The first field in which two structured arrays of one length differ bit for bit; None = they are identical."""
    for name in golden.dtype.names or ():
        before = np.ascontiguousarray(golden[name])
        after = np.ascontiguousarray(injected[name])
        width = before.dtype.itemsize
        bits = [values.view(np.uint8).reshape(-1, width) for values in (before, after)]
        rows = np.flatnonzero((bits[0] != bits[1]).any(axis=1))
        if len(rows) == 0:
            continue
        first = int(rows[0])
        with np.errstate(all="ignore"):  # corrupted values may be infinite, or signalling NaN
            changes = np.abs(after[rows].astype(np.float64) - before[rows].astype(np.float64))
        largest = math.inf
        if np.isfinite(changes).all():
            largest = float(changes.max())
        element = first if in_list else None
        return _difference(state, name, element, before[first].item(), after[first].item(), len(rows), largest)
    return None


def _difference(
    state: str, field: str, element: int | None, before: Any, after: Any, elements: int, largest: float
) -> dict[str, Any]:
    return {
        "state": state,
        "field": field,
        "element": element,
        "before": before,
        "after": after,
        "elements": elements,
        "largest": largest,
    }


# ---- flights of one mission -----------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class InjectedRuns:
    """Injected runs with instruction faults.

    Attributes:
        golden: The error-free flight; the injected runs share its pipeline.
        flights: One run per fault, in order.  `log.kernel` is the effect on the kernel; after a crash, hang or
            exception, the log is that of the flight under the mission's policy for dead nodes.
        watched: Runs of other arms as far as they follow from these, by arm and by number of the fault.
    """

    golden: Flight
    flights: list[Flight]
    watched: dict[str, dict[int, Flight]] = field(default_factory=dict)


def fly_instruction_faults(
    scenario: Scenario,
    faults: Sequence[CallFault],
    detector: Detector | None = None,
    golden: Flight | None = None,
    recovery: RecoveryPolicy = INLINE,
) -> InjectedRuns:
    """Fly one mission with each of several instruction faults, all forked from one golden flight from take-off.

    Args:
        scenario: The mission.
        faults: See `mavfi.campaign.samplers.instruction`.
        detector: The detector; None = none.
        golden: The golden flight with this detector, if known: the golden flight here then stops after the last
            injection.
        recovery: The recovery policy for the detector's alarms.

    Raises:
        MismatchError: A fault was sampled for different machine code.
        BadInputError: The scenario cannot be flown, or the mission lacks the kernel.
        MavfiError: `golden` differs from the golden flight flown here.
    """
    cases = [case_of(fault, scenario, detector) for fault in faults]
    approach = FromTakeOff(scenario, cases, detector, recovery, flies_whole_golden=golden is None)
    Forks(approach, cases).fly()
    if golden is None:
        golden = approach.golden
        assert golden is not None  # a whole golden flight was requested
        check_flown(scenario.protection)
    else:
        check_prefix(approach.loop, golden.log)
    return InjectedRuns(golden, [flight_of(case, golden) for case in cases])


def fly_with_publications(
    scenario: Scenario, fault: CallFault, detector: Detector | None = None, recovery: RecoveryPolicy = INLINE
) -> tuple[Flight, list[Published]]:
    """Fly one mission with an instruction fault; also returns its publications, in order.

    Raises the errors of `fly_instruction_faults`.
    """
    case = case_of(fault, scenario, detector)
    approach = FromTakeOff(scenario, [case], detector, recovery, records=True)
    Forks(approach, [case]).fly()
    assert approach.golden is not None and approach.publications is not None  # requested
    check_flown(scenario.protection)
    publications = approach.publications  # of the golden flight: the injected run may have ended as equal to it
    if case.report is not None and case.report.published is not None:
        publications = case.report.published
    return flight_of(case, approach.golden), publications


def fly_from_checkpoints(
    forward: FastForward,
    faults: Sequence[CallFault],
    golden: Flight,
    arm: FlownArm = NO_DETECTOR,
    watched: Sequence[FlownArm] = (),
) -> InjectedRuns:
    """Fly one mission with each of several faults in instructions of its kernels, from golden checkpoints.

    Args:
        forward: All flights of this mission, with scratch.
        faults: As for `fly_instruction_faults`; none in a detector.
        golden: The golden flight of the arm.
        arm: Detector and recovery policy.
        watched: Arms of the same mission with detectors, if this one has none.

    Raises:
        MismatchError: A fault was sampled for different machine code.
        BadInputError: The mission lacks the kernel.
        MavfiError: Two golden flights differ.
    """
    cases = [case_of(fault, forward.loop.scenario, arm.detector) for fault in faults]
    with np.errstate(all="ignore"):  # overflow of corrupted values is expected behaviour
        approach = FromCheckpoints(forward, arm, golden, watched)
        Forks(approach, cases).fly()
    return InjectedRuns(golden, [flight_of(case, golden) for case in cases], approach.followed(cases))


# ---- forks ----------------------------------------------------------------------------------------------------------
@dataclass(slots=True)
class Child:
    """The task of a forked process.

    Attributes:
        point: The fork.
        case: The fault.
        step_fails: Whether it is the second child of a fault, and the step in progress has no result: at the end of it
            the node of the kernel dies, or repeats it.
        call_same: Whether result and arguments of the injected call are bit-identical to the golden ones.
        planned: Whether the injected call could write its own memory only.
        comparable: Whether, moreover, all differences from the golden flight are in results and memory of kernels, so
            that the flights are the same from an instant at which these are.
        output: Output of the injected step.
    """

    point: ForkPoint
    case: FaultCase
    step_fails: bool
    call_same: bool = False
    planned: bool = True
    comparable: bool = True
    output: Output | None = None


class Forks(Listener):
    """Injected runs that fork off a golden flight.

    Args:
        approach: How the golden flight comes to the injected calls.
        cases: The faults, in order; they hold the results after `fly`.

    Attributes:
        child: Task of this process if it is a forked child; None = it flies the golden flight.
    """

    def __init__(self, approach: "GoldenApproach", cases: Sequence[FaultCase]) -> None:
        self.cases = cases
        self.child: Child | None = None
        self._approach = approach
        self._loop = approach.loop
        self._detector = approach.detector
        self._rewriting = rewriting_of(approach.loop.scenario.protection)
        self._calls_may_shift = approach.detector is not None or self._rewriting is not None
        self._awaited: dict[str, list[FaultCase]] = {}  # cases whose golden output is still to come, by kernel

    def fly(self) -> None:
        """Fly the golden flight past all injected calls; does not return in children, which report and exit."""
        try:
            with np.errstate(all="ignore"):  # overflow of corrupted values is expected behaviour
                self._approach.fly(self)
        except BaseException:
            if self.child is None:
                raise
            with self.child.point.guard():
                raise

    def waiting(self) -> list[FaultCase]:
        """Cases that have not been injected, and can be."""
        return [case for case in self.cases if case.fault.has_site and case.how == WAITING]

    def is_done(self) -> bool:
        """Whether the golden flight may end: all cases and golden outputs are known.  Never true in a child."""
        return self.child is None and not self._awaited and all(case.how != WAITING for case in self.cases)

    # ---- in the golden flight ---------------------------------------------------------------------------------------
    def intercept(self, name: str, call: int, function: Callable[..., Any], args: tuple[Any, ...]) -> CallResult | None:
        """Fork at an injected call; the call is made with the fault in children, as usual in the golden flight."""
        if self.child is not None:
            return None
        for case in self.cases:
            if case.call == call and case.fault.counter == name:
                result = self._inject(case, function, args)
                if result is not None:
                    return result
        return None

    def _inject(self, case: FaultCase, function: Any, args: tuple[Any, ...]) -> CallResult | None:
        """Fork at a call; returns its result in a child, None in the golden flight, which makes the call itself."""
        # 1. Find the fault in the code of this call; if calls have shifted, it may be in a later one.
        variant = variant_for(function, args, self._rewriting)
        fault = self._fault_in(case.fault, variant, function, args)
        if fault is None:
            case.call += 1
            return None

        # 2. A child makes the call with the fault, and completes the flight.
        variant.claim_report()
        case.time_us = self._loop.now
        ended = self._fork(case, step_fails=False)
        if ended is None:
            return CallResult(self._injected_call(variant, fault, function, args))
        case.value = variant.report()
        _note_end(case, ended)
        if case.how == WAITING:
            return None

        # 3. If it died, or the fault was detected, a second child continues without the result of the call.
        if case.how != "done":
            ended = self._fork(case, step_fails=True)
            if ended is None:
                self._end_outside_of_pipeline(case.fault)
                return CallResult(function(*args))
            case.report = _report_of(ended)

        # 4. The effect on the kernel is judged by the golden output of the same step.
        if case.kernel:
            self._awaited.setdefault(case.kernel, []).append(case)
        return None

    def _end_outside_of_pipeline(self, fault: CallFault) -> None:
        """In a child whose call died in no step of a kernel: end the detector, or the flight controller."""
        restarts = self._approach.restarts()
        down_us = round(1e6 * fault.restart_s)
        if fault.in_detector and self._detector is not None:
            restarts.detector_dies(self._detector, self._loop.now, down_us)
        elif fault.role == "flight_controller":
            restarts.controller_dies(self._loop.now, down_us)

    def _fault_in(self, fault: CallFault, variant: Variant, function: Any, args: tuple[Any, ...]) -> CallFault | None:
        """The fault in the code of a call: itself, or its counterpart in protected code.

        None if call numbers may have shifted, and this call has other types, ends before the index, or lacks the bit.

        Raises:
            MismatchError: The fault was drawn for other machine code.
        """
        if not self._calls_may_shift:
            fault.check(variant, function)
            return fault
        try:
            if self._rewriting is not None and fault.ir_sha256 != variant.ir_sha256:
                plain = variant_for(function, args)
                if fault.ir_sha256 == plain.ir_sha256:
                    fault = rewriter().pair(fault, plain, variant, args)
            fault.check(variant, function)
        except (MismatchError, IndexError):
            return None
        if _has_bit(variant, fault, args):
            return fault
        return None

    def _fork(self, case: FaultCase, *, step_fails: bool) -> ChildEnd | None:
        """None in the child; in the golden flight the child's termination, retried after a wall-clock timeout."""
        split = split_at_call()
        if split.ended is None:
            self.child = Child(split.point, case, step_fails)
            self._loop.forked = True
        return split.ended

    def after_step(self, kernel: Kernel, states: list[State], now: int) -> None:
        """After a step: store the output of an injected one; end the node of one that died, repeat a detected one."""
        child = self.child
        if child is None:
            for case in self._awaited.pop(kernel.name, ()):
                case.golden = Output.of(kernel, states)
            return
        if child.case.kernel != kernel.name:
            return
        if not child.step_fails:
            if child.output is None:
                child.output = Output.of(kernel, states)
            return
        child.step_fails = False
        if child.case.how == DETECTED:
            self._loop.record.alarms.append(rewriter().alarm(kernel.stage.value, states, now))
            self._approach.restarts().recompute(kernel.name, now, states)
        else:
            self._approach.restarts().die(kernel.name, now, round(1e6 * child.case.fault.restart_s))

    # ---- in a child -------------------------------------------------------------------------------------------------
    def _injected_call(self, variant: Variant, fault: CallFault, function: Any, args: tuple[Any, ...]) -> Any:
        """The call with the fault; a child whose data equals the golden data ends here, as its remainder is golden."""
        child = self.child
        assert child is not None  # called in children only

        # The error-free call, on copies of the arguments.
        placed = arena().place(args)  # preserves strides, which a copy may not: they select the compiled variant
        if placed is None:
            copies = tuple(copied(argument) for argument in args)
        else:
            copies = placed.args
        golden = copy_result((function(*copies), copies))  # the injected call reuses the arena
        before = copy_result(args)

        # The call with the fault.
        try:
            result = variant.inject(fault.index, *fault.masks, fault.budget, *args)
        except SystemError as error:
            if self._rewriting is None or not rewriter().is_detection(error):
                raise
            self._end(ChildReport(None, None, call_same=False, detected=True))
        child.call_same = same((result, args), golden)

        # The flight need not be completed if the fault missed, or changed nothing.
        report = variant.report()
        child.planned = report is not None and report.planned
        child.comparable = child.planned and _is_contained(fault.entry, before, golden[1], args)
        if self._calls_may_shift and changed_nothing(report):
            self._end(ChildReport(None, None, call_same=True, missed=True))
        if child.call_same and report is not None and (report.planned or report.site.value_class in DATA):
            self._end(ChildReport(None, None, call_same=True))
        return result

    def report(self, log: FlightLog, watched: Mapping[str, FlightLog] | None = None) -> NoReturn:
        """End this child with the log of its flight, and those with detectors, by arm, as far as they are known."""
        assert self.child is not None  # called in children only
        child = self.child
        publications = self._approach.publications
        self._end(ChildReport(log, child.output, child.call_same, published=publications, watched=watched or {}))

    def _end(self, report: ChildReport) -> NoReturn:
        """End this child with a report."""
        assert self.child is not None  # called in children only
        self.child.point.finish(pickle.dumps(report))


class ForkedCall(NamedTuple):
    """A fork at an injected call: the point, and how the child ended; None = this is the child."""

    point: ForkPoint
    ended: ChildEnd | None


def split_at_call() -> ForkedCall:
    """Fork; a child that exceeds the wall-clock limit is followed by others."""
    for _ in range(_ATTEMPTS):
        point = ForkPoint()
        ended = split_noting_calls(point, TIMEOUT)
        if ended is None or ended.detail != WALL_CLOCK:
            break
    return ForkedCall(point, ended)


def _report_of(ended: ChildEnd) -> ChildReport:
    """The report of a child; a MavfiError if it ended without one."""
    if ended.how != "done":
        raise MavfiError(f"the flight with a restarted node ended with {ended.how} ({ended.detail})")
    report: ChildReport = pickle.loads(ended.payload)
    return report


def _note_end(case: FaultCase, ended: ChildEnd) -> None:
    """Note how the child with the injected call ended; a case whose instruction it missed waits for the next call."""
    case.how = ended.how
    case.detail = ended.detail
    if ended.how != "done":
        return
    case.report = _report_of(ended)
    if case.report.missed:
        case.call += 1
        case.how = WAITING
        case.report = None
    elif case.report.detected:
        case.how = DETECTED
        case.detail = ""


def _has_bit(variant: Variant, fault: CallFault, args: tuple[Any, ...]) -> bool:
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


# ---- how the golden flight comes to the injected calls --------------------------------------------------------------
class GoldenApproach(ABC):
    """Flies the golden flight past all injected calls.

    Attributes:
        loop: The loop of the golden flight.
        detector: Its detector; None = none.
        publications: Publications so far, with their instants (us), in order; None = not recorded.
    """

    loop: Loop
    detector: Detector | None = None
    publications: list[Published] | None = None

    @abstractmethod
    def restarts(self) -> Restarts:
        """Restarts of the loop's nodes; called in a child whose node dies."""

    @abstractmethod
    def fly(self, forks: Forks) -> None:
        """Let functions fork at their calls, and fly; in a child, complete its flight and report."""


class FromTakeOff(GoldenApproach):
    """Flies the golden flight from take-off, once for all faults.

    Args:
        scenario: The mission.
        cases: The faults; those in detectors are allowed.
        detector: The detector; None = none.
        recovery: The recovery policy for its alarms.
        flies_whole_golden: Whether the golden flight is flown to its end; otherwise it stops after the last injection.
        records: Whether to record publications.

    Attributes:
        golden: The golden flight; None = it stopped before its end.

    Raises:
        BadInputError: The scenario cannot be flown, or its flight cannot be forked.
    """

    def __init__(
        self,
        scenario: Scenario,
        cases: Sequence[FaultCase],
        detector: Detector | None = None,
        recovery: RecoveryPolicy = INLINE,
        *,
        flies_whole_golden: bool = True,
        records: bool = False,
    ) -> None:
        if not is_rewindable(scenario.flight_controller):
            text = "faults in instructions fork the flight, which this controller does not allow; allowed: cascade"
            raise BadInputError(f"flight_controller: {scenario.flight_controller}: {text}")
        self.golden: Flight | None = None
        self.detector = detector
        self._flies_whole_golden = flies_whole_golden

        # Count the calls of all functions with faults.
        targets = Targets(scenario, detector)
        counted: dict[str, CountedFunction] = {}
        for case in cases:
            fault = case.fault
            if fault.has_site:
                function = targets.of_fault(fault).functions[fault.entry]
                counted.setdefault(fault.counter, CountedFunction(fault.counter, function))
        self._functions = list(counted.values())
        self._instrumented = ExitStack()
        table = self._instrumented.enter_context(targets.instrumented(counted))
        self.loop = new_loop(scenario, functions=table)
        for counter in self._functions:
            counter.attach(self.loop)

        watch(self.loop, detector, recovery)
        if records:
            self.publications = []
            self.loop.taps.recorders.append(self._record)
        self._restarts = Restarts(self.loop, scenario.dead_node)

    def _record(self, state: State, now: int) -> None:
        """Record a publication."""
        assert self.publications is not None  # this is a recorder only then
        self.publications.append((state.copy(), now))

    def restarts(self) -> Restarts:
        """See `GoldenApproach.restarts`."""
        return self._restarts

    def fly(self, forks: Forks) -> None:
        """See `GoldenApproach.fly`."""
        for function in self._functions:
            function.intercept = forks.intercept
        self.loop.listeners.append(forks)
        with self._instrumented:
            self.golden = fly_until(self.loop, lambda: not self._flies_whole_golden and forks.is_done())
        if forks.child is not None:
            assert self.golden is not None  # `is_done` is never true in a child
            forks.report(self.golden.log)


class FromCheckpoints(GoldenApproach):
    """Starts at the golden flight's last checkpoint before each injected call; arguments as of `fly_from_checkpoints`.

    An injected run with a detector equals the one without up to its first alarm.  So the child of the run without a
    detector shows its publications to the detectors of the other arms, too, and continues these runs at the checkpoint
    before an alarm.  A run is flown on its own if its golden flight differs before the fault, or at an alarm before the
    first checkpoint after the fault, or at any alarm if checkpoints do not contain what the fault changed.

    Raises:
        MavfiError: The golden flight of the checkpoints differs from `golden`.
    """

    def __init__(self, forward: FastForward, arm: FlownArm, golden: Flight, watched: Sequence[FlownArm]) -> None:
        self.loop = forward.loop
        self.detector = arm.detector
        self._forward = forward
        self._arm = arm
        self._branch: FlightBranch | None = None
        self._golden = forward.golden(arm)
        self._plain_golden = forward.golden()
        if self._golden.log.digest() != golden.log.digest():
            raise MavfiError("two golden flights of one mission differ: no fault can be addressed")
        # All golden flights are flown before the forks, so that children have them.
        self._watched = watched
        self._watched_golden = {other.name: forward.golden(other) for other in watched}

    def restarts(self) -> Restarts:
        """See `GoldenApproach.restarts`; they know all publications since take-off."""
        assert self._branch is not None  # it flies
        restarts = Restarts(self.loop, self.loop.scenario.dead_node)
        for state, now in self._branch.publications:
            restarts.keep(state, now)
        return restarts

    def fly(self, forks: Forks) -> None:
        """See `GoldenApproach.fly`."""
        with self._forking(forks):
            while waiting := forks.waiting():
                rows = min(self._checkpoint_before(self._golden, case) for case in waiting)
                if self._branch is None or rows > len(self.loop.record.rows):
                    self._check_prefix()
                    self._branch = self._jump(forks, rows)
                    fill(self.loop, {case.kernel for case in waiting})
                elif self.loop.status is not None:
                    break  # no call with such a bit came any more
                self.loop.run(len(self.loop.record.rows) + 1)
                if forks.child is not None:
                    self._complete(forks, forks.child)
            self._check_prefix()

    @contextmanager
    def _forking(self, forks: Forks) -> Iterator[None]:
        """Let functions fork at their calls."""
        functions = [self._forward.functions[case.fault.entry] for case in forks.waiting()]
        for function in functions:
            function.intercept = forks.intercept
        self.loop.listeners.append(forks)
        try:
            yield
        finally:
            self.loop.listeners.remove(forks)
            self.loop.taps.recorders.clear()
            for function in functions:
                function.intercept = None

    def _checkpoint_before(self, golden: KnownFlight, case: FaultCase) -> int:
        """Number of rows of the last checkpoint of a golden flight before the injected call."""
        count_index = list(self.loop.record.calls).index(case.fault.entry)  # calls come first in the counts
        checkpoints = golden.checkpoints.items()
        return max(rows for rows, checkpoint in checkpoints if checkpoint.counts[count_index] <= case.call)

    def _jump(self, forks: Forks, rows: int) -> FlightBranch:
        """Continue the golden flight at a checkpoint."""
        golden = self._golden
        start = self._golden.checkpoints[rows]
        branch = FlightBranch(self._forward, self._arm, [self._plain_golden], golden, keeps_publications=True)
        branch.comparable = lambda: forks.child is not None and forks.child.comparable and not self.loop.down
        branch.begin(golden, start)
        self.loop.taps.injector = start.injector.copy()
        branch.restore_detector(start.detector)
        put(self.loop, start.here)
        return branch

    def _check_prefix(self) -> None:
        """Raise a MavfiError if the flight so far differs from the golden flight."""
        if self._branch is not None:
            check_prefix(self.loop, self._golden.log)

    # ---- in a child: arms with detectors ----------------------------------------------------------------------------
    def _complete(self, forks: Forks, child: Child) -> NoReturn:
        """Fly to the end, then under the detectors of the other arms, and report."""
        assert self._branch is not None  # it flies
        if not (child.planned and self._watched):
            forks.report(self._branch.fly().log)  # does not return
        if child.comparable and child.case.how == WAITING:  # else checkpoints do not contain all: a node has died, e.g.
            self._branch.store_checkpoints_from_now_on()
        without_detector = self._branch.fly()
        logs = {}
        for arm in self._watched:
            with suppress(Exception, SystemExit):  # the run is then flown on its own, where the error counts
                log = self._under_detector(without_detector, child.case, arm)
                if log is not None:
                    logs[arm.name] = log
        forks.report(without_detector.log, logs)

    def _under_detector(self, without_detector: KnownFlight, case: FaultCase, arm: FlownArm) -> FlightLog | None:
        """The log of a completed flight of this child under the detector of an arm; None = it must be flown."""
        golden = self._watched_golden[arm.name]
        plain = self._plain_golden
        rows = self._checkpoint_before(plain, case)
        if not self._is_plain(golden, rows):
            return None

        # Begin at the checkpoint before the fault.
        start = golden.checkpoints[rows]
        branch = FlightBranch(self._forward, arm, [without_detector, plain], golden)
        branch.begin(golden, start)
        branch.restore_detector(start.detector)

        # Up to the first checkpoint after the fault there is none to continue from at an alarm.
        first_rows = min(without_detector.checkpoints, default=None)
        first = without_detector.end
        if first_rows is not None:
            first = without_detector.checkpoints[first_rows]
        if not branch.append_unless_alarm(without_detector, plain.checkpoints[rows], first):
            return None

        # From there, follow the completed flight as far as the detector raises no alarm.
        if first_rows is not None:
            self.loop.taps.injector = first.injector.copy()
            branch.follow(without_detector, first_rows)
        return branch.fly().log

    def followed(self, cases: Sequence[FaultCase]) -> dict[str, dict[int, Flight]]:
        """Runs of the other arms that are known, by arm and by number of the case."""
        flights: dict[str, dict[int, Flight]] = {arm.name: {} for arm in self._watched}
        for number, case in enumerate(cases):
            report = case.report
            if report is None or changed_nothing(case.value):  # with a detector, a later call may have such a bit
                continue
            for name, golden in self._watched_golden.items():
                if report.log is None and self._ends_as_golden(case, golden):
                    flights[name][number] = flight_of(case, Flight(golden.log))
                elif name in report.watched:
                    watched_case = replace(case, report=replace(report, log=report.watched[name]))
                    flights[name][number] = flight_of(watched_case, Flight(golden.log))
        return flights

    def _ends_as_golden(self, case: FaultCase, golden: KnownFlight) -> bool:
        """Whether a call without effect is the same one in an arm with a detector: the flight is golden then."""
        rows = self._checkpoint_before(self._plain_golden, case)
        if not self._is_plain(golden, rows):
            return False
        alarms_before_call = sum(round(1e6 * alarm.time_s) <= case.time_us for alarm in golden.log.alarms)
        return alarms_before_call == len(golden.checkpoints[rows].alarms)

    def _is_plain(self, golden: KnownFlight, rows: int) -> bool:
        """Whether a golden flight with a detector has the state, and the calls, of the one without at a checkpoint."""
        plain = self._plain_golden.checkpoints[rows]
        here = golden.checkpoints.get(rows)
        calls = len(self.loop.record.calls)  # these come first in the counts
        return here is not None and here.instant is plain.instant and here.counts[:calls] == plain.counts[:calls]
