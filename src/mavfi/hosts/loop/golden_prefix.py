"""Golden flights stopped early: each is a prefix, and must be identical to the start of the complete golden flight."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mavfi.errors import MavfiError
from mavfi.flight_log import FlightLog
from mavfi.hosts.host import Flight
from mavfi.hosts.loop.scheduler import Loop
from mavfi.mission import MissionStatus


@dataclass(frozen=True, slots=True)
class GoldenPrefix:
    """A possibly truncated flight: its rows, as in a flight log, and its status (None = truncated)."""

    rows: np.ndarray
    status: MissionStatus | None

    def check(self, golden: FlightLog) -> None:
        """Check that a golden flight starts bit-identically and, unless this one is truncated, ends identically.

        Raises:
            MavfiError: The flights differ.
        """
        ended = self.status is not None
        same_end = self.status is golden.status and len(self.rows) == len(golden.rows)
        if self.rows.tobytes() != golden.rows[: len(self.rows)].tobytes() or (ended and not same_end):
            raise MavfiError("two golden flights of one mission differ: no fault can be addressed")


def fly_until(loop: Loop, enough: Callable[[], bool]) -> Flight | None:
    """Fly a loop from its start until `enough` (evaluated after each control period) is true; None = stopped early."""
    loop.begin()
    while loop.status is None and not enough():
        loop.run(len(loop.record.rows) + 1)
    return None if loop.status is None else loop.flight()


def prefix_of(loop: Loop) -> GoldenPrefix:
    """The part of the flight that a loop has flown so far."""
    return GoldenPrefix(np.asarray(loop.record.rows), loop.status)
