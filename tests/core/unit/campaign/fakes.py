"""A host whose flights take microseconds, and a detector: what the campaign engine is tested with.

A campaign asks for them by name, "tests.core.unit.campaign.fakes:FakeHost".  Workers are forked, and so know what a
test has set in `TROUBLE`.
"""

import contextlib
import hashlib
import os
import signal
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.detectors import Detector
from mavfi.faults.fault import Fault
from mavfi.flight.compose import resolve
from mavfi.flight.host import ArmSetup, Flight, Host, RunResult
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.levels.state.fault import StateFault
from mavfi.levels.state.injector import StateInjector
from mavfi.mission import MissionSpec, MissionStatus, Scenario
from mavfi.record import COLUMNS, AlarmRecord, Event, FlightLog, FlightRecord, Injection, Profile
from mavfi.states import Stage, new_state, states_with

HOST = "tests.core.unit.campaign.fakes:FakeHost"
DETECTOR = "tests.core.unit.campaign.fakes:FakeDetector"
STATES = states_with("truth")
SECONDS = 12
"""Every state is published once a second."""
DEADLY, BROKEN = 10_001, 10_002
"""Seeds of the missions with trouble."""


@dataclass
class Trouble:
    """What goes wrong.

    Attributes:
        dies: Processes of injected flights with seed `DEADLY` die as often as this folder has files; each takes one.
        golden_dies: The same of golden flights.
        dies_at: Only runs of this target's site die; "" = all.
        raises: Whether injected flights with seed `BROKEN` raise.
        stray: Added to a coordinate: another flight than the one that was planned (m).
        machine: The machine fails as often as this folder has files, whose names are numbers of errors (0 = memory).
        killed: Processes of flights with seed `DEADLY` are killed from outside as often as this folder has files.
    """

    dies: Path | None = None
    golden_dies: Path | None = None
    dies_at: str = ""
    raises: bool = False
    stray: float = 0.0
    machine: Path | None = None
    killed: Path | None = None


TROUBLE = Trouble()


class FakeDetector(Detector):
    """Watches nothing; `FakeFlights` raises its alarms."""

    def check(self, state, time_us):
        return None


class FakeHost(Host):
    name = "fake"
    levels = frozenset({"state", "instruction"})

    def resolve(self, spec: MissionSpec) -> Scenario:
        return resolve(spec)

    def mission(self, arms: dict[str, ArmSetup], *, fast_forward: bool = True) -> "FakeFlights":
        return FakeFlights(arms, fast_forward)


class StateHost(FakeHost):
    """One that injects into states only."""

    levels = frozenset({"state"})


class WildHost(FakeHost):
    """One whose flights cannot be flown again."""

    deterministic = False


class FakeFlights:
    """Flights of one mission; fast-forwarded ones come in another order."""

    def __init__(self, arms: dict[str, ArmSetup], fast_forward: bool) -> None:
        self.arms, self.fast_forward = arms, fast_forward
        self.known: dict[str, Flight] = {}
        self.detectors: dict[str, Any] = {}

    def golden(self, arm: str, *, profile: bool = False) -> Flight:
        scenario = self.arms[arm].scenario
        _fail()
        _die(TROUBLE.golden_dies, scenario.seed)
        if arm not in self.known:
            self.known[arm] = fly(self.arms[arm], self.detector(arm), None)
        return self.known[arm] if profile else Flight(self.known[arm].log)

    def detector(self, arm: str) -> Any:
        make = self.arms[arm].make_detector
        if arm not in self.detectors:
            self.detectors[arm] = None if make is None else make()
        return self.detectors[arm]

    def register_golden(self, arm: str, flight: Flight) -> None:
        self.known[arm] = flight

    def injected(self, runs: list[tuple[str, Fault]]) -> Iterator[tuple[int, Flight | Exception]]:
        order = list(enumerate(runs))
        for index, (arm, fault) in order[::-1] if self.fast_forward else order:
            setup = self.arms[arm]
            if TROUBLE.dies_at in fault.site:
                _die(TROUBLE.dies, setup.scenario.seed)
            _kill(setup.scenario.seed)
            try:
                _fail()
            except (OSError, MemoryError) as error:
                yield index, error
                continue
            if TROUBLE.raises and setup.scenario.seed == BROKEN:
                try:
                    raise ZeroDivisionError("a mistake of ours")
                except ZeroDivisionError as error:
                    yield index, error
            else:
                yield index, fly(setup, self.detector(arm), fault)


class ProgramRuns(FakeFlights):
    """Runs of a program without a mission, and so without a status."""

    def golden(self, arm: str, *, profile: bool = False) -> RunResult:
        flight = super().golden(arm, profile=profile)
        return RunResult(_without_status(flight), profile=flight.profile)

    def injected(self, runs: list[tuple[str, Fault]]) -> Iterator[tuple[int, RunResult]]:
        for index, flight in super().injected(runs):
            yield index, RunResult(_without_status(flight))


def _without_status(flight: Flight) -> FlightRecord:
    return replace(flight.record(), status="", flight_time_s=0.0)


class ProgramHost(FakeHost):
    """One whose runs are no flights."""

    flies = False

    def mission(self, arms: dict[str, ArmSetup], *, fast_forward: bool = True) -> ProgramRuns:
        return ProgramRuns(arms, fast_forward)


