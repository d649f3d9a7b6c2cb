"""What a host is: where missions are flown.  `local` is the deterministic one; `ros1`, `node` and entry points follow.

A campaign, a command or a notebook asks a host for the flights of one mission; the host decides what it flies once for
several of them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault
from mavfi.flight_log import FlightLog, Profile
from mavfi.flight_record import FlightRecord, record_of
from mavfi.hosts.loop.recovery import Coupling
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
    """What a flight gives back.

    Attributes:
        log: The record.
        profile: When which state was published, if it was asked for.
        world: The world that was flown in; None = it is not known here.
        pipeline: The kernels as they were at the end, for pictures and inspection.
        extra: What this host adds to the record, as plain data.
    """

    log: FlightLog
    profile: Profile | None = None
    world: Any = None
    pipeline: Mapping[str, Any] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    def record(self) -> FlightRecord:
        """What a ledger keeps of it."""
        return replace(record_of(self.log), extra=dict(self.extra))


class Recorded(Protocol):
    """What a host gives back of a run: a `Flight`, or what stands for one."""

    @property
    def profile(self) -> Profile | None:
        """When which state was published, if it was asked for."""

    def record(self) -> FlightRecord:
        """What a ledger keeps of it."""


@dataclass(frozen=True, slots=True)
class ArmSetup:
    """What one arm of a mission flies with.

    Attributes:
        scenario: The mission, as the host resolves it.
        make_detector: Gives the detector, ready to start; None = nothing watches.
        coupling: Of the detector, see `hosts.loop.recovery`.
    """

    scenario: Scenario
    make_detector: Callable[[], Detector] | None = None
    coupling: Coupling = "inline"


class MissionFlights(Protocol):
    """The flights of one mission under several arms.  Flights without a detector come before those with one."""

    def golden(self, arm: str, *, profile: bool = False) -> Recorded:
        """The error-free flight of an arm.

        Args:
            arm: Name.
            profile: Whether to record when which state was published.
        """

    def know(self, arm: str, flight: Flight) -> None:
        """Take over the golden flight of an arm that was flown elsewhere, e.g. with counted instructions."""

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """The flights with a fault, each by its place in the list, in any order.

        An exception of ours ends one flight, not the others.

        Args:
            runs: Arm and fault.
        """


class Host(Protocol):
    """Where missions are flown.

    Attributes:
        name: As in configuration.
        levels: Levels of faults that it can inject.
        deterministic: Whether a flight is a pure function of its spec; one that is not never reports `masked`.
        in_process: Whether flights compile and load in this process, so that forked workers inherit what is there.
    """

    name: str
    levels: frozenset[str]
    deterministic: bool
    in_process: bool

    def resolve(self, spec: MissionSpec) -> Any:
        """The mission that options ask for: a `Scenario`, or what stands for one, with `key` and `to_json`."""

    def check(self) -> None:
        """Refuse at once what would make every flight fail.

        Raises:
            BadInputError: Something that the host needs is not there.
        """

    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> MissionFlights:
        """Get ready for the flights of a mission; nothing is flown yet.

        Args:
            arms: By name.
            fast_forward: Whether flights may begin at checkpoints of known ones, and end as these did, where that
                gives the same bytes.
        """


def find_host(name: str, options: Mapping[str, Any] | None = None) -> Host:
    """A host by name.

    Args:
        name: As in configuration.
        options: What it is made with.

    Raises:
        BadInputError: There is none of that name, or it cannot be imported.
    """
    host: Host = load_object("host", name, GROUP, _SHIPPED)(**(options or {}))
    return host


def require_level(host: Host, level: str) -> None:
    """Refuse a level of faults that a host cannot inject.

    Raises:
        BadInputError: It cannot.
    """
    if level not in host.levels:
        raise BadInputError(f"host {host.name}: faults of level {level!r}: allowed: {', '.join(sorted(host.levels))}")
