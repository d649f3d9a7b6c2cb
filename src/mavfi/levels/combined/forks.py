"""One flight with several faults in instructions, or one in several calls: it forks at each injected call.

Each fork is within the one before it.

The child makes the call with the fault and flies on; the parent waits.  If the child completes the flight, that is the
result.  If it crashes, hangs or raises, the parent continues from the same instant under the mission's policy for dead
nodes, as in `flight.forks`.  Faults of other levels are in the flight from the start.

Earlier faults shift call numbers, so each fault is injected into the first call at or after the sampled one that has
such a bit; see `flight.forks`.
"""

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.faults.combined import Start
from mavfi.faults.fault import Fault
from mavfi.flight.counted_functions import CallResult
from mavfi.flight.forks import Forks, split_at_call
from mavfi.flight.from_take_off import FromTakeOff
from mavfi.flight.host import ArmSetup, Flight
from mavfi.flight.instruction_cases import WAITING, FaultCase, Published, case_of
from mavfi.ir.forked import ForkPoint
from mavfi.ir.injection.variant import changed_nothing, variant_for
from mavfi.levels.combined.fault import is_in_calls
from mavfi.levels.combined.injector import CombinedInjector
from mavfi.pipeline.kernel import Kernel
from mavfi.record import FlightLog, Injection, KernelEffect
from mavfi.rewriting import check_flown
from mavfi.states import State


@dataclass(frozen=True, slots=True)
class CompletedFlight:
    """What the process that completes a flight reports: the log, and the publications if they are recorded."""

    log: FlightLog
    published: list[Published] | None


class _CompletedInChildError(BaseException):
    """Ends the flight of the first process, whose child has completed it; no handler of kernels catches it."""

    def __init__(self, payload: bytes) -> None:
        super().__init__()
        self.payload = payload


@dataclass(slots=True)
class _Progress:
    """A fault in instructions during the flight.

    Attributes:
        case: The fault, and what became of its first injection.
        next_call: First call of its function that may be changed next.
        remaining: Number of calls still to be changed.
    """

    case: FaultCase
    next_call: int
    remaining: int


