"""Completed flights of a mission that other flights of it may follow, and the arms that fly them."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.errors import MavfiError
from mavfi.flight.checkpoints import Checkpoint
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.loop import CONTROL_PERIOD_US, Loop
from mavfi.flight.taps import CHECKED_AT_PRODUCER
from mavfi.record import FlightLog
from mavfi.states import STATES, State, differing_rows


@dataclass(frozen=True, slots=True, eq=False)
class FlownArm:
    """Detector (None = none) and recovery policy of a flight; a name always stands for the same two."""

    name: str = ""
    detector: Detector | None = None
    recovery: RecoveryPolicy = INLINE

    @property
    def takes_part(self) -> bool:
        """Whether the detector acts without an alarm, or answers one depending on earlier events besides its alarms.

        It seals values before they are published, has unreadable ones sent again, has steps computed twice, or waits
        for answers and restarts nodes.  Any other has no effect up to its first alarm, and the publications of a
        flight are all that it needs.
        """
        detector = self.detector
        if detector is None:
            return False
        return self.recovery.remembers or self.recovery.resends or detector.seals or bool(detector.duplicates)

    def checks_before_injector(self, state: str) -> bool:
        """Whether the detector checks values of a state before they are corrupted: not as flights publish them."""
        if self.detector is None:
            return False
        return STATES[state].stage in CHECKED_AT_PRODUCER[self.recovery.detector_place]


NO_DETECTOR = FlownArm()


@dataclass(frozen=True, slots=True, eq=False)
class KnownFlight:
    """A completed flight.

    Attributes:
        log: Its log.
        rows: Rows of the log.
        publications: Publications with their instants (us), in order; empty if it has no checkpoints.
        checkpoints: Checkpoints by number of rows before them.
        end: Its end.
    """

    log: FlightLog
    rows: list[np.ndarray]
    publications: list[tuple[State, int]]
    checkpoints: dict[int, Checkpoint]
    end: Checkpoint

    def shares_instant(self, other: "KnownFlight", rows: int) -> bool:
        """Whether both flights are in the same state at `rows`: checkpoints of equal states hold the same instant."""
        here = self.checkpoints.get(rows)
        there = other.checkpoints.get(rows)
        return here is not None and there is not None and here.instant is there.instant

    def before(self, time_us: int) -> int:
        """Number of rows of the last checkpoint before an instant (us); 0 if there is none."""
        return max((rows for rows in self.checkpoints if rows * CONTROL_PERIOD_US < time_us), default=0)

    def pieces(self, rows: int) -> Iterator[tuple[Checkpoint, Checkpoint]]:
        """Pairs of consecutive checkpoints from `rows` on, up to the end."""
        later = [self.checkpoints[number] for number in sorted(self.checkpoints) if number >= rows]
        return pairwise([*later, self.end])


def check_prefix(loop: Loop, golden: FlightLog) -> None:
    """Check that a loop has flown the start of a golden flight, bit for bit, and the whole if it has ended.

    Raises:
        MavfiError: The flights differ.
    """
    rows = np.asarray(loop.record.rows)
    same = rows.tobytes() == golden.rows[: len(rows)].tobytes()
    if loop.status is not None:
        same = same and loop.status is golden.status and len(rows) == len(golden.rows)
    if not same:
        raise MavfiError("two golden flights of one mission differ: no fault can be addressed")


def check_repetition(golden: FlightLog, repeated: FlightLog, custom_parts: str) -> None:
    """Check that a golden flight with custom parts was flown a second time as the first one, with the same alarms.

    Args:
        golden: The golden flight.
        repeated: Its repetition from take-off.
        custom_parts: Names of the custom parts, for the message.

    Raises:
        MavfiError: The flights differ; the message says from when on, or in which alarms.
    """
    count = min(len(golden.rows), len(repeated.rows))
    differing = differing_rows(golden.rows[:count], repeated.rows[:count])
    if len(differing):
        difference = f"from {golden.rows[differing[0]][0]:.2f} s on"
    elif len(golden.rows) != len(repeated.rows) or golden.status is not repeated.status:
        difference = f"from {golden.rows[count - 1][0]:.2f} s on"
    elif repr(golden.alarms) != repr(repeated.alarms):
        difference = f"in their alarms ({len(golden.alarms)}, then {len(repeated.alarms)})"
    else:
        return
    raise MavfiError(
        f"two flights without a fault differ {difference}, so no effect of a fault can be told; custom: "
        f"{custom_parts}; allowed: random numbers from the seed; memory in attributes, which a detector changes in "
        "`accept` alone"
    )
