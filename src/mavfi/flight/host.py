"""Interface of a host: the execution environment of a mission's flights, including what several flights share."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, RegisterFault
from mavfi.flight.decide import INLINE, Recovery
from mavfi.mission import MissionSpec, Scenario
from mavfi.plugins import load_object
from mavfi.record import FlightLog, FlightRecord, Profile, record_of

GROUP = "mavfi.hosts"
"""Entry-point group of hosts: classes whose constructor arguments are host-specific keys of a campaign."""
SHIPPED = {
    "local": "mavfi.flight.mission_flights:LocalHost", "ros1": "mavfi.extras.ros.ros1.host:Ros1Host",
    "node": "mavfi.extras.ros.node.host:NodeHost", "firmware": "mavfi.extras.firmware.host:FirmwareHost",
    "airsim_program": "mavfi.extras.airsim.host:AirsimProgramHost",
}  # fmt: skip
"""Class of each host of this package, by name."""


@dataclass(slots=True)
class Flight:
    """A completed flight.

    Attributes:
        log: The flight log.
        profile: Publication times of each state, if requested.
        world: The world of the flight; None = not available to this process.
        pipeline: The kernels in their final state, for plots and inspection.
        extra: Host-specific additions to the record, as plain data.
    """

    log: FlightLog
    profile: Profile | None = None
    world: Any = None
    pipeline: Mapping[str, Any] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    def record(self) -> FlightRecord:
        """The flight's entry in a ledger."""
        return replace(record_of(self.log), extra=dict(self.extra))


class Recorded(Protocol):
    """The result of a run: a `Flight`, or its equivalent at hosts without flights."""

    @property
    def profile(self) -> Profile | None:
        """Publication times of each state, if requested."""

    def record(self) -> FlightRecord:
        """The run's entry in a ledger."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """The record of a run at a host without flights, as a `Recorded`.

    Attributes:
        kept: The record.
        passed: Calls of an error-free run of a program, from which faults are drawn.
    """

    kept: FlightRecord
    passed: tuple[Any, ...] = ()
    profile: None = None

    def record(self) -> FlightRecord:
        """See `Recorded.record`."""
        return self.kept


@dataclass(frozen=True, slots=True)
class ArmSetup:
    """Configuration of one arm: scenario, detector factory (None = no detector), recovery policy, and observers.

    Observers (`flight.loop.Listener`) take part in flights of the host `firmware`, and of the host `local` without
    fast-forward, except for faults in instructions.
    """

    scenario: Scenario
    make_detector: Callable[[], Detector] | None = None
    recovery: Recovery = INLINE
    observers: tuple[Any, ...] = ()

    def detector(self) -> Detector | None:
        """A detector for flights of the arm; None = no detector."""
        return None if self.make_detector is None else self.make_detector()


class MissionFlights(Protocol):
    """The flights of one mission under several arms; arms without a detector are flown first."""

    def golden(self, arm: str, *, profile: bool = False) -> Recorded:
        """The error-free flight of an arm; `profile` requests the publication times of each state."""

    def know(self, arm: str, flight: Flight) -> None:
        """Register an arm's golden flight that was flown elsewhere, e.g. while instructions were counted."""

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """Fly the injected runs, given as (arm, fault); yields (index into `runs`, result) in any order.

        An exception ends only the run that raised it, and is yielded as its result.
        """


def one_by_one(
    runs: Sequence[tuple[str, Fault]], run: Callable[[str, Fault], Recorded]
) -> Iterator[tuple[int, Recorded | Exception]]:
    """`MissionFlights.injected` of a host that runs them sequentially."""
    for place, (arm, fault) in enumerate(runs):
        try:
            found: Recorded | Exception = run(arm, fault)
        except Exception as error:  # noqa: BLE001 - ends this run only
            found = error
        yield place, found


class ArmFlights(ABC):
    """Base class of `MissionFlights` that caches the golden flight and the detector of each arm."""

    def __init__(self, host: "Host", arms: Mapping[str, ArmSetup]) -> None:
        self._host, self._arms = host, arms
        self._detectors: dict[str, Detector | None] = {}
        self._golden: dict[str, Flight] = {}

    @abstractmethod
    def _fly(self, arm: str, fault: Any, *, profile: bool = False) -> Flight:
        """Fly one flight of an arm; the fault is of a level of the host, None = golden."""

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """See `MissionFlights.injected`; flown sequentially."""
        return one_by_one(runs, self._fly_injected)

    def _fly_injected(self, arm: str, fault: Fault) -> Flight:
        require_level(self._host, fault.level)
        return self._fly(arm, fault)

    def golden(self, arm: str, *, profile: bool = False) -> Flight:
        """See `MissionFlights.golden`."""
        known = self._golden.get(arm)
        if known is None or (profile and known.profile is None):
            self._golden[arm] = known = self._fly(arm, None, profile=profile)
        return known

    def know(self, arm: str, flight: Flight) -> None:
        """See `MissionFlights.know`."""
        self._golden[arm] = flight

    def _detector(self, arm: str) -> Detector | None:
        if arm not in self._detectors:
            self._detectors[arm] = self._arms[arm].detector()
        return self._detectors[arm]


class Host(Protocol):
    """Execution environment of missions.

    Attributes:
        name: Name in configuration files.
        levels: Fault levels that it can inject.
        deterministic: Whether a flight is a pure function of its spec; if not, no run is classified as `masked`.
        flies: Whether the results of runs are of type `Flight`, which can be drawn.
        in_process: Whether flights compile and load code in this process, so that forked workers inherit it.
    """

    name: str
    levels: frozenset[str]
    deterministic: bool
    flies: bool
    in_process: bool

    def resolve(self, spec: MissionSpec) -> Any:
        """Resolve a spec to its mission: a `Scenario`, or an equivalent with `key` and `to_json`."""

    def check(self) -> None:
        """Check the host's prerequisites before the first flight.

        Raises:
            BadInputError: A prerequisite is missing.
        """

    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> MissionFlights:
        """Prepare the flights of a mission under named arms, without flying any.

        With `fast_forward`, a flight may start from a checkpoint of an earlier one and end where it converges with it,
        provided that the result is bit-identical.
        """


def find_host(name: str, options: Mapping[str, Any] | None = None) -> Host:
    """Construct a host by name with its options.

    Raises:
        BadInputError: The host is unknown or cannot be imported.
    """
    host: Host = load_object("host", name, GROUP, SHIPPED)(**(options or {}))
    return host


def host_for(fault: Fault | None) -> Host:
    """The host that flies a single mission with a fault."""
    return find_host("firmware" if isinstance(fault, RegisterFault) else "local")


def require_level(host: Host, level: str) -> None:
    """Check that a host supports a fault level.

    Raises:
        BadInputError: It does not.
    """
    if level not in host.levels:
        raise BadInputError(f"host {host.name}: faults of level {level!r}: allowed: {', '.join(sorted(host.levels))}")
