"""Instruction faults during their flights, and what they did: reports of forked processes, judged by the golden run."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.faults.fault import CallFault
from mavfi.flight.host import Flight
from mavfi.flight.targets import Targets
from mavfi.ir.injection.variant import InjectionReport
from mavfi.mission import Scenario
from mavfi.pipeline.kernel import Kernel
from mavfi.pipeline.memory import Remembers
from mavfi.record import FlightLog, KernelEffect
from mavfi.states import State, differing_rows

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
        kernel: The injected kernel of the pipeline; "" = the detector or recovery.
        call: Number of the injected call of its function.
        time_us: Instant of the call (us).
        value: The injected value, as reported by the machine code.
        how: How the call ended: "done", `DETECTED`, or the effect by which its process died; `WAITING` before.
        detail: See `KernelEffect`.
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
    if report.log is None:  # the child ended at the call, in which the fault changed nothing
        is_masked = True
    elif report.output is not None and case.golden is not None:
        is_masked = report.output.same(case.golden)
        difference = first_difference(case.golden, report.output)
    else:  # the call is in no step, or its step has no output
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
        difference = _in_fields(state, header, other_header, in_list=False)
        if difference is not None:
            return difference
        length = len(elements)
        other_length = len(other_elements)
        if length != other_length:
            return _difference(state, "elements", None, length, other_length, 1, float(abs(length - other_length)))
        difference = _in_fields(state, elements, other_elements, in_list=True)
        if difference is not None:
            return difference
    return None


def _in_fields(state: str, golden: np.ndarray, injected: np.ndarray, *, in_list: bool) -> dict[str, Any] | None:
    """The first field in which two structured arrays of one length differ bit for bit; None = they are identical."""
    for name in golden.dtype.names or ():
        before = golden[name]
        after = injected[name]
        rows = differing_rows(before, after)
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


@dataclass(frozen=True, slots=True)
class InjectedRuns:
    """Injected runs with instruction faults.

    Attributes:
        golden: The error-free flight; the injected runs share its pipeline.
        flights: One run per fault, in order.  `log.kernel` is the effect on the kernel; after a crash, hang or
            exception, the log is that of the flight under the mission's policy for dead nodes.
        publications: Those of each flight, in order, if they are recorded.
        watched: Runs of other arms as far as they follow from these, by arm and by number of the fault.
    """

    golden: Flight
    flights: list[Flight]
    publications: list[list[Published]] = field(default_factory=list)
    watched: dict[str, dict[int, Flight]] = field(default_factory=dict)
