"""In-process flights of one mission: fast-forwarded where the result is bit-identical, otherwise flown in full.

What is fast-forwarded is decided before a flight, by what can be saved in a checkpoint: the plant (the simulator, with
a flight controller that is `rewindable`), the kernels, and the detector.  Faults in states start from checkpoints, and
so do faults in instructions of kernels if the work arrays of these can be saved, too.
"""

import random
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, cast

import numpy as np

from mavfi.detectors.detector import Detector, is_custom
from mavfi.errors import BadInputError
from mavfi.faults.fault import CallFault, Fault, FliesFrom, find_level, level_names
from mavfi.flight.checkpoints import can_save_detector
from mavfi.flight.compose import new_loop, resolve, watch
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.fast_forward import FastForward
from mavfi.flight.fly import fly
from mavfi.flight.from_checkpoints import fly_from_checkpoints
from mavfi.flight.from_take_off import fly_instruction_faults
from mavfi.flight.host import ArmFlights, ArmSetup, Flight, Host, Recorded, one_by_one, require_level
from mavfi.flight.instruction_cases import InjectedRuns, Published
from mavfi.flight.known_flights import FlownArm, check_prefix, check_repetition
from mavfi.flight.loop import Listener, Loop
from mavfi.flight.plant import MakePlant
from mavfi.flight.targets import Targets, plug_ins_of
from mavfi.ir.injection.variant import Resolving
from mavfi.mission import MissionSpec, Scenario
from mavfi.pipeline.functions import ENTRIES
from mavfi.sim.controller import is_rewindable
from mavfi.sim.environments import find_generator
from mavfi.sim.simulator import Simulator


class LocalHost(Host):
    """The deterministic in-process host.

    Args:
        make_plant: Constructs another vehicle in its world than the simulator.

    Attributes:
        make_plant: Constructs the vehicle in its world.
        supports_fast_forward: Whether the vehicle can be saved, restored and forked.  If not, all flights start from
            take-off, and faults in instructions, whose runs are forked, are refused.
    """

    name = "local"
    in_process = True

    def __init__(self, make_plant: MakePlant | None = None) -> None:
        self.make_plant: MakePlant = make_plant or Simulator
        self.supports_fast_forward = make_plant is None

    @property
    def levels(self) -> frozenset[str]:
        """See `Host.levels`: all that are injected in a flight of this process, also those of other packages."""
        return frozenset(name for name in level_names() if find_level(name).local)

    def resolve(self, spec: MissionSpec) -> Scenario:
        """See `Host.resolve`."""
        return resolve(spec)

    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> "LocalFlights":
        """See `Host.mission`."""
        return LocalFlights(self, arms, fast_forward=fast_forward)


