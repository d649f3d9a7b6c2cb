"""One in-process flight, bit-reproducible."""

from collections.abc import Sequence
from dataclasses import replace

from mavfi.detectors.detector import Detector
from mavfi.faults.fault import Fault, find_level
from mavfi.faults.injector import Injector
from mavfi.flight.compose import new_loop, watch
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.host import Flight
from mavfi.flight.loop import Listener
from mavfi.flight.plant import MakePlant
from mavfi.flight.taps import Recorder
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.rewriting import check_flown
from mavfi.sim.simulator import Simulator


def fly(  # noqa: PLR0913 - each is independent
    scenario: Scenario,
    fault: Fault | None = None,
    detector: Detector | None = None,
    *,
    recovery: RecoveryPolicy = INLINE,
    profile: bool = False,
    recorders: Sequence[Recorder] = (),
    functions: KernelFunctions = PLAIN,
    observers: Sequence[Listener] = (),
    make_plant: MakePlant = Simulator,
) -> Flight:
    """Fly one mission; equal arguments yield bit-identical results.

    Args:
        scenario: The mission.
        fault: The fault, of a level that is injected in the loop; None = golden flight.
        detector: The detector; None = none.
        recovery: The recovery policy for its alarms.
        profile: Whether to record the publication times of each state.
        recorders: Called with each publication as consumers receive it.
        functions: Functions that kernels call: compiled or instrumented.
        observers: Take part in the flight.
        make_plant: Constructs the vehicle in its world.

    Raises:
        BadInputError: The scenario cannot be flown, e.g. the start lies in an obstacle, or its
            protection is for other code.
    """
    loop = new_loop(scenario, profile=profile, functions=functions, make_plant=make_plant)
    injector: Injector | None = None
    try:
        if fault is not None:
            injector = find_level(fault.level).inject(loop, fault, detector)
        watch(loop, detector, recovery)
        loop.taps.recorders.extend(recorders)
        for observer in observers:
            loop.attach(observer)
        flight = loop.fly()
        check_flown(scenario.protection)
    finally:
        loop.plant.close()
        if injector is not None:
            injector.release()
    if injector is not None and injector.effect is not None:
        flight.log = replace(flight.log, kernel=injector.effect)
    return flight
