"""One in-process flight with all its publications, for faults of every level of the host."""

from mavfi.detectors.detector import Detector
from mavfi.faults.fault import Fault, InstructionFault
from mavfi.flight.case import Published
from mavfi.flight.decide import INLINE, Recovery
from mavfi.flight.fly import fly
from mavfi.flight.forks import fly_with_publications
from mavfi.flight.host import Flight, require_level
from mavfi.flight.mission_flights import LocalHost
from mavfi.mission import Scenario
from mavfi.states import State


def fly_recorded(
    scenario: Scenario, fault: Fault | None = None, detector: Detector | None = None, recovery: Recovery = INLINE
) -> tuple[Flight, list[Published]]:
    """Fly one mission; also returns the publications as received by consumers, in order.

    Raises:
        BadInputError: The scenario cannot be flown, or the fault is of another level.
    """
    if isinstance(fault, InstructionFault):
        return fly_with_publications(scenario, fault, detector, recovery)
    if fault is not None:
        require_level(LocalHost(), fault.level)
    seen: list[Published] = []

    def note(state: State, time_us: int) -> None:
        seen.append((state.copy(), time_us))

    return fly(scenario, fault, detector, recovery=recovery, recorders=(note,)), seen
