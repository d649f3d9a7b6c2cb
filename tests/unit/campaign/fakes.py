"""A flight of a few microseconds with the interface of the real one: what the campaign layer is tested with."""

import contextlib
import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from mavfi.campaign.config import Campaign
from mavfi.campaign.worker import Tools
from mavfi.errors import BadInputError
from mavfi.faults.state import StateInjector
from mavfi.flight_log import COLUMNS, Event, FlightLog, Profile
from mavfi.hosts.compose import make_scenario
from mavfi.mission import MissionStatus
from mavfi.states import new_state, states_with

MODEL = "0123456789abcdef"
STATES = states_with("truth")


@dataclass
class Trouble:
    """What goes wrong in flights with a fault of a seed; workers are forked and so know what a test has set."""

    dies: Path | None = None
    """Workers of flights with a fault and seed 10,001 die as often as this folder has files; each takes one."""
    raises: int | None = None
    """Seed whose faulty flights raise."""


TROUBLE = Trouble()


@dataclass
class FakeFlight:
    log: FlightLog
    profile: Profile | None


class FakeDetector:
    pass


def publications():
    """Every state at 1 s pitch; consumers act on every third collision status."""
    for second in range(12):
        for name, spec in STATES.items():
            state = new_state(name, 3 if spec.elements else 0)
            if spec.acted_on:
                state.header[spec.acted_on] = second // 3
            yield state, 1_000_000 * second


def golden_profile(seed: int) -> Profile:
    times = {name: np.arange(12, dtype=np.int64) * 1_000_000 for name in STATES}
    times["perception.collision_status"] = np.array([3, 6, 9] if seed % 5 else [], np.int64) * 1_000_000
    counts = {name: np.full(len(times[name]), 3 if spec.elements else 0, np.int32) for name, spec in STATES.items()}
    return Profile(times, counts)


def fly(scenario, fault, detector, *, want_profile):
    seed = scenario.seed
    duration = 40.0 + seed % 7 + 10.0 * (scenario.environment.name == "dense")
    status, injections, alarms = MissionStatus.SUCCESS, [], []
    if fault is not None:
        _trouble(seed)
        injector = StateInjector(fault)
        changed = False
        for state, time_us in publications():
            changed |= not injector(state, time_us).same_bits(state)
        injections = [injection.to_json() for injection in injector.finish()]
        if changed and detector is None:
            roll = hashlib.sha256(f"{fault.site}{fault.bit}{seed}".encode()).digest()[0]
            status = MissionStatus.COLLISION if roll % 4 == 0 and fault.bit >= 31 else status
            duration *= 1.0 + roll / 255
        if changed and detector is not None:
            time_s = injections[0]["time_s"]
            alarms = [
                {
                    "time_s": time_s,
                    "state": fault.site.state,
                    "source": "fake",
                    "action": "recompute",
                    "outcome": "repaired",
                }
            ]
    if detector is not None and seed % 3 == 0:
        alarms.append(
            {"time_s": 20.0, "state": "control.command", "source": "fake", "action": "recompute", "outcome": "accepted"}
        )
    rows = np.zeros((30, len(COLUMNS)))
    rows[:, 0] = np.linspace(0, duration, 30)
    rows[:, 1] = np.linspace(0, 100, 30)
    rows[:, 4] = 100 / duration
    rows[:, 7] = 1
    meta = {
        "compute_us": {"octomap": 900_000, "pid": 100_000 + 289_000 * len(alarms)},
        "recompute_us": {"perception": 289_000 * len(alarms), "planning": 0, "control": 0},
        "publications": dict.fromkeys(STATES, 12),
        "time_limit_s": 150.0,
    }
    log = FlightLog(rows, status, [Event(0, "plan"), Event(9, "plan")], injections, alarms, meta)
    return FakeFlight(log, golden_profile(seed) if want_profile else None)


def _trouble(seed: int) -> None:
    if TROUBLE.raises == seed:
        raise ZeroDivisionError("a mistake of ours")
    if TROUBLE.dies is not None and seed == 10_001:
        for token in TROUBLE.dies.iterdir():
            with contextlib.suppress(FileNotFoundError):  # another worker took it
                token.unlink()
                os._exit(9)


def deaths(folder: Path, count: int) -> Path:
    """A folder that lets workers die so often."""
    folder.mkdir()
    for number in range(count):
        (folder / str(number)).touch()
    return folder


def load_detector(detector, profile, models_dir, scenario):
    if detector == "nonsense":
        raise BadInputError("detector 'nonsense': not known")
    return FakeDetector(), MODEL if models_dir is None else models_dir.name


FAKE = Tools(fly, load_detector, make_scenario)


class FakeFamily:
    """Flies the long way, and notes in which process the flights of a mission were."""

    flown: ClassVar[Path | None] = None

    def __init__(self, scenario):
        self.scenario = scenario

    def fly(self, fault, detector, arm):
        if FakeFamily.flown is not None:
            world = f"{self.scenario.environment.name}-{self.scenario.seed}"
            (FakeFamily.flown / f"{world}.{os.getpid()}").touch()
        return fly(self.scenario, fault, detector, want_profile=fault is None and detector is None)


FORKING = Tools(fly, load_detector, make_scenario, FakeFamily)


def small(**changes) -> Campaign:
    content = {
        "name": "small",
        "environments": ["sparse", "dense"],
        "flights": 4,
        "faults": 6,
        "detectors": {"gaussian": {"detector": "fake"}},
        **changes,
    }
    return Campaign.model_validate(content)
