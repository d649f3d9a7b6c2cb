"""The host `firmware`: missions flown by a real firmware, with faults in its registers, or in sensors and motors."""

from collections.abc import Mapping

from mavfi.bridges.firmware.build import installed
from mavfi.bridges.firmware.flight import fly
from mavfi.errors import BadInputError
from mavfi.faults.fault import RegisterFault
from mavfi.faults.sensor.fault import SensorFault
from mavfi.hosts.host import ArmFlights, ArmSetup, Flight
from mavfi.hosts.loop.compose import resolve
from mavfi.mission import MissionSpec, Scenario

CONTROLLERS = ("betaflight",)
"""Flight controllers that are firmware."""


class FirmwareHost:
    """Flies each mission in this process, in lock-step with the firmware's process."""

    name = "firmware"
    levels: frozenset[str] = frozenset({RegisterFault.level, SensorFault.level})
    deterministic = True
    flies = True
    in_process = True

    def resolve(self, spec: MissionSpec) -> Scenario:
        """See `Host.resolve`.

        Raises:
            BadInputError: The flight controller is no firmware.
        """
        if spec.flight_controller not in CONTROLLERS:
            allowed = ", ".join(CONTROLLERS)
            raise BadInputError(f"host firmware: flight_controller: {spec.flight_controller!r}: allowed: {allowed}")
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
            setup.scenario, fault, self._detector(arm), recovery=setup.recovery, profile=profile,
            observers=setup.observers,
        )  # fmt: skip