def fly(setup: ArmSetup, detector: Any, fault: Fault | None) -> Flight:
    """Later with each fault that changes something; a detector repairs, and raises false alarms at times."""
    scenario, seed = setup.scenario, setup.scenario.seed
    duration = 40.0 + seed % 7 + 10.0 * (scenario.environment.name == "dense") + 3.0 * (scenario.planner.name == "rrt")
    duration += scenario.wind.gust + (setup.recovery.coupling == "observer")
    injections = [] if fault is None else _inject(fault)
    changed = any(injection.activated and injection.bit is not None for injection in injections)
    alarms, status = [], MissionStatus.SUCCESS
    if changed and detector is None:
        roll = hashlib.sha256(f"{fault.site}{fault.bit}{seed}".encode()).digest()[0]
        status = MissionStatus.COLLISION if roll % 4 == 0 and fault.bit >= 31 else status
        duration *= 1.0 + roll / 255
    if changed and detector is not None:
        state = fault.where.state if isinstance(fault, StateFault) else "control.command"
        alarms.append(AlarmRecord(injections[0].time_s, "fake", state, "control", outcome="repaired"))
    if detector is not None and seed % 3 == 0:
        alarms.append(AlarmRecord(20.0, "fake", "control.command", Stage.CONTROL, outcome="accepted"))
    rows = np.zeros((30, len(COLUMNS)))
    rows[:, 0] = np.linspace(0, duration, 30)
    rows[:, 1] = np.linspace(TROUBLE.stray, 100, 30)
    rows[:, 4] = 100 / duration
    rows[:, 7] = 1
    meta = {
        "compute_us": {"octomap": 900_000, "pid": 100_000 + 289_000 * len(alarms)},
        "recompute_us": {"perception": 289_000 * len(alarms), "planning": 0, "control": 0},
        "publications": dict.fromkeys(STATES, SECONDS),
        "time_limit_s": 150.0,
        "course_m": 100.0,
    }
    log = FlightLog(rows, status, [Event(0, "plan"), Event(9, "plan")], injections, alarms, meta)
    return Flight(log, golden_profile(seed) if fault is None else None)


def _inject(fault: Fault) -> list[Injection]:
    if isinstance(fault, InstructionFault):
        return [Injection(fault.level, fault.site, 1.0, fault.bit, 0, 1, fault.has_site)]
    injector = StateInjector(fault)
    for state, time_us in publications(fault.where.state):
        injector(state, time_us)
    return list(injector.finish())


def publications(name: str):
    """A state at 1 s pitch; consumers act on every third collision status."""
    spec = STATES[name]
    for second in range(SECONDS):
        state = new_state(name, 3 if spec.elements else 0)
        if spec.acted_on:
            state.header[spec.acted_on] = second // 3
        yield state, 1_000_000 * second


def golden_profile(seed: int) -> Profile:
    """What `publications` would leave; in every fifth mission nobody acts on a collision status."""
    times = {name: np.arange(SECONDS, dtype=np.int64) * 1_000_000 for name in STATES}
    times["perception.collision_status"] = np.array([3, 6, 9] if seed % 5 else [], np.int64) * 1_000_000
    counts = {name: np.full(len(times[name]), 3 if spec.elements else 0, np.int32) for name, spec in STATES.items()}
    return Profile(times, counts)


def _token(folder: Path | None) -> str:
    """Name of a file of a folder, which is taken away; "" = there is none."""
    for token in sorted(folder.iterdir()) if folder is not None else ():
        with contextlib.suppress(FileNotFoundError):  # another worker took it
            token.unlink()
            return token.name
    return ""


def _fail() -> None:
    token = _token(TROUBLE.machine)
    if token:
        number = int(token.split(".")[0])
        raise MemoryError if number == 0 else OSError(number, os.strerror(number), "/cache/code.nbc")


def _kill(seed: int) -> None:
    if seed == DEADLY and _token(TROUBLE.killed):
        os.kill(os.getpid(), signal.SIGKILL)


def _die(folder: Path | None, seed: int) -> None:
    if folder is None or seed != DEADLY:
        return
    if _token(folder):
        os._exit(9)


def deaths(folder: Path, count: int) -> Path:
    """A folder that lets processes die so often."""
    folder.mkdir()
    for number in range(count):
        (folder / str(number)).touch()
    return folder


def failures(folder: Path, number: int, count: int) -> Path:
    """A folder that lets the machine fail so often with an error of that number."""
    folder.mkdir()
    for token in range(count):
        (folder / f"{number}.{token}").touch()
    return folder


def small(**changes) -> Campaign:
    """A campaign of two environments and one arm with a detector."""
    content = {
        "name": "small",
        "host": HOST,
        "environments": ["sparse", "dense"],
        "missions": 4,
        "faults": 6,
        "arms": {"gaussian": {"detector": DETECTOR}},
        **changes,
    }
    return Campaign.model_validate(content)


class OneByOne:
    """Local workers whose items are handed over one at a time: a campaign can be stopped after exactly so many runs."""

    forks = True

    def __init__(self, workers=1):
        self._executor = LocalExecutor(workers)
        self.workers = workers

    def map(self, function, missions):
        """See `Executor.map`."""
        with closing(self._executor.map(function, missions)) as batches:
            for mission, items in batches:
                for item in items:
                    yield mission, [item]