class LocalFlights(ArmFlights):
    """The flights of one mission; see `MissionFlights`."""

    def __init__(self, host: LocalHost, arms: Mapping[str, ArmSetup], *, fast_forward: bool) -> None:
        super().__init__(host, arms)
        self._local_host = host
        self._fast_forward = fast_forward and host.supports_fast_forward
        self._forwards: dict[str, FastForward] = {}  # by key of the scenario
        self._can_save_detector: dict[str, bool] = {}  # by arm
        self._has_watched_runs = True
        self._expects_instruction_faults = False
        self._repeated: set[tuple[str, int]] = set()  # golden flights: key of the scenario, identity of the detector

    # ---- golden flights with custom parts ---------------------------------------------------------------------------
    def golden(self, arm: str, *, profile: bool = False) -> Flight:
        """See `MissionFlights.golden`; with custom parts, it is flown twice."""
        golden = super().golden(arm, profile=profile)
        self._check_repetition(arm, golden)
        return golden

    def register_golden(self, arm: str, flight: Flight) -> None:
        """See `MissionFlights.register_golden`."""
        super().register_golden(arm, flight)
        self._check_repetition(arm, flight)

    def _check_repetition(self, arm: str, golden: Flight) -> None:
        """Fly a golden flight with custom parts once more, from take-off; no fault has an effect if the two differ.

        Raises:
            MavfiError: They differ.
        """
        setup = self._arms[arm]
        detector = self._detector(arm)
        custom_parts = custom_parts_of(setup.scenario, detector)
        flight_key = setup.scenario.key(), id(detector)
        if not custom_parts or flight_key in self._repeated or not self._local_host.supports_fast_forward:
            return
        with _global_generators_restored():
            repeated = fly(
                setup.scenario, None, detector, recovery=setup.recovery, observers=[_OtherGlobalGenerators()]
            )
        check_repetition(golden.log, repeated.log, ", ".join(custom_parts))
        self._repeated.add(flight_key)

    @contextmanager
    def _forwarding(self, arm: str) -> Iterator[FastForward | None]:
        """The fast-forward of an arm's mission; None = flights of this arm start from take-off.

        It is shared by all arms of the same scenario, and discarded after an exception, which may have ended a flight
        half-way.
        """
        scenario = self._arms[arm].scenario
        # The checkpoints do not contain what a kernel of a user's own remembers beside its memory.
        if not (self._fast_forward and is_rewindable(scenario.flight_controller)) or scenario.kernels:
            yield None
            return
        key = scenario.key()
        if key not in self._forwards:
            self._forwards[key] = FastForward(scenario, scratch=self._expects_instruction_faults)
        forward = self._forwards[key]
        if not (forward.supported and self._saves_detector(arm)):
            yield None
            return
        forward.watched = self._has_watched_runs
        try:
            yield forward
        except BaseException:
            self._forwards.pop(key, None)
            raise

    def _flown_arm(self, arm: str) -> FlownArm:
        """Detector and recovery of an arm; without a detector, flights of all arms of a scenario are the same."""
        detector = self._detector(arm)
        name = ""
        if detector is not None:
            name = arm
        return FlownArm(name, detector, self._arms[arm].recovery)

    def _saves_detector(self, arm: str) -> bool:
        """Whether checkpoints can contain the detector of an arm."""
        if arm not in self._can_save_detector:
            self._can_save_detector[arm] = can_save_detector(self._detector(arm))
        return self._can_save_detector[arm]

    # ---- golden flights, and faults in states, memory, sensors and motors -------------------------------------------
    def _fly(self, arm: str, fault: Fault | None, *, profile: bool = False) -> Flight:
        """Fly one run, fast-forwarded if possible.

        Excluded are null faults, whose purpose is to exercise the injector; faults that count publications from
        take-off; faults in memory, sensors and motors, which checkpoints do not contain; and golden flights whose
        checkpoints nothing would start from.
        """
        setup = self._arms[arm]
        flown_arm = self._flown_arm(arm)
        flies_from = _start_of(fault)
        if fault is not None and flies_from is FliesFrom.CALLS:
            self._require_forks()
            flight: Flight = find_level(fault.level).fly_forked(setup, fault, flown_arm.detector)[0]
            return flight
        if fault is None:
            # Faults in instructions follow, from take-off if the detector takes part.
            may_forward = not (self._expects_instruction_faults and flown_arm.takes_part)
        else:
            may_forward = flies_from is FliesFrom.CHECKPOINT
        if may_forward:
            with self._forwarding(arm) as forward:
                if forward is not None:
                    return forward.fly(fault, flown_arm)
        return fly(
            setup.scenario,
            fault,
            flown_arm.detector,
            recovery=setup.recovery,
            profile=profile,
            make_plant=self._local_host.make_plant,
            observers=setup.observers,
        )

    # ---- counting and resolving of instructions ---------------------------------------------------------------------
    @contextmanager
    def _forwarding_calls(self, arm: str, functions: Mapping[str, Any]) -> Iterator[FastForward | None]:
        """As `_forwarding`; its checkpoints count calls of the functions of mavfi's own kernels, unprotected."""
        is_plain = self._detector(arm) is None and self._arms[arm].scenario.protection is None
        if is_plain and functions.keys() <= set(ENTRIES):
            with self._forwarding(arm) as forward:
                yield forward
        else:
            yield None

    def count_instructions(
        self, arm: str, functions: Mapping[str, Callable[..., Any]], listeners: Sequence[Listener] = ()
    ) -> Flight:
        """Fly the golden flight of an arm with instrumented functions of its kernels and detector, by name.

        Without a detector or protection it takes the checkpoints, unless they have been taken already.  `listeners` are
        told of the steps of kernels.
        """
        setup = self._arms[arm]
        detector = self._detector(arm)
        self._expects_instruction_faults = True
        if setup.scenario.key() not in self._forwards:
            with self._forwarding_calls(arm, functions) as forward:
                if forward is not None:
                    with forward.instrumented(functions, listeners):
                        golden = Flight(forward.fly().log)
                    self.register_golden(arm, golden)
                    return golden
        with Targets(setup.scenario, detector).instrumented(functions) as table:
            golden = fly(setup.scenario, None, detector, recovery=setup.recovery, functions=table, observers=listeners)
        self.register_golden(arm, golden)
        return golden

    def resolve_instructions(self, arm: str, functions: Mapping[str, Resolving]) -> None:
        """Repeat as much of a golden flight that was counted as is needed to resolve instructions of its calls.

        Raises:
            MavfiError: Two golden flights differ.
        """
        setup = self._arms[arm]
        detector = self._detector(arm)
        with self._forwarding_calls(arm, functions) as forward:
            if forward is not None:
                forward.resolve(functions)
                return
        with Targets(setup.scenario, detector).instrumented(functions) as table, np.errstate(all="ignore"):
            loop = new_loop(setup.scenario, functions=table)
            watch(loop, detector, setup.recovery)
            loop.fly_until(lambda: all(function.done for function in functions.values()))
        check_prefix(loop, self._golden[arm].log)

    # ---- injected runs ----------------------------------------------------------------------------------------------
    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """See `MissionFlights.injected`: faults in instructions come last, by arm, those of kernels before others."""
        self._has_watched_runs = any(self._arms[arm].make_detector is not None for arm, _ in runs)
        batches: dict[tuple[bool, str], dict[int, CallFault]] = {}  # by whether they are in a detector, and arm
        single_runs = []
        for number, (arm, fault) in enumerate(runs):
            if _start_of(fault) is FliesFrom.CALL:
                batch = batches.setdefault((fault.in_detector, arm), {})
                batch[number] = cast(CallFault, fault)
            else:
                single_runs.append(number)
        for index, flight in one_by_one([runs[number] for number in single_runs], self._fly_injected):
            yield single_runs[index], flight

        # Arms without a detector are flown first: runs of arms with one may follow from theirs.
        arms = {arm for _, arm in batches}
        followed: dict[tuple[str, Fault], Flight] = {}  # runs that follow from those of another arm
        for in_detector, arm in sorted(batches, key=lambda batch: batch[0]):
            remaining = {}
            for number, call_fault in batches[in_detector, arm].items():
                if (arm, call_fault) in followed:
                    yield number, followed[arm, call_fault]
                else:
                    remaining[number] = call_fault
            if remaining:
                yield from self._fly_batch(arm, remaining, arms, followed)

    def _fly_batch(
        self,
        arm: str,
        batch: Mapping[int, CallFault],
        arms: Collection[str],
        followed: dict[tuple[str, Fault], Flight],
    ) -> Iterator[tuple[int, Flight | Exception]]:
        """Flights with faults in instructions, by number; runs of other arms that follow from them go to `followed`."""
        faults = list(batch.values())
        try:
            injected = self._fly_instruction_faults(arm, faults, arms)
        except Exception as error:  # noqa: BLE001 - ends only the run that raised it
            if len(batch) == 1:
                yield next(iter(batch)), error
                return
            # Each is flown on its own, since nothing tells which of them raised it.
            for number, fault in batch.items():
                yield from self._fly_batch(arm, {number: fault}, arms, followed)
            return
        for other_arm, flights in injected.watched.items():
            followed.update({(other_arm, faults[index]): flight for index, flight in flights.items()})
        yield from zip(batch, injected.flights, strict=True)

    def _fly_instruction_faults(self, arm: str, faults: Sequence[CallFault], arms: Collection[str]) -> InjectedRuns:
        """Fly an arm with each of several faults in instructions, and `arms` as far as they follow from it."""
        setup = self._arms[arm]
        flown_arm = self._flown_arm(arm)
        golden = self._golden.get(arm)
        self._require_forks()
        # From golden checkpoints, if these contain all that the faults can change; else from take-off.
        in_pipeline = not any(fault.in_detector or fault.role for fault in faults)
        if golden is not None and in_pipeline and not flown_arm.takes_part:
            with self._forwarding(arm) as forward:
                if forward is not None and forward.scratch:
                    return fly_from_checkpoints(forward, faults, golden, flown_arm, self._watched_arms(arm, arms))
        return fly_instruction_faults(setup.scenario, faults, flown_arm.detector, golden, setup.recovery)

    def _require_forks(self) -> None:
        """Refuse faults in instructions where the vehicle cannot be forked."""
        if not self._local_host.supports_fast_forward:
            raise BadInputError("faults in instructions fork the flight; allowed: state, memory, sensor, in this world")

    def _watched_arms(self, plain: str, arms: Collection[str]) -> list[FlownArm]:
        """Arms that differ from one without a detector by a detector alone, and can be fast-forwarded.

        A custom detector is not called in the other arm's flights: it could end these.
        """
        watched: list[FlownArm] = []
        if self._detector(plain) is not None:
            return watched
        scenario_key = self._arms[plain].scenario.key()
        for arm in arms:
            flown_arm = self._flown_arm(arm)
            if flown_arm.detector is None or arm not in self._golden or flown_arm.takes_part:
                continue
            if is_custom(flown_arm.detector):
                continue
            if self._arms[arm].scenario.key() == scenario_key and self._saves_detector(arm):
                watched.append(flown_arm)
        return watched


