"""The host `firmware`: missions flown by a real firmware, with faults in its registers, or in sensors and motors.

Flights are bit-reproducible.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, cast

from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.extras.firmware.build import installed
from mavfi.extras.firmware.controller import BetaflightController
from mavfi.extras.firmware.injector import NODE, WALK, FirmwareInjector
from mavfi.extras.firmware.tracking import Tracking
from mavfi.extras.registers.fault import RegisterFault
from mavfi.flight.compose import new_loop, resolve, watch
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.host import ArmFlights, ArmSetup, Flight, Host
from mavfi.flight.loop import Listener, LoopRecord
from mavfi.levels.sensor.fault import SensorFault
from mavfi.levels.sensor.injector import inject_sensor_fault
from mavfi.mission import MissionSpec, Scenario
from mavfi.outcomes import ControlErrors
from mavfi.record import CONTROLLER_LOST, KernelEffect
from mavfi.rewriting import check_flown

CONTROLLERS = ("betaflight",)
"""Flight controllers that are firmware."""


class FirmwareHost(Host):
    """Flies each mission in this process, in lock-step with the firmware's process."""

    name = "firmware"
    levels: frozenset[str] = frozenset({RegisterFault.level, SensorFault.level})
    single_levels = frozenset({RegisterFault.level})
    in_process = True

    def resolve(self, spec: MissionSpec) -> Scenario:
        """See `Host.resolve`.

        Raises:
            BadInputError: The flight controller is no firmware, or the detector is not at the consumer.
        """
        if spec.flight_controller not in CONTROLLERS:
            allowed = ", ".join(CONTROLLERS)
            raise BadInputError(f"host firmware: flight_controller: {spec.flight_controller!r}: allowed: {allowed}")
        if spec.detector_place != "consumer":
            place = spec.detector_place
            raise BadInputError(f"host firmware: detector_place: {place!r}: no publication changes; allowed: consumer")
        return resolve(spec)

    def check(self) -> None:
        """See `Host.check`.

        Raises:
            BadInputError: The firmware, or the compiler for our part of it, is missing.
        """
        installed()

    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> "FirmwareFlights":
        """See `Host.mission`; every flight is flown in full."""
        return FirmwareFlights(self, arms)


class FirmwareFlights(ArmFlights):
    """The flights of one mission; see `MissionFlights`."""

    def _fly(self, arm: str, fault: RegisterFault | SensorFault | None, *, profile: bool = False) -> Flight:
        setup = self._arms[arm]
        return fly(
            setup.scenario,
            fault,
            self._detector(arm),
            recovery=setup.recovery,
            profile=profile,
            observers=setup.observers,
        )


# ---- one flight ----------------------------------------------------------------------------------------------------
def register_fault(time_us: int, seed: int, registers: str = "all", access: str = "either") -> RegisterFault:
    """A fault in a register of the firmware's main thread, from an instant of the flight on (us).

    By default as those of campaigns: a register that an instruction reads or writes.
    """
    return RegisterFault(registers, access, node=NODE, time_us=time_us, seed=seed, walk=WALK)


def fly(
    scenario: Scenario,
    fault: RegisterFault | SensorFault | None = None,
    detector: Detector | None = None,
    *,
    recovery: RecoveryPolicy = INLINE,
    profile: bool = False,
    observers: Sequence[Listener] = (),
) -> Flight:
    """Fly one mission; equal arguments yield bit-identical results.

    If the firmware ends or hangs, the rotors receive no commands: the vehicle falls, the pipeline continues.

    Args:
        scenario: The mission; its flight controller is a firmware.
        fault: The fault; None = golden flight.
        detector: The detector; None = none.
        recovery: The recovery policy for its alarms.
        profile: Whether to record the publication times of each state.
        observers: Take part in the flight.

    Raises:
        BadInputError: Another flight controller, or the scenario cannot be flown.
    """
    loop = new_loop(scenario, profile=profile)
    try:
        controller = getattr(loop.plant, "controller", None)
        if not isinstance(controller, BetaflightController):
            text = "has no registers of its own; allowed: --flight-controller betaflight"
            raise BadInputError(f"flight controller {scenario.flight_controller}: {text}")
        if fault is None or not inject_sensor_fault(loop, fault):
            controller.tracking = Tracking()
            if fault is not None:
                loop.taps.injector = controller.injector = FirmwareInjector(cast(RegisterFault, fault))
        loop.listeners.append(_LossListener(loop.record, controller))
        watch(loop, detector, recovery)
        for observer in observers:
            loop.attach(observer)
        flight = loop.fly()
        check_flown(scenario.protection)
    finally:
        loop.plant.close()
    # The log has the end of the firmware, the record how well it followed.
    log = flight.log
    loss = controller.loss
    if loss is not None:
        log = replace(log, kernel=KernelEffect(loss.effect, loss.detail))
    extra = {"node": NODE, "most_calls": controller.most_calls, **_errors(controller, flight)}
    return replace(flight, log=log, extra=extra)


def _errors(controller: BetaflightController, flight: Flight) -> dict[str, Any]:
    """Entry of the record: how well the firmware followed its set-points from the fault on, or from the start."""
    if controller.tracking is None:
        return {}
    since = max((injection.time_s for injection in flight.log.injections if injection.activated), default=0.0)
    return {ControlErrors.KEY: asdict(controller.tracking.since(since))}


class _LossListener(Listener):
    """Records the end of the firmware, once."""

    def __init__(self, record: LoopRecord, controller: BetaflightController) -> None:
        self._record = record
        self._controller = controller

    def before_tick(self, now: int) -> None:
        """See `Listener`."""
        loss = self._controller.loss
        if loss is not None and all(event.kind != CONTROLLER_LOST for event in self._record.events):
            self._record.note(now, CONTROLLER_LOST, {"effect": loss.effect, "why": loss.detail})
