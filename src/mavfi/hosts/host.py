"""What a host is: where the flights of one mission are flown, and what is flown once for several of them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, StateFault
from mavfi.flight_log import FlightLog, Profile
from mavfi.flight_record import FlightRecord, record_of
from mavfi.hosts.loop.recovery import INLINE, Recovery
from mavfi.mission import MissionSpec, Scenario
from mavfi.plugins import load_object

GROUP = "mavfi.hosts"
"""Entry points of this group are hosts: classes whose arguments are the keys of a campaign that only they have."""
_SHIPPED = {
    "local": "mavfi.hosts.local.mission_flights:LocalHost", "ros1": "mavfi.hosts.ros1.host:Ros1Host",
    "node": "mavfi.hosts.node.host:NodeHost",
}  # fmt: skip


@dataclass(slots=True)
class Flight:
    """A flight.

    Attributes:
        log: Its log; `profile`: when which state was published, if it was asked for.
        world: Where it was flown; None = not known here.
        pipeline: The kernels as they were at the end, for pictures and inspection.
        extra: What this host adds to the record, as plain data.
    """

    log: FlightLog
    profile: Profile | None = None
    world: Any = None
    pipeline: Mapping[str, Any] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    def record(self) -> FlightRecord:
        """The record that a ledger keeps."""
        return replace(record_of(self.log), extra=dict(self.extra))


class Recorded(Protocol):
    """The result of a run: a `Flight`, or its equivalent at hosts without flights."""

    @property
    def profile(self) -> Profile | None:
        """When which state was published, if it was asked for."""

    def record(self) -> FlightRecord:
        """The record that a ledger keeps."""


@dataclass(frozen=True, slots=True)
class ArmSetup:
    """What one arm flies with: scenario, factory of detectors (None = no detector), answer to its alarms."""

    scenario: Scenario
    make_detector: Callable[[], Detector] | None = None
    recovery: Recovery = INLINE


class MissionFlights(Protocol):
    """The flights of one mission under several arms.  Flights without a detector come before those with one."""

    def golden(self, arm: str, *, profile: bool = False) -> Recorded:
        """An arm's error-free flight; `profile` = note when which state was published."""

    def know(self, arm: str, flight: Flight) -> None:
        """Take over the golden flight of an arm that was flown elsewhere, e.g. with counted instructions."""

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """The flights with a fault, given as arm and fault: each with its place in the list, in any order.

        An exception of ours ends one flight, not the others.
        """


class ArmFlights(ABC):
    """Base of `MissionFlights` that keep the golden flight and the detector of each arm."""

    def __init__(self, arms: Mapping[str, ArmSetup]) -> None:
        self._arms = arms
        self._detectors: dict[str, Detector | None] = {}
        self._golden: dict[str, Flight] = {}

    @abstractmethod
    def _fly(self, arm: str, fault: StateFault | None, *, profile: bool = False) -> Flight:
        """Fly one flight of an arm."""

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
            make = self._arms[arm].make_detector
            self._detectors[arm] = None if make is None else make()
        return self._detectors[arm]


class Host(Protocol):
    """Where missions are flown.

    Attributes:
        name: As in configuration.
        levels: Levels of faults that it can inject.
        deterministic: Whether a flight is a pure function of its spec; otherwise it is never reported as `masked`.
        in_process: Whether flights compile and load in this process, so that forked workers inherit compiled code.
    """

    name: str
    levels: frozenset[str]
    deterministic: bool
    in_process: bool

    def resolve(self, spec: MissionSpec) -> Any:
        """The mission of a spec: a `Scenario`, or an equivalent with `key` and `to_json`."""

    def check(self) -> None:
        """Refuse in advance what would make every flight fail.

        Raises:
            BadInputError: Something that the host needs is missing.
        """

    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> MissionFlights:
        """Prepare the flights of a mission under arms by name; nothing is flown yet.

        If `fast_forward`, flights may begin at checkpoints of known ones and end as these did, if that gives the same
        bytes.
        """


def find_host(name: str, options: Mapping[str, Any] | None = None) -> Host:
    """A host by name, made with its options.

    Raises:
        BadInputError: There is no such host, or it cannot be imported.
    """
    host: Host = load_object("host", name, GROUP, _SHIPPED)(**(options or {}))
    return host


def require_level(host: Host, level: str) -> None:
    """Check that a host can inject faults of a level.

    Raises:
        BadInputError: It cannot.
    """
    if level not in host.levels:
        raise BadInputError(f"host {host.name}: faults of level {level!r}: allowed: {', '.join(sorted(host.levels))}")
