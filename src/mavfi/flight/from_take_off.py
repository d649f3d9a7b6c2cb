"""Instruction faults in flights from take-off: one golden flight, from which all injected runs fork."""

from collections.abc import Sequence
from contextlib import ExitStack

from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import CallFault
from mavfi.flight.compose import new_loop, watch
from mavfi.flight.counted_functions import CountedFunction
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.forks import Forks, GoldenApproach
from mavfi.flight.host import Flight
from mavfi.flight.instruction_cases import FaultCase, InjectedRuns, Published, case_of, flight_of
from mavfi.flight.known_flights import check_prefix
from mavfi.flight.restarts import Restarts
from mavfi.flight.targets import Targets
from mavfi.mission import Scenario
from mavfi.rewriting import check_flown
from mavfi.sim.controller import is_rewindable


def fly_instruction_faults(
    scenario: Scenario,
    faults: Sequence[CallFault],
    detector: Detector | None = None,
    golden: Flight | None = None,
    recovery: RecoveryPolicy = INLINE,
    *,
    records: bool = False,
) -> InjectedRuns:
    """Fly one mission with each of several instruction faults, all forked from one golden flight from take-off.

    Args:
        scenario: The mission.
        faults: See `mavfi.campaign.samplers.instruction`.
        detector: The detector; None = none.
        golden: The golden flight with this detector, if known: the golden flight here then stops after the last
            injection.
        recovery: The recovery policy for the detector's alarms.
        records: Whether to record publications, without a known golden flight.

    Raises:
        MismatchError: A fault was sampled for different machine code.
        BadInputError: The scenario cannot be flown, or the mission lacks the kernel.
        MavfiError: `golden` differs from the golden flight flown here.
    """
    cases = [case_of(fault, scenario, detector) for fault in faults]
    approach = FromTakeOff(scenario, cases, detector, recovery, flies_whole_golden=golden is None, records=records)
    Forks(approach, cases).fly()
    if golden is None:
        golden = approach.golden
        assert golden is not None  # a whole golden flight was requested
        check_flown(scenario.protection)
    else:
        check_prefix(approach.loop, golden.log)
    published: list[list[Published]] = []
    if approach.publications is not None:
        for case in cases:
            if case.report is None or case.report.published is None:
                published.append(approach.publications)  # the run equals the golden flight
            else:
                published.append(case.report.published)
    return InjectedRuns(golden, [flight_of(case, golden) for case in cases], published)


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

        # What takes part in the flight.
        watch(self.loop, detector, recovery)
        if records:
            publications = self.publications = []
            self.loop.taps.recorders.append(lambda state, now: publications.append((state.copy(), now)))
        self._restarts = Restarts(self.loop, scenario.dead_node)

    def restarts(self) -> Restarts:
        """See `GoldenApproach.restarts`."""
        return self._restarts

    def fly(self, forks: Forks) -> None:
        """See `GoldenApproach.fly`."""
        for function in self._functions:
            function.intercept = forks.intercept
        self.loop.listeners.append(forks)
        with self._instrumented:
            self.golden = self.loop.fly_until(lambda: not self._flies_whole_golden and forks.is_done())
        if forks.child is not None:
            assert self.golden is not None  # `is_done` is never true in a child
            forks.child.report(self.golden.log, self.publications)
