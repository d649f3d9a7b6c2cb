"""Interface of a host: the execution environment of a mission's flights, including what several flights share."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Protocol

from mavfi.config import Config
from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, find_level
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.mission import MissionSpec, Scenario
from mavfi.plugins import extensions, load_object
from mavfi.record import FlightLog, FlightRecord, Profile, record_of

GROUP = "mavfi.hosts"
"""Entry-point group of hosts: subclasses of `Host`."""
SHIPPED = {"local": "mavfi.flight.mission_flights:LocalHost"}
"""The host of the core; others are those of extras and other packages."""


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
        flight_record: The record.
        calls: Calls of an error-free run of a program, from which faults are drawn.
    """

    flight_record: FlightRecord
    calls: tuple[Any, ...] = ()
    profile: None = None

    def record(self) -> FlightRecord:
        """See `Recorded.record`."""
        return self.flight_record


class DetectorChoice(NamedTuple):
    """Name and profile of an arm's detector."""

    name: str
    profile: str


@dataclass(frozen=True, slots=True)
class ArmSetup:
    """Configuration of one arm.

    Attributes:
        scenario: The mission.
        make_detector: Constructs the detector; None = no detector.
        recovery: The recovery policy for its alarms.
        observers: Instances of `flight.loop.Listener` that take part in flights of the host `firmware`, and of the host
            `local` without fast-forward, except for faults in instructions.
        choice: The detector of hosts that train it themselves (`Host.trains`), in place of `make_detector`.
        label: Name of a single mission's detector, and its profile if it has one.
        model: Hash of a single mission's trained model.
    """

    scenario: Scenario
    make_detector: Callable[[], Detector] | None = None
    recovery: RecoveryPolicy = INLINE
    observers: tuple[Any, ...] = ()
    choice: DetectorChoice | None = None
    label: str = ""
    model: str = ""

    def detector(self) -> Detector | None:
        """A detector for flights of the arm; None = no detector."""
        if self.make_detector is None:
            return None
        return self.make_detector()


class MissionFlights(Protocol):
    """The flights of one mission under several arms; arms without a detector are flown first."""

    def golden(self, arm: str, *, profile: bool = False) -> Recorded:
        """The error-free flight of an arm; `profile` requests the publication times of each state."""

    def register_golden(self, arm: str, flight: Flight) -> None:
        """Register an arm's golden flight that was flown elsewhere, e.g. while instructions were counted."""

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """Fly the injected runs, given as (arm, fault); yields (index into `runs`, result) in any order.

        An exception ends only the run that raised it, and is yielded as its result.
        """


def one_by_one(
    runs: Sequence[tuple[str, Fault]], run: Callable[[str, Fault], Recorded]
) -> Iterator[tuple[int, Recorded | Exception]]:
    """`MissionFlights.injected` of a host that runs them sequentially."""
    for index, (arm, fault) in enumerate(runs):
        try:
            result: Recorded | Exception = run(arm, fault)
        except Exception as error:  # noqa: BLE001 - ends this run only
            result = error
        yield index, result


class ArmFlights(ABC):
    """Base class of `MissionFlights` that caches the golden flight and the detector of each arm."""

    def __init__(self, host: "Host", arms: Mapping[str, ArmSetup]) -> None:
        self._host = host
        self._arms = arms
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
        golden = self._golden.get(arm)
        if golden is None or (profile and golden.profile is None):
            golden = self._fly(arm, None, profile=profile)
            self._golden[arm] = golden
        return golden

    def register_golden(self, arm: str, flight: Flight) -> None:
        """See `MissionFlights.register_golden`."""
        self._golden[arm] = flight

    def _detector(self, arm: str) -> Detector | None:
        if arm not in self._detectors:
            self._detectors[arm] = self._arms[arm].detector()
        return self._detectors[arm]


class Host(ABC):
    """Execution environment of missions; the one optional argument of a subclass is what it tests, e.g. a program.

    Attributes:
        name: Name in configuration files.
        deterministic: Whether a flight is a pure function of its spec; if not, no run is classified as `masked`.
        flies: Whether the results of runs are of type `Flight`, which can be drawn.
        trains: Whether it trains the detectors of arms itself, on its runs without a fault.
        in_process: Whether flights compile and load code in this process, so that forked workers inherit it.
        single_levels: Levels of faults for which a single mission is flown at this host, if the host `local` cannot.
        config: Model of what is under test; None = our pipeline.
        config_key: Key of a campaign that has its values.
        samplings: Levels whose faults are drawn otherwise than for flights: by name, the level's subclass that does so.
    """

    name: str
    deterministic: bool = True
    flies: bool = True
    trains: bool = False
    in_process: bool = False
    single_levels: frozenset[str] = frozenset()
    config: type[Config] | None = None
    config_key: str = ""
    samplings: Mapping[str, Any] = {}

    @property
    @abstractmethod
    def levels(self) -> frozenset[str]:
        """Fault levels that it can inject."""

    @abstractmethod
    def resolve(self, spec: MissionSpec) -> Any:
        """Resolve a spec to its mission: a `Scenario`, or an equivalent with `key` and `to_json`."""

    def check(self) -> None:  # noqa: B027 - most hosts need nothing
        """Check the host's prerequisites before the first flight.

        Raises:
            BadInputError: A prerequisite is missing.
        """

    @abstractmethod
    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> MissionFlights:
        """Prepare the flights of a mission under named arms, without flying any.

        With `fast_forward`, a flight may start from a checkpoint of an earlier one and end where it converges with it,
        provided that the result is bit-identical.
        """

    def check_stored(self, scenario: Mapping[str, Any]) -> None:  # noqa: B027 - most fly what the ledger stores
        """Raise a SpecMismatchError if what is under test is not that of a ledger's scenario, given as plain data."""

    @classmethod
    def level_of(cls, name: str) -> Any:
        """A level, as campaigns of this host draw its faults; a BadInputError if there is no such level."""
        if name in cls.samplings:
            return cls.samplings[name]()
        return find_level(name)

    @classmethod
    def campaign_defaults(cls, under_test: Any) -> dict[str, Any]:
        """Keys of a campaign that follow from what is under test, unless they are given."""
        return {}

    @classmethod  # noqa: B027 - most inject all faults of their levels
    def check_sampling(cls, sampling: Any) -> None:
        """Raise a BadInputError if the host cannot inject faults that are drawn in this way."""


def host_class(name: str) -> type[Host]:
    """The class of a host by name.

    Raises:
        BadInputError: The host is unknown or cannot be imported.
    """
    loaded_class: type[Host] = load_object("host", name, GROUP, SHIPPED)
    return loaded_class


def find_host(name: str, under_test: Config | None = None) -> Host:
    """Construct a host by name, with what is under test.

    Raises:
        BadInputError: The host is unknown or cannot be imported.
    """
    make: Callable[..., Host] = host_class(name)
    if under_test is None:
        return make()
    return make(under_test)


def host_for(fault: Fault | None) -> Host:
    """The host that flies a single mission with a fault."""
    local = find_host("local")
    if fault is None or fault.level in local.levels:
        return local
    for name, other in extensions(GROUP).items():
        if fault.level in other.single_levels:
            return find_host(name)
    return local


def require_level(host: Host, level: str) -> None:
    """Check that a host supports a fault level.

    Raises:
        BadInputError: It does not.
    """
    if level not in host.levels:
        raise BadInputError(f"host {host.name}: faults of level {level!r}: allowed: {', '.join(sorted(host.levels))}")
