"""A requested flight, and the flights that it is compared with."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from mavfi.outcomes import Effect, effect_of

if TYPE_CHECKING:
    from mavfi.faults.fault import Fault
    from mavfi.flight.host import Flight
    from mavfi.mission import Scenario
    from mavfi.record import FlightLog, FlightRecord


@dataclass(frozen=True)
class ComparedFlights:
    """A flight, with its golden run and its twin without a detector.

    Attributes:
        scenario: The mission.
        flight: The requested flight.
        golden: Its golden run with the same detector; None = the flight itself is golden.
        fault: The injected fault; None = no fault.
        detector: Name and profile, e.g. "gaussian (paper)"; "" = no detector.
        unwatched: The flight with the same fault, without the detector and its mission keys; None without a detector or
            a fault, and for faults in the detector itself.
    """

    scenario: Scenario
    flight: Flight
    golden: Flight | None = None
    fault: Fault | None = None
    detector: str = ""
    unwatched: Flight | None = None

    @property
    def log(self) -> FlightLog:
        """Log of the flight."""
        return self.flight.log

    @cached_property
    def record(self) -> FlightRecord:
        """Record of the flight, as in a ledger."""
        return self.flight.record()

    @cached_property
    def golden_record(self) -> FlightRecord | None:
        """Record of the golden run, as in a ledger; None if the flight itself is golden."""
        if self.golden is None:
            return None
        return self.golden.record()

    @property
    def effect(self) -> Effect | None:
        """Effect of the fault on the flight; None if the flight itself is golden."""
        if self.golden_record is None:
            return None
        return effect_of(self.golden_record, self.record)
