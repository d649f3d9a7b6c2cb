"""Instruction faults of one mission, forked off golden flights at their last checkpoint before each fault.

The records are those of `hosts.instruction.fly_instruction_faults`, which flies from take-off: an injected run branches
off at its call, and ends where it converges to a known flight, see `hosts.local.fast_forward`.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.faults.fault import InstructionFault
from mavfi.hosts.host import Flight
from mavfi.hosts.instruction.case import WAITING, Case, flight_of
from mavfi.hosts.instruction.forking import Forks
from mavfi.hosts.local.checkpoints import fill, put
from mavfi.hosts.local.fast_forward import Branch, FastForward, Track
from mavfi.hosts.loop.golden_prefix import GoldenPrefix, prefix_of
from mavfi.hosts.loop.recovery import INLINE, Recovery
from mavfi.hosts.loop.restarts import Restarts


def fly_from_checkpoints(
    forward: FastForward, faults: Sequence[InstructionFault], golden: Flight, detector: Detector | None = None,
    arm: str = "", recovery: Recovery = INLINE,
) -> list[Flight]:  # fmt: skip
    """Fly one mission with each of several faults in instructions of its kernels.

    Args:
        forward: All flights of this mission, with scratch.
        faults: As for `fly_instruction_faults`; none in a detector.
        golden: The golden flight with this detector.
        detector: As for `FastForward.fly`.
        arm: As for `FastForward.fly`.
        recovery: As for `FastForward.fly`.

    Raises:
        MismatchError: A fault was sampled for different machine code.
        BadInputError: The mission lacks the kernel.
        MavfiError: Two golden flights differ.
    """
    forks = ForksFromCheckpoints(forward, faults, detector, arm, recovery)
    with np.errstate(all="ignore"):  # overflow of corrupted values is expected behaviour
        forks.fly(golden)
    return [flight_of(case, golden) for case in forks.cases]


class ForksFromCheckpoints(Forks):
    """Forks off the golden flight of an arm; arguments as of `fly_from_checkpoints`."""

    def __init__(
        self, forward: FastForward, faults: Sequence[InstructionFault], detector: Detector | None, arm: str,
        recovery: Recovery,
    ) -> None:  # fmt: skip
        super().__init__(forward.loop.scenario, faults, detector)
        self.loop = forward.loop
        self._forward, self._arm, self._recovery = forward, arm, recovery
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
                self.report(self._branch.fly().log)
        self._check_prefix(own)

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
