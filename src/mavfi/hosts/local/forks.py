"""Instruction faults of one mission, forked off golden flights at their last checkpoint before each fault.

The records are those of `hosts.instruction.fly_instruction_faults`, which flies from take-off: an injected run branches
off at its call, and ends where it converges to a known flight, see `hosts.local.fast_forward`.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.faults.fault import InstructionFault
from mavfi.faults.instruction.plan import changed_nothing
from mavfi.flight_log import FlightLog
from mavfi.hosts.host import Flight
from mavfi.hosts.instruction.case import WAITING, Case, flight_of
from mavfi.hosts.instruction.forking import Child, Forks
from mavfi.hosts.local.branch import Branch, Track
from mavfi.hosts.local.checkpoints import fill, put
from mavfi.hosts.local.fast_forward import FastForward
from mavfi.hosts.loop.golden_prefix import GoldenPrefix, prefix_of
from mavfi.hosts.loop.policy import INLINE, Recovery
from mavfi.hosts.loop.restarts import Restarts


@dataclass(frozen=True, slots=True)
class WatchedArm:
    """An arm of the same mission with a detector."""

    detector: Detector
    recovery: Recovery
    golden: Flight


@dataclass(frozen=True, slots=True)
class InjectedRuns:
    """Injected runs of an arm, in the order of the faults, and of other arms as far as they follow from them.

    `watched` has the latter by arm and by place of the fault.
    """

    flights: list[Flight]
    watched: dict[str, dict[int, Flight]]


def fly_from_checkpoints(
    forward: FastForward, faults: Sequence[InstructionFault], golden: Flight, detector: Detector | None = None,
    arm: str = "", recovery: Recovery = INLINE, watched: Mapping[str, WatchedArm] | None = None,
) -> InjectedRuns:  # fmt: skip
    """Fly one mission with each of several faults in instructions of its kernels.

    Args:
        forward: All flights of this mission, with scratch.
        faults: As for `fly_instruction_faults`; none in a detector.
        golden: The golden flight with this detector.
        detector: As for `FastForward.fly`.
        arm: As for `FastForward.fly`.
        recovery: As for `FastForward.fly`.
        watched: Arms of the same mission with detectors, by name, if this one has none.

    Raises:
        MismatchError: A fault was sampled for different machine code.
        BadInputError: The mission lacks the kernel.
        MavfiError: Two golden flights differ.
    """
    forks = ForksFromCheckpoints(forward, faults, detector, arm, recovery, watched or {})
    with np.errstate(all="ignore"):  # overflow of corrupted values is expected behaviour
        forks.fly(golden)
    return InjectedRuns([flight_of(case, golden) for case in forks.cases], forks.followed())


class ForksFromCheckpoints(Forks):
    """Forks off the golden flight of an arm; arguments as of `fly_from_checkpoints`.

    An injected run with a detector equals the one without up to its first alarm.  So the child of the run without a
    detector shows its publications to the detectors of the other arms, too, and continues these runs at the checkpoint
    before an alarm.  A run is flown on its own if its golden flight differs before the fault, or at an alarm before the
    first checkpoint after the fault, or at any alarm if checkpoints do not contain what the fault changed.
    """

    def __init__(
        self, forward: FastForward, faults: Sequence[InstructionFault], detector: Detector | None, arm: str,
        recovery: Recovery, watched: Mapping[str, WatchedArm],
    ) -> None:  # fmt: skip
        super().__init__(forward.loop.scenario, faults, detector)
        self.loop = forward.loop
        self._forward, self._arm, self._recovery, self._watched = forward, arm, recovery, watched
        self._branch: Branch | None = None

    def restarts(self) -> Restarts:
        """See `Forks.restarts`; they know all publications since take-off."""
        assert self._branch is not None  # it flies
        restarts = Restarts(self.loop, self.loop.scenario.dead_node)
        for state, now in self._branch.shown:
            restarts.keep(state, now)
        return restarts

    def fly(self, golden: Flight) -> None:
        """Fly past all injected calls; does not return in children.

        Raises:
            MavfiError: The golden flight of the checkpoints differs from `golden`.
        """
        self._forward.recovery = self._recovery
        own = self._forward.golden(self._detector, self._arm)
        GoldenPrefix(own.log.rows, own.log.status).check(golden.log)
        for name, arm in self._watched.items():  # before the forks, so that children have them
            self._forward.recovery = arm.recovery
            known = self._forward.golden(arm.detector, name)
            GoldenPrefix(known.log.rows, known.log.status).check(arm.golden.log)
        self._forward.recovery = self._recovery
        with self._forking():
            self.run(lambda: self._fly(own))

    @contextmanager
    def _forking(self) -> Iterator[None]:
        """Let functions fork at their calls."""
        entries = {case.fault.entry for case in self.cases if case.fault.has_site}
        for name in entries:
            self._forward.functions[name].forks = self
        self.loop.after_step.append(self.stepped)
        try:
            yield
        finally:
            self.loop.after_step.remove(self.stepped)
            self.loop.taps.recorders.clear()
            for name in entries:
                self._forward.functions[name].forks = None

    def _fly(self, own: Track) -> None:
        record = self.loop.record
        while waiting := [case for case in self.cases if case.fault.has_site and case.how == WAITING]:
            start = min(self._start(own, case) for case in waiting)
            if self._branch is None or start > len(record.rows):
                self._check_prefix(own)
                self._branch = self._jump(own, start)
                fill(self.loop, {case.kernel for case in waiting})
            elif self.loop.status is not None:
                break  # no call with such a bit came any more
            self.loop.run(len(record.rows) + 1)
            if self.child is not None:
                self._complete(self.child)
        self._check_prefix(own)

    # ---- arms with detectors ----------------------------------------------------------------------------------------
    def _complete(self, child: Child) -> NoReturn:
        """In a child: fly to the end, then under the detectors of the other arms, and report."""
        assert self._branch is not None  # it flies
        if not (child.planned and self._watched):
            self.report(self._branch.fly().log)
        if child.comparable and child.case.how == WAITING:  # else checkpoints do not contain all: a node has died, e.g.
            self._branch.keep_from_now_on()
        track, logs = self._branch.fly(), {}
        for name, arm in self._watched.items():
            with suppress(Exception, SystemExit):  # the run is then flown on its own, where the error counts
                log = self._under(track, child.case, name, arm)
                if log is not None:
                    logs[name] = log
        self.report(track.log, logs)

    def _under(self, track: Track, case: Case, name: str, arm: WatchedArm) -> FlightLog | None:
        """The log of a completed flight of this child under the detector of an arm; None = it must be flown."""
        forward = self._forward
        own, plain = forward.golden(arm.detector, name), forward.golden()
        rows = self._start(plain, case)
        if not self._is_plain(own, rows):
            return None
        forward.recovery = arm.recovery
        branch, start = Branch(forward, arm.detector, [track, plain], own), own.checkpoints[rows]
        branch.begin(own, start)
        branch.remember(start.detector)
        first = min(track.checkpoints, default=None)
        there = track.end if first is None else track.checkpoints[first]
        if not branch.append_unless_alarm(track, plain.checkpoints[rows], there):
            return None
        if first is not None:
            self.loop.taps.injector = there.injector.copy()
            branch.follow(track, first)
        return branch.fly().log

    def followed(self) -> dict[str, dict[int, Flight]]:
        """Runs of the other arms that are known, by arm and by place of the case."""
        found: dict[str, dict[int, Flight]] = {name: {} for name in self._watched}
        for place, case in enumerate(self.cases):
            report = case.report
            if report is None or changed_nothing(case.value):  # with a detector, a later call may have such a bit
                continue
            for name, arm in self._watched.items():
                if report.log is None and self._ends_as_golden(case, name, arm):
                    found[name][place] = flight_of(case, arm.golden)
                elif name in report.watched:
                    own = replace(case, report=replace(report, log=report.watched[name]))
                    found[name][place] = flight_of(own, arm.golden)
        return found

    def _ends_as_golden(self, case: Case, name: str, arm: WatchedArm) -> bool:
        """Whether a call without effect is the same one under the detector of an arm: the flight is golden then."""
        own, rows = self._forward.golden(arm.detector, name), self._start(self._forward.golden(), case)
        before = [alarm for alarm in own.log.alarms if round(1e6 * alarm.time_s) <= case.time_us]
        return self._is_plain(own, rows) and len(before) == len(own.checkpoints[rows].alarms)

    def _is_plain(self, own: Track, rows: int) -> bool:
        """Whether a golden flight with a detector has the state, and the calls, of the one without at a checkpoint."""
        plain, here = self._forward.golden().checkpoints[rows], own.checkpoints.get(rows)
        calls = len(self.loop.record.calls)  # these come first in the counts
        return here is not None and here.instant is plain.instant and here.counts[:calls] == plain.counts[:calls]

    # ---- the golden flight ------------------------------------------------------------------------------------------
    def _start(self, own: Track, case: Case) -> int:
        """Number of rows of the last checkpoint before the injected call."""
        place = list(self.loop.record.calls).index(case.fault.entry)  # calls come first in the counts
        return max(rows for rows, checkpoint in own.checkpoints.items() if checkpoint.counts[place] <= case.call)

    def _jump(self, own: Track, rows: int) -> Branch:
        """Continue the golden flight at a checkpoint."""
        plain, start = self._forward.golden(), own.checkpoints[rows]
        branch = Branch(self._forward, self._detector, [plain], own, shows=True)
        branch.comparable = lambda: self.child is not None and self.child.comparable and not self.loop.down
        branch.begin(own, start)
        self.loop.taps.injector = start.injector.copy()
        branch.remember(start.detector)
        put(self.loop, start.here)
        return branch

    def _check_prefix(self, own: Track) -> None:
        """Raise a MavfiError if the flight so far differs from the golden flight."""
        if self._branch is not None:
            prefix_of(self.loop).check(own.log)
