"""In-process flights of one mission: fast-forwarded where the result is bit-identical, otherwise flown in full."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from mavfi.detectors.custom import is_custom
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, InstructionFault, StateFault
from mavfi.faults.instruction import Resolving
from mavfi.flight_log import FlightLog
from mavfi.hosts.host import ArmFlights, ArmSetup, Flight, Recorded, one_by_one
from mavfi.hosts.instruction import fly_instruction_faults
from mavfi.hosts.local.branch import takes_part
from mavfi.hosts.local.fast_forward import FastForward
from mavfi.hosts.local.flight import LocalFault, fly
from mavfi.hosts.local.forks import InjectedRuns, WatchedArm, fly_from_checkpoints
from mavfi.hosts.loop.compose import resolve
from mavfi.hosts.loop.plant import MakePlant
from mavfi.mission import MissionSpec, Scenario
from mavfi.sim.simulator import Simulator
from mavfi.states import DETECTORS

Found = TypeVar("Found")


class LocalHost:
    """The deterministic in-process host.

    Args:
        make_plant: Constructs the vehicle in its world; with another one than the simulator there is no fast-forward,
            and faults in instructions, whose runs are forked, are refused.
    """

    name = "local"
    levels = frozenset({"state", "memory", "instruction", "sensor"})
    deterministic = True
    flies = True
    in_process = True

    def __init__(self, make_plant: MakePlant = Simulator) -> None:
        self._make_plant = make_plant

    def resolve(self, spec: MissionSpec) -> Scenario:
        """See `Host.resolve`."""
        return resolve(spec)

    def check(self) -> None:
        """See `Host.check`; there are no prerequisites."""

    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> "LocalFlights":
        """See `Host.mission`."""
        return LocalFlights(self, arms, fast_forward, self._make_plant)


class LocalFlights(ArmFlights):
    """The flights of one mission; see `MissionFlights`."""

    def __init__(
        self, host: LocalHost, arms: Mapping[str, ArmSetup], fast_forward: bool, make_plant: MakePlant
    ) -> None:
        super().__init__(host, arms)
        self._simulated, self._make_plant = make_plant is Simulator, make_plant
        self._fast = fast_forward and self._simulated
        self._forward: dict[str, FastForward] = {}
        self._watched, self._scratch = True, False

    def know(self, arm: str, flight: Flight) -> None:
        """See `MissionFlights.know`: faults in instructions follow."""
        super().know(arm, flight)
        self._scratch = True

    def counted(self, arm: str, functions: Mapping[str, Callable[..., Any]]) -> FlightLog | None:
        """The golden flight of an arm without a detector, with instrumented functions of its kernels, by name.

        It takes the checkpoints; None if there are none, or if they have been taken already.
        """
        setup = self._arms[arm]
        key = setup.scenario.key()
        if setup.make_detector is not None or setup.scenario.protection is not None or key in self._forward:
            return None
        self._scratch = True

        def fly_first(forward: FastForward, name: str) -> FlightLog:
            with forward.instrumented(functions):
                return forward.golden(None, name).log

        return self._forwarded(arm, fly_first)

    def resolve(self, arm: str, functions: Mapping[str, Resolving]) -> bool:
        """Resolve instructions of calls in a flight that was `counted`; whether that was possible."""

        def visit(forward: FastForward, name: str) -> bool:
            del name
            forward.resolve(functions)
            return True

        return self._forwarded(arm, visit) is True

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """See `MissionFlights.injected`: faults in instructions come last, by arm, those of kernels before others."""
        self._watched = any(self._arms[arm].make_detector is not None for arm, _ in runs)
        batches: dict[tuple[bool, str], list[tuple[int, InstructionFault]]] = {}
        others = []
        for place, (arm, fault) in enumerate(runs):
            if isinstance(fault, InstructionFault):
                batches.setdefault((fault.kernel in DETECTORS, arm), []).append((place, fault))
            else:
                others.append(place)
        for number, flight in one_by_one([runs[place] for place in others], self._fly_injected):
            yield others[number], flight
        known: dict[tuple[str, InstructionFault], Flight] = {}
        arms = {arm for _, arm in batches}
        for (_, arm), batch in sorted(batches.items(), key=lambda item: item[0][0]):
            for place, fault in batch:
                if (arm, fault) in known:
                    yield place, known[arm, fault]
            yield from self._instructions(arm, [one for one in batch if (arm, one[1]) not in known], arms, known)

    def _instructions(
        self, arm: str, batch: Sequence[tuple[int, InstructionFault]], arms: Collection[str],
        known: dict[tuple[str, InstructionFault], Flight],
    ) -> Iterator[tuple[int, Flight | Exception]]:  # fmt: skip
        """Flights of a batch with faults in instructions; those of the other arms that follow from them get `known`."""
        if not batch:
            return
        faults = [fault for _, fault in batch]
        try:
            found = self._from_checkpoints(arm, faults, arms) or InjectedRuns(self._from_take_off(arm, faults), {})
        except Exception as error:  # noqa: BLE001 - raised by one of the runs; each is retried separately
            if len(batch) == 1:
                yield batch[0][0], error
                return
            for one in batch:
                yield from self._instructions(arm, [one], arms, known)
            return
        known.update(
            ((other, faults[place]), flight) for other, own in found.watched.items() for place, flight in own.items()
        )
        yield from ((place, flight) for (place, _), flight in zip(batch, found.flights, strict=True))

    def _from_take_off(self, arm: str, faults: Sequence[InstructionFault]) -> list[Flight]:
        setup = self._arms[arm]
        if not self._simulated:
            raise BadInputError("faults in instructions fork the flight; allowed: state, memory, sensor, in this world")
        return fly_instruction_faults(
            setup.scenario, faults, self._detector(arm), self._golden.get(arm), setup.recovery
        ).flights  # fmt: skip

    def _from_checkpoints(
        self, arm: str, faults: Sequence[InstructionFault], arms: Collection[str]
    ) -> InjectedRuns | None:  # fmt: skip
        """As `_from_take_off`, fast-forwarded; None if that is not possible."""
        golden, detector, recovery = self._golden.get(arm), self._detector(arm), self._arms[arm].recovery
        if golden is None or takes_part(detector, recovery) or any(fault.kernel in DETECTORS for fault in faults):
            return None
        followers = [other for other in arms if detector is None and self._follows(other, arm)]
        watched = {other: self._watched_arm(other) for other in followers}

        def fly_all(forward: FastForward, name: str) -> InjectedRuns | None:
            if not forward.scratch:
                return None
            return fly_from_checkpoints(forward, faults, golden, detector, name, recovery, watched)

        return self._forwarded(arm, fly_all)

    def _follows(self, arm: str, plain: str) -> bool:
        """Whether an arm differs from one without a detector by a detector alone, and can be fast-forwarded.

        A custom detector is not called in the other arm's flights: it could end these.
        """
        setup, detector = self._arms[arm], self._detector(arm)
        if is_custom(detector):
            return False
        same = setup.scenario.key() == self._arms[plain].scenario.key()
        return same and detector is not None and arm in self._golden and not takes_part(detector, setup.recovery)

    def _watched_arm(self, arm: str) -> WatchedArm:
        detector = self._detector(arm)
        assert detector is not None  # as `_follows` requires
        return WatchedArm(detector, self._arms[arm].recovery, self._golden[arm])

    def _forwarded(self, arm: str, fly: Callable[[FastForward, str], Found]) -> Found | None:
        """Result of `fly`, called with the fast-forward of an arm and the arm's name there; None if not possible."""
        setup, detector = self._arms[arm], self._detector(arm)
        if not self._fast:
            return None
        key = setup.scenario.key()
        try:
            forward = self._forward.get(key)
            forward = forward or FastForward(setup.scenario, scratch=self._scratch)
            forward.watched = self._watched
            found = fly(forward, arm if detector is not None else "")
        except Exception:  # noqa: BLE001 - state that cannot be copied or compared: the full flight decides
            self._forward.pop(key, None)
            return None
        self._forward[key] = forward
        return found

    def _fly(self, arm: str, fault: LocalFault | None, *, profile: bool = False) -> Flight:
        """Fly one run, fast-forwarded if possible.

        Excluded are null faults, whose purpose is to exercise the injector; faults in memory, sensors and motors, which
        checkpoints do not contain; and golden flights whose checkpoints nothing would start from.
        """
        setup, detector = self._arms[arm], self._detector(arm)
        found = None
        unused = self._scratch and takes_part(detector, setup.recovery)  # faults in instructions follow, from take-off
        if (fault is None and not unused) or (isinstance(fault, StateFault) and fault.bit is not None):
            found = self._forwarded(arm, lambda forward, name: forward.fly(fault, detector, name, setup.recovery))
        return found or fly(
            setup.scenario,
            fault,
            detector,
            recovery=setup.recovery,
            profile=profile,
            make_plant=self._make_plant,
            observers=setup.observers,
        )
