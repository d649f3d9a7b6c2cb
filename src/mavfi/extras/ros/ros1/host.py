"""The host `ros1`: missions flown by ROS nodes in lock-step, bit-identical to flights of the host `local`."""

from collections.abc import Mapping
from typing import Any

from mavfi.errors import BadInputError
from mavfi.extras.ros.ros1 import finder
from mavfi.extras.ros.ros1.kernels import fly_begin
from mavfi.extras.ros.ros1.plan import Plan, check_supported
from mavfi.extras.ros.ros1.session import configure, fly, isolation
from mavfi.faults.fault import StateFault
from mavfi.faults.levels.sensor.fault import SensorFault
from mavfi.flight.compose import resolve
from mavfi.flight.host import ArmFlights, ArmSetup, Flight, Host
from mavfi.mission import MissionSpec, Scenario

PATIENCE_S = 300.0
"""Time limit for a node's response (s, wall clock); generous, as a slow node mistaken for a hung one is killed, which
changes its flight."""


class Ros1Host(Host):
    """Runs every kernel, the world, injector and detector as separate ROS nodes."""

    name = "ros1"
    levels: frozenset[str] = frozenset({StateFault.level, SensorFault.level})

    def resolve(self, spec: MissionSpec) -> Scenario:
        """See `Host.resolve`; raises `BadInputError` for options that ROS does not support."""
        check_supported(spec)
        return resolve(spec)

    @classmethod
    def check_sampling(cls, sampling: Any) -> None:
        """See `Host.check_sampling`."""
        if getattr(sampling, "messages", ()) and "length" in sampling.strata:
            raise BadInputError("sampling.strata: 'length': may lose a message; allowed on ROS: bits of numbers")

    def check(self) -> None:
        """See `Host.check`.

        Raises:
            BadInputError: ROS is not installed, or a private network cannot be created.
        """
        finder.require()
        isolation()

    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> "Ros1Flights":
        """See `Host.mission`; every flight is flown in full."""
        return Ros1Flights(self, arms)


class Ros1Flights(ArmFlights):
    """The flights of one mission; see `MissionFlights`."""

    def _fly(self, arm: str, fault: StateFault | SensorFault | None, *, profile: bool = False) -> Flight:
        setup, first = self._arms[arm], arm not in self._detectors
        plan = Plan(
            setup.scenario, configure(setup.scenario), fault, self._detector(arm), setup.recovery,
            patience_s=PATIENCE_S, profile=profile,
        )  # fmt: skip
        if first:
            # compile in advance: a detector that is compiled in its node would be mistaken for a hung one
            fly_begin(plan.scenario, plan.detector, setup.recovery)
        return fly(plan).flight
