"""Instruction faults from golden checkpoints: children end where they converge, and other arms follow them."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import NoReturn

import numpy as np

from mavfi.errors import MavfiError
from mavfi.faults.fault import CallFault
from mavfi.flight.branches import FlightBranch
from mavfi.flight.checkpoints import fill, put
from mavfi.flight.fast_forward import FastForward
from mavfi.flight.fork_child import ForkedChild
from mavfi.flight.forks import Forks, GoldenApproach
from mavfi.flight.host import Flight
from mavfi.flight.instruction_cases import WAITING, FaultCase, InjectedRuns, case_of, flight_of
from mavfi.flight.known_flights import NO_DETECTOR, FlownArm, KnownFlight, check_prefix
from mavfi.flight.restarts import Restarts
from mavfi.ir.injection.variant import changed_nothing
from mavfi.record import FlightLog


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
    flights = [flight_of(case, golden) for case in cases]
    return InjectedRuns(golden, flights, watched=approach.followed(cases))


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
        return Restarts(self.loop, self.loop.scenario.dead_node, self._branch.publications)

    def fly(self, forks: Forks) -> None:
        """See `GoldenApproach.fly`."""
        with self._forking(forks):
            while waiting := forks.waiting():
                # Jump to the checkpoint before the next injected call, unless the flight is there or beyond.
                rows = min(self._checkpoint_before(self._golden, case) for case in waiting)
                if self._branch is None or rows > len(self.loop.record.rows):
                    self._check_prefix()
                    self._branch = self._jump(forks, rows)
                    fill(self.loop, {case.kernel for case in waiting})
                elif self.loop.status is not None:
                    break  # no call with such a bit came any more
                # Fly one control period; a child that forks in it completes the flight, and does not return.
                self.loop.run(len(self.loop.record.rows) + 1)
                if forks.child is not None:
                    self._complete(forks.child)
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
        start = golden.checkpoints[rows]
        others = [self._plain_golden]
        branch = FlightBranch(self._forward, self._arm, start, golden, others, golden, keeps_publications=True)
        # The golden flight itself, and children whose checkpoints do not contain all, must not end by converging.
        branch.comparable = lambda: forks.child is not None and forks.child.comparable and not self.loop.state.down
        put(self.loop, start.here)
        return branch

    def _check_prefix(self) -> None:
        """Raise a MavfiError if the flight so far differs from the golden flight."""
        if self._branch is not None:
            check_prefix(self.loop, self._golden.log)

    # ---- in a child: arms with detectors ----------------------------------------------------------------------------
    def _complete(self, child: ForkedChild) -> NoReturn:
        """Fly to the end, then under the detectors of the other arms, and report."""
        branch = self._branch
        assert branch is not None  # it flies
        if not (child.planned and self._watched):
            child.report(branch.fly().log, None)
        if child.comparable and child.case.how == WAITING:  # else checkpoints do not contain all: a node has died, e.g.
            branch.keeps_checkpoints = True
        without_detector = branch.fly()
        logs = {}
        for arm in self._watched:
            with suppress(Exception, SystemExit):  # the run is then flown on its own, where the error counts
                log = self._under_detector(without_detector, child.case, arm)
                if log is not None:
                    logs[arm.name] = log
        child.report(without_detector.log, None, logs)

    def _under_detector(self, without_detector: KnownFlight, case: FaultCase, arm: FlownArm) -> FlightLog | None:
        """The log of a completed flight of this child under the detector of an arm; None = it must be flown."""
        golden = self._watched_golden[arm.name]
        plain = self._plain_golden
        rows = self._checkpoint_before(plain, case)
        if not self._is_plain(golden, rows):
            return None

        # Begin at the checkpoint before the fault.
        start = golden.checkpoints[rows]
        branch = FlightBranch(self._forward, arm, start, golden, [without_detector, plain], golden)

        # Up to the first checkpoint after the fault there is none to continue from at an alarm.
        first_rows = min(without_detector.checkpoints, default=None)
        first = without_detector.end
        if first_rows is not None:
            first = without_detector.checkpoints[first_rows]
        if not branch.append_unless_alarm(without_detector, plain.checkpoints[rows], first):
            return None

        # From there, follow the completed flight as far as the detector raises no alarm.
        if first_rows is not None:
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
        plain = self._plain_golden
        if not golden.shares_instant(plain, rows):
            return False
        calls = len(self.loop.record.calls)  # these come first in the counts
        return golden.checkpoints[rows].counts[:calls] == plain.checkpoints[rows].counts[:calls]
