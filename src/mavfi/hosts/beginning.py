"""Golden flights that go on only until enough is known: how they began must be how the whole golden flight began."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mavfi.errors import MavfiError
from mavfi.flight_log import FlightLog
from mavfi.hosts.inprocess import Flight, Host
from mavfi.mission import MissionStatus


@dataclass(frozen=True, slots=True)
class Beginning:
    """A flight that may have been stopped before its end.

    Attributes:
        rows: As of a flight log, as far as it went.
        status: How it ended; None where it was stopped.
    """

    rows: np.ndarray
    status: MissionStatus | None

    def check(self, golden: FlightLog) -> None:
        """Make sure that a golden flight begins bit for bit like this one, and ended like it, if this one ended.

        Raises:
            MavfiError: It does not.
        """
        ended = self.status is not None
        same_end = self.status is golden.status and len(self.rows) == len(golden.rows)
        if self.rows.tobytes() != golden.rows[: len(self.rows)].tobytes() or (ended and not same_end):
            raise MavfiError("two golden flights of one mission differ: no fault can be addressed")


def fly_until(host: Host, enough: Callable[[], bool]) -> Flight | None:
    """Fly until it is enough, which is asked after each control period.

    Args:
        host: Of a flight that has not begun.
        enough: Whether to stop.

    Returns:
        The flight; None if it was stopped before the mission had a status.
    """
    host.begin()
    while host.status is None and not enough():
        host.run(len(host.rows) + 1)
    return None if host.status is None else host.flight()


def beginning_of(host: Host) -> Beginning:
    """What a host has flown."""
    return Beginning(np.asarray(host.rows), host.status)
