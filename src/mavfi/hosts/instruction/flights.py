"""Flies one mission with each of several instruction faults."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.faults.fault import InstructionFault
from mavfi.hosts.host import Flight
from mavfi.hosts.instruction.case import Published, flight_of
from mavfi.hosts.instruction.forking import ForksFromTakeOff
from mavfi.hosts.loop.policy import INLINE, Recovery
from mavfi.mission import Scenario


@dataclass(frozen=True, slots=True)
class InjectedFlights:
    """Injected runs with instruction faults.

    Attributes:
        golden: The error-free flight; the injected runs share its pipeline.
        flights: One run per fault, in order.  `log.kernel` is the effect on the kernel; after a crash, hang or
            exception, the log is that of the flight under the mission's policy for dead nodes.
    """

    golden: Flight
    flights: list[Flight]


def fly_with_publications(
    scenario: Scenario, fault: InstructionFault, detector: Detector | None = None, recovery: Recovery = INLINE
) -> tuple[Flight, list[Published]]:
    """Fly one mission with an instruction fault; also returns its publications, in order.

    Raises the errors of `fly_instruction_faults`.
    """
    with np.errstate(all="ignore"):
        forks = ForksFromTakeOff(scenario, [fault], detector, recovery, record=True)
        _, (flight,) = forks.fly_all()
    report = forks.cases[0].report
    injected = None if report is None else report.published
    return flight, (forks.published or []) if injected is None else injected


def fly_instruction_faults(
    scenario: Scenario, faults: Sequence[InstructionFault], detector: Detector | None = None,
    golden: Flight | None = None, recovery: Recovery = INLINE,
) -> InjectedFlights:  # fmt: skip
    """Fly one mission with each of several instruction faults, all forked from one golden flight.

    Args:
        scenario: The mission.
        faults: See `mavfi.campaign.samplers.instruction`.
        detector: The detector; None = none.
        golden: The golden flight with this detector, if known: the golden flight here then stops after the last
            injection.
        recovery: The recovery policy for the detector's alarms.

    Raises:
        MismatchError: A fault was sampled for different machine code.
        BadInputError: The scenario cannot be flown, or the mission lacks the kernel.
        MavfiError: `golden` differs from the golden flight flown here.
    """
    with np.errstate(all="ignore"):  # overflow of corrupted values is expected behaviour
        forks = ForksFromTakeOff(scenario, faults, detector, recovery)
        if golden is None:
            return InjectedFlights(*forks.fly_all())
        prefix, cases = forks.fly_to_injections()
    prefix.check(golden.log)
    return InjectedFlights(golden, [flight_of(case, golden) for case in cases])