class SerialForks(Forks):
    """Faults in instructions that all occur in one flight.

    Args:
        approach: The flight.
        cases: The faults, in order.
        injector: Injects the faults of other levels.
    """

    def __init__(self, approach: FromTakeOff, cases: list[FaultCase], injector: CombinedInjector) -> None:
        super().__init__(approach, cases)
        self._injector = injector
        self._progress = [_Progress(case, case.call, case.fault.times) for case in cases if case.fault.has_site]
        self._flight = approach
        self._calls_may_shift = True
        self._point: ForkPoint | None = None  # of this process; None = it is the first one
        self._dying: dict[str, int] = {}  # down time (us) of kernels whose step in progress has no result
        self._effect: KernelEffect | None = None  # of the first fault after which a node died

    def complete(self) -> CompletedFlight:
        """Fly to the end; does not return in children, which report and exit."""
        try:
            with np.errstate(all="ignore"):  # overflow of corrupted values is expected behaviour
                self._flight.fly(self)
            golden = self._flight.golden
            assert golden is not None  # the whole flight was requested
            effect = self._effect or self._injector.effect
            log = replace(golden.log, injections=self._injections(golden.log), kernel=effect)
            completed = CompletedFlight(log, self._flight.publications)
            if self._point is not None:
                self._point.finish(pickle.dumps(completed))
            return completed
        except _CompletedInChildError as end:
            completed_in_child: CompletedFlight = pickle.loads(end.payload)
            return completed_in_child
        except BaseException:
            if self._point is None:
                raise
            with self._point.guard():
                raise

    def is_done(self) -> bool:
        """See `Forks.is_done`: the flight is flown to its end."""
        return False

    def _injections(self, log: FlightLog) -> list[Injection]:
        """Injections of the other levels, then those in instructions."""
        of_instructions = []
        for progress in self._progress:
            case = progress.case
            injection = case.fault.injection(case.value, case.time_us / 1e6, case.call)
            details = {**injection.details, "died": case.how not in ("done", WAITING)}
            if case.fault.times > 1:
                details["calls"] = case.fault.times - progress.remaining
            of_instructions.append(replace(injection, details=details))
        return [*log.injections, *of_instructions]

    def intercept(self, name: str, call: int, function: Callable[..., Any], args: tuple[Any, ...]) -> CallResult | None:
        """Fork at a call with a fault; the child continues with its result, the parent only if the child dies."""
        for progress in self._progress:
            is_due = progress.remaining > 0 and call >= progress.next_call
            if is_due and progress.case.fault.counter == name:
                result = self._inject_serially(progress, call, function, args)
                if result is not None:
                    return result
        return None

    def _inject_serially(
        self, progress: _Progress, call: int, function: Callable[..., Any], args: tuple[Any, ...]
    ) -> CallResult | None:
        """The result of a call with a fault, or of one whose process died; None = this call has no such bit."""
        # 1. Find the fault in the code of this call.
        case = progress.case
        variant = variant_for(function, args, self._rewriting)
        fault = self._fault_in(case.fault, variant, function, args)
        if fault is None:
            return None
        variant.claim_report()
        is_first = case.value is None
        if is_first:
            case.call = call
            case.time_us = self._loop.now
        progress.next_call = call + 1

        # 2. The child makes the call with the fault, and flies on.
        point, ended = split_at_call()
        if ended is None:
            self._point = point
            self._loop.forked = True
            result = variant.inject(fault.index, *fault.masks, fault.budget, *args)
            report = variant.report()
            if is_first:
                case.value = report
                case.how = "done"
            if not changed_nothing(report):
                progress.remaining -= 1
                self._injector.note_injection(case.time_us)
            return CallResult(result)
        if ended.how == "done":
            self._report_of_child(ended.payload)

        # 3. It died: the node loses its step in progress, and restarts.
        if is_first:
            case.value = variant.report()
        case.how = ended.how
        progress.remaining -= 1
        self._injector.note_injection(case.time_us)
        self._loop.forked = True
        self._effect = self._effect or KernelEffect(ended.how, ended.detail, None)
        down_us = round(1e6 * fault.restart_s)
        if case.kernel:
            self._dying[case.kernel] = down_us
        else:
            self._end_outside_of_pipeline(fault)
        return CallResult(function(*args))

    def _report_of_child(self, payload: bytes) -> NoReturn:
        """End this process with the flight that its child has completed."""
        if self._point is not None:
            self._point.finish(payload)
        raise _CompletedInChildError(payload)

    def after_step(self, kernel: Kernel, states: list[State], now: int) -> None:
        """See `Listener`: end the node of a kernel whose step has no result."""
        del states
        down_us = self._dying.pop(kernel.name, None)
        if down_us is not None:
            self._approach.restarts().die(kernel.name, now, down_us)


def fly_serially(
    setup: ArmSetup, members: Sequence[tuple[Fault, Start | None]], detector: Detector | None, *, records: bool
) -> tuple[Flight, list[Published]]:
    """Fly one mission with faults, each with what it waits for; also returns its publications, if recorded.

    Raises:
        BadInputError: The scenario cannot be flown, or the mission lacks a kernel.
    """
    # The flight with the faults of other levels, and counters of the calls of functions with faults.
    scenario = setup.scenario
    in_calls: list[Any] = [fault for fault, _ in members if is_in_calls(fault)]
    others = [(fault, start) for fault, start in members if not is_in_calls(fault)]
    cases = [case_of(fault, scenario, detector) for fault in in_calls]
    approach = FromTakeOff(scenario, cases, detector, setup.recovery, records=records)
    injector = CombinedInjector(approach.loop, others, detector)
    try:
        completed = SerialForks(approach, cases, injector).complete()
        check_flown(scenario.protection)
    finally:
        approach.loop.plant.close()
        injector.release()
    return Flight(completed.log, None, approach.loop.world), completed.published or []
