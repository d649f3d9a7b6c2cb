"""Forked execution of instruction faults: injected runs branch off one golden flight at the injected calls.

The golden flight runs plain kernels.  At an injected call it waits while a forked child executes the call with the
fault and completes the flight (`flight.fork_child`).  If the child crashes, hangs or raises, a second child continues
from the same instant under the mission's policy for dead nodes (`flight.restarts`); by default as in a ROS graph: the
node's result is lost, and the node returns with initialized memory after the restart latency.  If protected code
detects the fault, the second child computes the step again, see `extras.hardening.protected`.  The golden flight then
continues to the next injected call.

How the golden flight comes to the injected calls is the `GoldenApproach`: from take-off (`flight.from_take_off`), or
from the last golden checkpoint before each call, where children also end as soon as they converge to a known flight
(`flight.from_checkpoints`).  The records are the same.

A false alarm of a detector before the fault causes recomputations, which shift the call numbers: the sampled call may
then end before the instruction's index, or have a narrower value there; so may one of a protected kernel, whose latency
is longer, if the fault was drawn in plain code.  With a detector or protection, the fault is therefore injected into
the first call at or after the sampled one that has such a bit, as a state fault is injected into the first publication
at or after its instant.
"""

import pickle
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mavfi.detectors.detector import Detector, split_noting_calls
from mavfi.errors import MavfiError
from mavfi.faults.fault import CallFault
from mavfi.flight.counted_functions import CallResult
from mavfi.flight.fork_child import ForkedChild
from mavfi.flight.instruction_cases import DETECTED, WAITING, ChildReport, FaultCase, Output, Published
from mavfi.flight.loop import Listener, Loop
from mavfi.flight.restarts import Restarts
from mavfi.ir.forked import WALL_CLOCK, ChildEnd, ForkPoint
from mavfi.ir.injection.variant import MismatchError, Variant, variant_for
from mavfi.pipeline.kernel import Kernel
from mavfi.pipeline.memory import copied
from mavfi.rewriting import rewriter, rewriting_of
from mavfi.states import State

TIMEOUT = 60.0
"""Wall-clock limit of an injected run (s): catches hangs that the instruction budget does not count."""
_ATTEMPTS = 3
"""Attempts under this limit: each finds the code that the previous child compiled in the cache."""


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
    def fly(self, forks: "Forks") -> None:
        """Let functions fork at their calls, and fly; in a child, complete its flight and report."""


class Forks(Listener):
    """Injected runs that fork off a golden flight.

    Args:
        approach: How the golden flight comes to the injected calls.
        cases: The faults, in order; they hold the results after `fly`.

    Attributes:
        child: Task of this process if it is a forked child; None = it flies the golden flight.
    """

    def __init__(self, approach: GoldenApproach, cases: Sequence[FaultCase]) -> None:
        self.cases = cases
        self.child: ForkedChild | None = None
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

    # ---- at a call --------------------------------------------------------------------------------------------------
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
            assert self.child is not None  # this is the child
            is_protected = self._rewriting is not None
            result = self.child.call(
                variant, fault, function, args, is_protected=is_protected, calls_may_shift=self._calls_may_shift
            )
            return CallResult(result)
        case.value = variant.report()
        case.how = ended.how
        case.detail = ended.detail
        if ended.how == "done":
            case.report = _report_of(ended)
            if case.report.missed:  # the case waits for the next call
                case.call += 1
                case.how = WAITING
                case.report = None
                return None
            if case.report.detected:
                case.how = DETECTED
                case.detail = ""

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
        # Does the call reach the index, with a value that has such a bit?  This runs on copies, without a fork.
        _, (site,) = variant.resolve([fault.index], *copied(args))
        keep, flip = fault.masks
        if site is None or (flip | ~keep) % (1 << site.width) == 0:
            return None
        return fault

    def _fork(self, case: FaultCase, *, step_fails: bool) -> ChildEnd | None:
        """None in the child; in the golden flight the child's termination, retried after a wall-clock timeout."""
        point, ended = split_at_call()
        if ended is None:
            self.child = ForkedChild(point, case, step_fails)
            self._loop.forked = True
        return ended

    def _end_outside_of_pipeline(self, fault: CallFault) -> None:
        """In a child whose call died in no step of a kernel: end the detector, or the flight controller."""
        restarts = self._approach.restarts()
        down_us = round(1e6 * fault.restart_s)
        if fault.in_detector and self._detector is not None:
            restarts.detector_dies(self._detector, self._loop.now, down_us)
        elif fault.role == "flight_controller":
            restarts.controller_dies(self._loop.now, down_us)

    # ---- after a step -----------------------------------------------------------------------------------------------
    def after_step(self, kernel: Kernel, states: list[State], now: int) -> None:
        """Note the outputs of injected steps, golden and with the fault; end the node of a step without a result."""
        # In the golden flight: what cases are judged by.
        child = self.child
        if child is None:
            for case in self._awaited.pop(kernel.name, ()):
                case.golden = Output.of(kernel, states)
            return

        # In a child: the step of the injected call.
        case = child.case
        if case.kernel != kernel.name:
            return
        if not child.step_fails:
            if child.output is None:  # only the first step of the kernel is the injected one
                child.output = Output.of(kernel, states)
            return
        child.step_fails = False
        if case.how == DETECTED:
            self._loop.record.alarms.append(rewriter().alarm(kernel.stage.value, states, now))
            self._loop.repeat_step(kernel.name, now, states)
        else:
            self._approach.restarts().die(kernel.name, now, round(1e6 * case.fault.restart_s))


def split_at_call() -> tuple[ForkPoint, ChildEnd | None]:
    """Fork; a child that exceeds the wall-clock limit is followed by others.

    Returns:
        The fork, and how the child ended; None = this is the child.
    """
    for _ in range(_ATTEMPTS):
        point = ForkPoint()
        ended = split_noting_calls(point, TIMEOUT)
        if ended is None or ended.detail != WALL_CLOCK:
            break
    return point, ended


def _report_of(ended: ChildEnd) -> ChildReport:
    """The report of a child; a MavfiError if it ended without one."""
    if ended.how != "done":
        raise MavfiError(f"the flight with a restarted node ended with {ended.how} ({ended.detail})")
    report: ChildReport = pickle.loads(ended.payload)
    return report
