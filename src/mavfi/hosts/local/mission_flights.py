"""In-process flights of one mission: fast-forwarded where the result is bit-identical, otherwise flown in full."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, InstructionFault, StateFault
from mavfi.hosts.host import ArmFlights, ArmSetup, Flight, Recorded, one_by_one
from mavfi.hosts.instruction import fly_instruction_faults
from mavfi.hosts.local.fast_forward import FastForward
from mavfi.hosts.local.flight import LocalFault, fly
from mavfi.hosts.local.forks import fly_from_checkpoints
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
        self._scratch = False

    def know(self, arm: str, flight: Flight) -> None:
        """See `MissionFlights.know`: faults in instructions follow."""
        super().know(arm, flight)
        self._scratch = True

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """See `MissionFlights.injected`: faults in instructions come last, by arm."""
        batches: dict[str, list[tuple[int, InstructionFault]]] = {}
        others = []
        for place, (arm, fault) in enumerate(runs):
            if isinstance(fault, InstructionFault):
                batches.setdefault(arm, []).append((place, fault))
            else:
                others.append(place)
        for number, flight in one_by_one([runs[place] for place in others], self._fly_injected):
            yield others[number], flight
        for arm, batch in batches.items():
            yield from self._instructions(arm, batch)

    def _instructions(
        self, arm: str, batch: Sequence[tuple[int, InstructionFault]]
    ) -> Iterator[tuple[int, Flight | Exception]]:
        faults = [fault for _, fault in batch]
        try:
            found = self._from_checkpoints(arm, faults) or self._from_take_off(arm, faults)
        except Exception as error:  # noqa: BLE001 - raised by one of the runs; each is retried separately
            if len(batch) == 1:
                yield batch[0][0], error
                return
            for one in batch:
                yield from self._instructions(arm, [one])
            return
        yield from ((place, flight) for (place, _), flight in zip(batch, found, strict=True))

    def _from_take_off(self, arm: str, faults: Sequence[InstructionFault]) -> list[Flight]:
        setup = self._arms[arm]
        if not self._simulated:
            raise BadInputError("faults in instructions fork the flight; allowed: state, memory, sensor, in this world")
        return fly_instruction_faults(
            setup.scenario, faults, self._detector(arm), self._golden.get(arm), setup.recovery
        ).flights  # fmt: skip

    def _from_checkpoints(self, arm: str, faults: Sequence[InstructionFault]) -> list[Flight]:
        """As `_from_take_off`, fast-forwarded; empty if that is not possible."""
        golden, detector, recovery = self._golden.get(arm), self._detector(arm), self._arms[arm].recovery
        if golden is None or any(fault.kernel in DETECTORS for fault in faults):
            return []

        def fly_all(forward: FastForward, name: str) -> list[Flight]:
            if not forward.scratch:
                return []
            return fly_from_checkpoints(forward, faults, golden, detector, name, recovery)

        return self._forwarded(arm, fly_all) or []

    def _forwarded(self, arm: str, fly: Callable[[FastForward, str], Found]) -> Found | None:
        """Result of `fly`, called with the fast-forward of an arm and the arm's name there; None if not possible.

        Excluded are detectors whose recovery restarts nodes or degrades, as responses depend on earlier alarms; and
        detectors with `seal` or `duplicates`, which act on unpublished values.
        """
        setup, detector = self._arms[arm], self._detector(arm)
        takes_part = hasattr(detector, "seal") or hasattr(detector, "duplicates")
        if not self._fast or (detector is not None and (setup.recovery.remembers or takes_part)):
            return None
        key = setup.scenario.key()
        try:
            forward = self._forward.get(key) or FastForward(setup.scenario, scratch=self._scratch)
            found = fly(forward, arm if detector is not None else "")
        except Exception:  # noqa: BLE001 - state that cannot be copied or compared: the full flight decides
            self._forward.pop(key, None)
            return None
        self._forward[key] = forward
        return found

    def _fly(self, arm: str, fault: LocalFault | None, *, profile: bool = False) -> Flight:
        """Fly one run, fast-forwarded if possible.

        Excluded are also null faults, whose purpose is to exercise the injector, and faults in memory, sensors and
        motors, which checkpoints do not contain.
        """
        setup, detector = self._arms[arm], self._detector(arm)
        found = None
        if fault is None or (isinstance(fault, StateFault) and fault.bit is not None):
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
