"""One mission flown by a firmware, with a fault in its registers, or in sensors and motors; bit-reproducible."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

from mavfi.bridges.firmware.controller import BetaflightController
from mavfi.bridges.firmware.injector import NODE, WALK, FirmwareInjector
from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import RegisterFault
from mavfi.faults.sensor.fault import SensorFault
from mavfi.flight_log import FlightLog, KernelEffect
from mavfi.flight_record import CONTROLLER_LOST
from mavfi.hosts.host import Flight
from mavfi.hosts.loop.assemble import new_loop, watch
from mavfi.hosts.loop.recovery import INLINE, Recovery
from mavfi.hosts.loop.sensor_faults import inject_sensor_fault
from mavfi.mission import Scenario
from mavfi.sim.controller import find_controller


def register_fault(time_us: int, seed: int, registers: str = "all", **given: Any) -> RegisterFault:  # noqa: ANN401
    """A fault in a register of the firmware's main thread, from an instant of the flight on (us)."""
    return RegisterFault(registers, node=NODE, time_us=time_us, seed=seed, **{"walk": WALK, **given})


def fly(
    scenario: Scenario, fault: RegisterFault | SensorFault | None = None, detector: Detector | None = None, *,
    recovery: Recovery = INLINE, profile: bool = False,
) -> Flight:  # fmt: skip
    """Fly one mission; equal arguments yield bit-identical results.

    A firmware that ends or hangs leaves the rotors without commands: the vehicle falls, the pipeline flies on.

    Args:
        scenario: The mission; its flight controller is a firmware.
        fault: The fault; None = golden flight.
        detector: The detector; None = none.
        recovery: The recovery policy for its alarms.
        profile: Whether to record the publication times of each state.

    Raises:
        BadInputError: Another flight controller, or the scenario cannot be flown.
    """
    made: Any = find_controller(scenario.flight_controller)
    if not issubclass(made, BetaflightController):
        text = "has no registers of its own; allowed: betaflight"
        raise BadInputError(f"flight_controller: {scenario.flight_controller}: {text}")
    loop = new_loop(scenario, profile=profile)
    try:
        controller = cast(BetaflightController, getattr(loop.plant, "controller", None))
        if fault is not None and not inject_sensor_fault(loop, fault):
            controller.injector = FirmwareInjector(cast(RegisterFault, fault))

        def note_end(now: int) -> None:
            if controller.lost is not None and CONTROLLER_LOST not in {event.kind for event in loop.record.events}:
                loop.record.note(
                    now, CONTROLLER_LOST, {"effect": controller.lost.effect, "why": controller.lost.detail}
                )

        loop.before_tick.append(note_end)
        watch(loop, detector, recovery)
        flight = loop.fly()
    finally:
        loop.plant.close()
    return replace(flight, log=_with_fault(flight, controller), extra=_extra(controller))


def _with_fault(flight: Flight, controller: BetaflightController) -> FlightLog:
    """The flight's log, with the injection and the end of the firmware."""
    lost, injector = controller.lost, controller.injector
    return replace(
        flight.log,
        injections=[*flight.log.injections, *([] if injector is None else [injector.record()])],
        kernel=None if lost is None else KernelEffect(lost.effect, lost.detail),
    )


def _extra(controller: BetaflightController) -> Mapping[str, Any]:
    return {"node": NODE, "most_calls": controller.most_calls}
