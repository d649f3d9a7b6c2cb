"""Flies one mission with each of a number of faults in instructions."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.faults.fault import InstructionFault
from mavfi.hosts.host import Flight
from mavfi.hosts.instruction.case import flight_of
from mavfi.hosts.instruction.forking import Forks
from mavfi.hosts.loop.recovery import INLINE, Recovery
from mavfi.mission import Scenario


@dataclass(frozen=True, slots=True)
class InjectedFlights:
    """Flights with faults in instructions.

    Attributes:
        golden: The flight without a fault; its pipeline is also that of the others.
        flights: With the faults, in their order.  `log.kernel` is the effect on the kernel; where it crashed, hung or
            raised, the log is that of the flight under the mission's policy for dead nodes.
    """

    golden: Flight
    flights: list[Flight]


def fly_instruction_faults(
    scenario: Scenario, faults: Sequence[InstructionFault], detector: Detector | None = None,
    golden: Flight | None = None, recovery: Recovery = INLINE,
) -> InjectedFlights:  # fmt: skip
    """Fly one mission with each of a number of faults in instructions: they fork from one golden flight.

    Args:
        scenario: The mission.
        faults: See `mavfi.campaign.samplers.instruction`.
        detector: What watches; None = nothing.
        golden: The flight of this mission without a fault, with this detector, if it has been flown: then the golden
            flight stops once all faults have been injected.
        recovery: Answer to alarms of the detector.

    Raises:
        MismatchError: A fault belongs to other machine code.
        BadInputError: The scenario cannot be flown, or it has no such kernel.
        MavfiError: The golden flight is another one.
    """
    with np.errstate(all="ignore"):  # corrupted values may overflow; that is data, not an error
        forks = Forks(scenario, faults, detector, recovery)
        if golden is None:
            return InjectedFlights(*forks.fly_all())
        prefix, cases = forks.fly_to_injections()
    prefix.check(golden.log)
    return InjectedFlights(golden, [flight_of(case, golden) for case in cases])
