"""Progress of an instruction fault through a flight: outputs of the injected step, and the resulting flight log."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from mavfi.detectors.detector import Detector, part_of
from mavfi.detectors.preprocess import PROFILES
from mavfi.detectors.registry import contains, detector_names, is_named
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError
from mavfi.faults.fault import InstructionFault
from mavfi.faults.levels.instruction.plan import injection_of
from mavfi.faults.levels.instruction.variant import Report
from mavfi.flight.host import Flight
from mavfi.mission import Scenario
from mavfi.pipeline.kernel import Kernel
from mavfi.pipeline.memory import Remembers
from mavfi.record import FlightLog, KernelEffect
from mavfi.states import DETECTORS, INJECTABLE, INJECTED_KERNEL, PLANNERS, State

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
class Case:
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

    fault: InstructionFault
    kernel: str
    call: int
    time_us: int = 0
    value: Report | None = None
    how: str = WAITING
    detail: str = ""
    report: ChildReport | None = None
    golden: Output | None = None


def check_kernel(kernel: str, planner: str, detector: Detector | None = None) -> None:
    """Check that a kernel, or detector, can be injected in a mission with this planner and detector.

    Raises:
        BadInputError: The kernel is unknown, is a planner that the mission does not use, or is a detector that does not
            monitor the mission.
    """
    if kernel in DETECTORS:
        check_watched(kernel, detector)
        return
    if dropped_name("kernels", kernel):
        raise BadInputError(dropped_name("kernels", kernel))
    if kernel not in INJECTABLE:
        configured = next((source for source in DETECTORS if is_named(kernel, source)), "")
        why = f"is a configuration of {configured!r}, whose instructions can be injected" if configured else "not known"
        raise BadInputError(f"kernel {kernel!r}: {why}; allowed: {', '.join((*INJECTABLE, *DETECTORS))}")
    if kernel in PLANNERS and kernel != planner:
        raise BadInputError(f"kernel {kernel!r}: the planner of this mission is {planner!r}; allowed: planner {kernel}")


def check_watched(target: str, detector: Detector | None) -> None:
    """Check that a detector is part of a flight with `detector`; `BadInputError` if not."""
    if part_of(detector, target) is not None:
        return
    if target not in DETECTORS:
        raise BadInputError(f"kernel {target!r}: is not part of this mission; allowed: with a detector")
    names = []
    for name in detector_names():
        profiles = [profile for profile in PROFILES if contains(name, profile, target)]
        if profiles:
            names.append(name if PROFILES[0] in profiles else f"{name} (profile {profiles[0]})")
    raise BadInputError(f"kernel {target!r}: is not part of this mission; allowed: with {', '.join(names)}")


def case_of(fault: InstructionFault, scenario: Scenario, detector: Detector | None = None) -> Case:
    """The case of a fault before its injection; `BadInputError` if the mission lacks the kernel or detector."""
    check_kernel(fault.kernel, scenario.planner.name, detector)
    return Case(fault, INJECTED_KERNEL.get(fault.kernel, ""), fault.call)


def flight_of(case: Case, golden: Flight) -> Flight:
    """The injected run, given the golden one."""
    log = golden.log
    if case.report is not None and case.report.log is not None:
        log = case.report.log
    injection = injection_of(case.fault, case.value, case.time_us / 1e6, case.call)
    log = replace(log, injections=[injection], kernel=_effect(case, golden.log))
    return Flight(log, None, golden.world, golden.pipeline)


def _effect(case: Case, golden: FlightLog) -> KernelEffect:
    """Effect on the kernel: relative to its golden output if both steps completed, else to the whole flight."""
    report = case.report
    if case.how != "done" or report is None:
        return KernelEffect(case.how, case.detail, None)
    difference = None
    if report.log is None:
        same = True
    elif report.output is not None and case.golden is not None:
        same = report.output.same(case.golden)
        difference = first_difference(case.golden, report.output)
    else:
        same = report.call_same and report.log.digest() == golden.digest()
    return KernelEffect("masked" if same else "sdc", case.detail, difference)


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
        length, other_length = len(elements), len(other_elements)
        difference = _in_fields(state, header, other_header, in_list=False)
        if difference is None and length != other_length:
            difference = _difference(
                state, "elements", None, length, other_length, 1, float(abs(length - other_length))
            )
        if difference is None:
            difference = _in_fields(state, elements, other_elements, in_list=True)
        if difference is not None:
            return difference
    return None


def _in_fields(state: str, golden: np.ndarray, injected: np.ndarray, *, in_list: bool) -> dict[str, Any] | None:
    for name in golden.dtype.names or ():
        before, after = np.ascontiguousarray(golden[name]), np.ascontiguousarray(injected[name])
        width = before.dtype.itemsize
        bits = [values.view(np.uint8).reshape(-1, width) for values in (before, after)]
        rows = np.flatnonzero((bits[0] != bits[1]).any(axis=1))
        if len(rows):
            first = int(rows[0])
            with np.errstate(all="ignore"):  # corrupted values may be infinite, or signalling NaN
                changes = np.abs(after[rows].astype(np.float64) - before[rows].astype(np.float64))
            largest = float(changes.max()) if np.isfinite(changes).all() else math.inf
            element = first if in_list else None
            return _difference(state, name, element, before[first].item(), after[first].item(), len(rows), largest)
    return None


def _difference(
    state: str, field: str, element: int | None, before: Any, after: Any, elements: int, largest: float
) -> dict[str, Any]:  # fmt: skip
    return {
        "state": state, "field": field, "element": element, "before": before, "after": after, "elements": elements,
        "largest": largest,
    }  # fmt: skip
