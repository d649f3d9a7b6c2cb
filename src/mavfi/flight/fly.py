"""One in-process flight, bit-reproducible."""

from collections.abc import Sequence
from dataclasses import replace

from mavfi.detectors.detector import Detector
from mavfi.faults.fault import MemoryFault, StateFault
from mavfi.faults.levels.sensor.fault import SensorFault
from mavfi.faults.levels.state_injector import StateInjector
from mavfi.flight.compose import new_loop, watch
from mavfi.flight.decide import INLINE, Recovery
from mavfi.flight.host import Flight
from mavfi.flight.loop import Listener
from mavfi.flight.memory_faults import MemoryInjector
from mavfi.flight.plant import MakePlant
from mavfi.flight.sensor_faults import inject_sensor_fault
from mavfi.flight.taps import Recorder
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.rewriting import check_flown
from mavfi.sim.simulator import Simulator

LocalFault = StateFault | MemoryFault | SensorFault
"""Faults of one flight; those in instructions share theirs."""


def fly(  # noqa: PLR0913 - each is independent
    scenario: Scenario, fault: LocalFault | None = None, detector: Detector | None = None, *,
    recovery: Recovery = INLINE, profile: bool = False, recorders: Sequence[Recorder] = (),
    functions: KernelFunctions = PLAIN, observers: Sequence[Listener] = (),
    make_plant: MakePlant = Simulator,
) -> Flight:  # fmt: skip
    """Fly one mission; equal arguments yield bit-identical results.

    Args:
        scenario: The mission.
        fault: The fault; None = golden flight.
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
    in_memory = MemoryInjector(loop, fault, detector) if isinstance(fault, MemoryFault) else None
    try:
        if isinstance(fault, StateFault):
            loop.taps.injector = StateInjector(fault)
            loop.watch_losses()
        loop.taps.injector = in_memory or loop.taps.injector
        inject_sensor_fault(loop, fault)
        watch(loop, detector, recovery)
        loop.taps.recorders.extend(recorders)
        for observer in observers:
            loop.attach(observer)
        flight = loop.fly()
        check_flown(scenario.protection)
    finally:
        loop.plant.close()
        if in_memory is not None:
            in_memory.release()
    if in_memory is not None and in_memory.effect is not None:
        flight.log = replace(flight.log, kernel=in_memory.effect)
    return flight
