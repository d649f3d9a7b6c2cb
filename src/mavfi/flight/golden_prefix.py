"""Golden flights stopped early: each is a prefix, and must be identical to the start of the complete golden flight."""

from collections.abc import Callable

import numpy as np

from mavfi.errors import MavfiError
from mavfi.flight.host import Flight
from mavfi.flight.loop import Loop
from mavfi.record import FlightLog


def fly_until(loop: Loop, enough: Callable[[], bool]) -> Flight | None:
    """Fly a loop from its start until `enough` (evaluated after each control period) is true; None = stopped early."""
    loop.begin()
    while loop.status is None and not enough():
        loop.run(len(loop.record.rows) + 1)
    return None if loop.status is None else loop.flight()


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
