"""The host `firmware`: missions flown by a real flight controller's firmware, with faults in its registers."""

from collections.abc import Iterator, Mapping, Sequence

from mavfi.bridges.firmware.build import installed
from mavfi.bridges.firmware.flight import fly
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, RegisterFault
from mavfi.hosts.host import ArmFlights, ArmSetup, Flight
from mavfi.hosts.loop.compose import resolve
from mavfi.mission import MissionSpec, Scenario

CONTROLLERS = ("betaflight",)
"""Flight controllers that are firmware."""


class FirmwareHost:
    """Flies each mission in this process, with the firmware as a process of its own in lock-step."""

    name = "firmware"
    levels = frozenset({RegisterFault.level})
    deterministic = True
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
        return FirmwareFlights(arms)


class FirmwareFlights(ArmFlights):
    """The flights of one mission; see `MissionFlights`."""

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Flight | Exception]]:
        """See `MissionFlights.injected`; flown sequentially."""
        for place, (arm, fault) in enumerate(runs):
            try:
                if not isinstance(fault, RegisterFault):
                    raise BadInputError(f"host firmware: faults of level {fault.level!r}: allowed: register")
                yield place, self._fly(arm, fault)
            except Exception as error:  # noqa: BLE001 - ends this run only
                yield place, error

    def _fly(self, arm: str, fault: Fault | None, *, profile: bool = False) -> Flight:
        setup = self._arms[arm]
        own = fault if isinstance(fault, RegisterFault) else None
        return fly(setup.scenario, own, self._detector(arm), recovery=setup.recovery, profile=profile)
