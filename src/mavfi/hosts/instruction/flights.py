"""Flies one mission with each of a number of faults in instructions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.faults.fault import InstructionFault
from mavfi.faults.instruction.plan import is_in_data
from mavfi.hosts.host import Flight
from mavfi.hosts.instruction.case import case_of, flight_of
from mavfi.hosts.instruction.forking import Forks
from mavfi.hosts.instruction.template import fly_from_template
from mavfi.hosts.loop.recovery import Coupling
from mavfi.mission import Scenario


@dataclass(frozen=True, slots=True)
class InjectedFlights:
    """Flights with faults in instructions.

    Attributes:
        golden: The flight without a fault; its pipeline is also that of the others.
        flights: With the faults, in their order.  `log.kernel` is the effect on the kernel; where it crashed, hung or
            raised, the log is that of the flight in which its node was restarted.
    """

    golden: Flight
    flights: list[Flight]


def fly_instruction_faults(
    scenario: Scenario, faults: Sequence[InstructionFault], detector: Detector | None = None,
    golden: Flight | None = None, coupling: Coupling = "inline",
) -> InjectedFlights:  # fmt: skip
    """Fly one mission with each of a number of faults in instructions.

    Faults in data fork from one golden flight of this process. Others may access any memory, so each of these flights
    is forked from a template, see `mavfi.hosts.instruction.template`: it gives the same bytes in every process, if
    addresses can be fixed; the record says so (`replayable`).

    Args:
        scenario: The mission.
        faults: See `mavfi.campaign.samplers.instruction`.
        detector: What watches; None = nothing.
        golden: The flight of this mission without a fault, with this detector, if it has been flown: then golden
            flights stop once all faults have been injected.
        coupling: Of the detector: "inline" or "observer".

    Raises:
        MismatchError: A fault belongs to other machine code.
        BadInputError: The scenario cannot be flown, or it has no such kernel.
        MavfiError: The golden flight is another one.
    """
    own = [fault for fault in faults if is_in_data(fault)]
    in_data: Iterator[Flight] = iter(())
    if golden is None or own:
        with np.errstate(all="ignore"):  # corrupted values may overflow; that is data, not an error
            forks = Forks(scenario, own, detector, coupling)
            if golden is None:
                golden, flights = forks.fly_all()
            else:
                prefix, cases = forks.fly_to_injections()
                prefix.check(golden.log)
                flights = [flight_of(case, golden) for case in cases]
        in_data = iter(flights)
    return InjectedFlights(
        golden,
        [
            next(in_data) if is_in_data(fault) else _from_template(scenario, fault, detector, golden, coupling)
            for fault in faults
        ],
    )


def _from_template(
    scenario: Scenario, fault: InstructionFault, detector: Detector | None, golden: Flight, coupling: Coupling
) -> Flight:  # fmt: skip
    case_of(fault, scenario)  # refuses what cannot be injected
    prefix, case = fly_from_template(scenario, fault, detector, coupling)
    prefix.check(golden.log)
    return flight_of(case, golden)
