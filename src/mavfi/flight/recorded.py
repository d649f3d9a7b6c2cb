"""One in-process flight with all its publications, for faults of every level of the host."""

from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, InstructionFault
from mavfi.flight.case import Published
from mavfi.flight.decide import INLINE, Recovery
from mavfi.flight.fly import LocalFault, fly
from mavfi.flight.forks import fly_with_publications
from mavfi.flight.host import Flight
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
    if not isinstance(fault, LocalFault | None):
        raise BadInputError(f"host local: faults of level {fault.level!r}: allowed: state, memory, instruction, sensor")
    seen: list[Published] = []

    def note(state: State, time_us: int) -> None:
        seen.append((state.copy(), time_us))

    return fly(scenario, fault, detector, recovery=recovery, recorders=(note,)), seen