def custom_parts_of(scenario: Scenario, detector: Detector | None) -> list[str]:
    """Names of what is not part of mavfi in a mission under a detector."""
    names = [plug_in.address for plug_in in plug_ins_of(scenario, detector)]
    generator = find_generator(scenario.environment.generator)
    if not generator.__module__.startswith("mavfi."):
        names.append(scenario.environment.generator)
    return names


class _OtherGlobalGenerators(Listener):
    """Gives the global generators another seed at take-off: a plug-in that draws from them then flies differently."""

    def begin(self, loop: Loop) -> None:
        """See `Listener`."""
        random.seed(loop.scenario.seed + 1)
        np.random.seed((loop.scenario.seed + 1) % 2**32)  # noqa: NPY002 - the global generator


@contextmanager
def _global_generators_restored() -> Iterator[None]:
    """Leave the global generators as they were, for the code that uses mavfi."""
    state = random.getstate()
    numpy_state = np.random.get_state()  # noqa: NPY002 - the global generator
    try:
        yield
    finally:
        random.setstate(state)
        np.random.set_state(numpy_state)  # noqa: NPY002 - the global generator


def _start_of(fault: Fault | None) -> FliesFrom:
    """Where flights with a fault are flown from; golden flights are fast-forwarded as well."""
    if fault is None:
        return FliesFrom.CHECKPOINT
    flies_from: FliesFrom = find_level(fault.level).flies_from(fault)
    return flies_from


def fly_recorded(
    scenario: Scenario, fault: Fault | None = None, detector: Detector | None = None, recovery: RecoveryPolicy = INLINE
) -> tuple[Flight, list[Published]]:
    """Fly one mission; also returns the publications as received by consumers, in order.

    Raises:
        BadInputError: The scenario cannot be flown, or the fault is of another level.
    """
    if fault is not None:
        require_level(LocalHost(), fault.level)
    flies_from = _start_of(fault)
    if fault is not None and flies_from is FliesFrom.CALLS:
        setup = ArmSetup(scenario, recovery=recovery)
        recorded: tuple[Flight, list[Published]] = find_level(fault.level).fly_forked(
            setup, fault, detector, records=True
        )
        return recorded
    if flies_from is FliesFrom.CALL:
        faults = [cast(CallFault, fault)]
        runs = fly_instruction_faults(scenario, faults, detector, recovery=recovery, records=True)
        return runs.flights[0], runs.publications[0]

    # In one process, from take-off.
    publications: list[Published] = []
    flight = fly(
        scenario,
        fault,
        detector,
        recovery=recovery,
        recorders=[lambda state, time_us: publications.append((state.copy(), time_us))],
    )
    return flight, publications
