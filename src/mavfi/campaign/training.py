"""Flies the error-free missions that detectors are trained on, trains them, and counts their false alarms.

Recordings stay on disk until the models are saved, so that training can be resumed.
"""

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.campaign.config import TRAINING_SEED
from mavfi.campaign.executors.executor import map_each
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.fingerprint import code, versions
from mavfi.detectors import features
from mavfi.detectors.model import Model
from mavfi.detectors.preprocess import PROFILES
from mavfi.detectors.recorder import WATCHED, Recorder, Recording
from mavfi.detectors.registry import ONLY_PROFILE, of_all_fields, of_monitored_fields
from mavfi.errors import BadInputError
from mavfi.extras.bench.field_codes import CodeRecorder, Codes, codes_are_whole
from mavfi.files import check_folder
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.flight.watching import detector_for
from mavfi.mission import MissionSpec, MissionStatus, Scenario
from mavfi.outcomes import quality_of_flight
from mavfi.record import read_arrays

ENVIRONMENT = "training"  # randomised worlds; excludes the generators of the evaluation environments
FAMILIES = (ENVIRONMENT, "factory")
"""An environment of each family: limits of all fields that are learned in one do not hold in the other."""
CHECKING_SEED = TRAINING_SEED + 500_000
"""First seed of the flights on which false alarms are counted, far beyond those of training."""
Progress = Callable[[int, int], None]
_MOST_FLIGHTS_PER_WANTED = 3
FOLDER = ".flights"  # folder of the recordings, in the folder of the models
_PARTS = tuple(Recording.__annotations__)


class KeptRecordings:
    """Recordings by seed, in a subfolder named by a hash of scenario, versions and code of mavfi."""

    def __init__(self, folder: Path, scenario: Scenario, *, codes: bool = True) -> None:
        self._parent = folder / FOLDER
        self._folder = self._parent / _key(scenario, codes)

    def load(self, seeds: Iterable[int]) -> dict[int, Recording]:
        """Load the recordings of these seeds; an unreadable file counts as absent."""
        found = {}
        for seed in seeds:
            try:
                arrays = read_arrays(self._path(seed))
                recording = Recording(*(arrays[name] for name in _PARTS))
            except (BadInputError, KeyError):
                continue
            if _is_whole(recording):
                found[seed] = recording
        return found

    def save(self, seed: int, recording: Recording) -> None:
        """Write a recording atomically; raises a BadInputError if the folder cannot be written."""
        path = self._path(seed)
        part = path.with_suffix(".part")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with part.open("wb") as file:
                np.savez_compressed(file, **{name: getattr(recording, name) for name in _PARTS})
            os.replace(part, path)
        except OSError as error:
            raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None

    def delete(self) -> None:
        """Remove these recordings, and the parent folder if it is then empty."""
        shutil.rmtree(self._folder, ignore_errors=True)
        with contextlib.suppress(OSError):  # absent, or used by another training
            self._parent.rmdir()

    def _path(self, seed: int) -> Path:
        return self._folder / f"{seed}.npz"


def _is_whole(recording: Recording) -> bool:
    """Whether the parts have the types of a recording, and are consistent."""
    parts = [getattr(recording, name) for name in _PARTS]
    types = [np.int8, np.int64, np.uint8, np.int8, np.int8, np.int16]
    if [part.dtype for part in parts] != types or any(part.ndim != 1 for part in parts):
        return False
    if not codes_are_whole(Codes(parts[3], parts[4], parts[5])):
        return False
    kinds, ends = recording.kinds, len(WATCHED)
    if len(kinds) != len(recording.times_us) or ((kinds < features.ODOMETRY) | (kinds >= ends)).any():
        return False
    return int(recording.ends[-1]) == len(recording.content) if len(kinds) else not len(recording.content)


def _key(scenario: Scenario, codes: bool) -> str:
    """Hash of all inputs of a recording except the seed."""
    own = scenario.model_copy(update={"seed": 0}).key()
    parts = {"scenario": own, "codes": codes, "versions": versions(), "code": code()}
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class _Task:
    """A flight; its text appears in the message about a lost worker."""

    scenario: Scenario
    model: Model | None = None
    folder: Path | None = None
    codes: bool = True  # record the codes of all fields, too

    def __str__(self) -> str:
        return f"{'training' if self.model is None else 'checking'} flight with seed {self.scenario.seed}"


def training_mission(mission: MissionSpec, seed: int = TRAINING_SEED, environment: str = ENVIRONMENT) -> Scenario:
    """The mission in a training world; autopilot profile, platform, planner etc. are unchanged.

    Raises:
        BadInputError: A name is unknown, or options are incompatible.
    """
    world = {"environment": environment, "seed": seed, "start": None, "goal": None}
    return resolve(mission.model_copy(update=world))


def record_flight(task: _Task) -> Recording | None:
    """Fly one error-free mission; returns None if it misses its goal."""
    recorder, code_recorder = Recorder(), CodeRecorder(task.scenario.autopilot.name) if task.codes else None
    accept = [recorder.accept] if code_recorder is None else [recorder.accept, code_recorder.accept]
    if fly(task.scenario, recorders=accept).log.status is not MissionStatus.SUCCESS:
        return None
    if code_recorder is None:
        return recorder.recording()
    codes = code_recorder.codes()
    return replace(recorder.recording(), slots=codes.slots, regimes=codes.regimes, codes=codes.own)


def record_flights(
    scenario: Scenario, count: int, workers: int, progress: Progress | None = None,
    disk: KeptRecordings | None = None, *, codes: bool = True,
) -> dict[int, Recording]:  # fmt: skip
    """Fly missions with consecutive seeds, starting with the scenario's, until `count` have reached their goals.

    Recordings are stored on `disk`, if given, so that a stop loses only the flights in progress; `progress` is called
    with the numbers of recorded and required flights, for the first time before the first flight.  With `codes`, they
    include those of all fields.

    Returns:
        Recordings by seed, ascending; they do not depend on the number of workers.

    Raises:
        BadInputError: `count` is below 1, or too few missions reach their goals.
        MavfiError: A worker was lost.
    """
    if count < 1:
        raise BadInputError(f"flights: {count}; allowed: 1 or more")
    executor = LocalExecutor(workers)
    report = progress or (lambda *_: None)
    kept: dict[int, Recording] = {}
    tried = 0
    while len(kept) < count:
        if tried >= _MOST_FLIGHTS_PER_WANTED * count:
            raise BadInputError(f"training: only {len(kept)} of {tried} missions reached their goals; {count} wanted")
        seeds = range(scenario.seed + tried, scenario.seed + tried + count - len(kept))
        tasks = [_Task(scenario.model_copy(update={"seed": seed}), codes=codes) for seed in seeds]
        kept |= {} if disk is None else disk.load(seeds)
        report(len(kept), count)
        tasks = [task for task in tasks if task.scenario.seed not in kept]
        if tasks and tried == 0:
            record_flight(tasks[0])  # compiles in this process; workers inherit the code
        tried += len(seeds)
        for task, recording in map_each(executor, record_flight, tasks):
            if recording is None:
                continue
            kept[task.scenario.seed] = recording
            if disk is not None:
                disk.save(task.scenario.seed, recording)
            report(len(kept), count)
    return dict(sorted(kept.items()))


@dataclass(frozen=True, slots=True)
class Training:
    """Recorded flights, and what is to be fitted to them."""

    folder: Path
    recordings: dict[str, dict[int, Recording]]  # by environment and seed
    provenance: dict[str, Any]
    disks: list[KeptRecordings]
    extras: Sequence[str]
    only: Collection[tuple[str, str]] | None
    alike: bool  # whether detectors of monitored fields are fitted to all environments, too, not to the first one alone

    def __str__(self) -> str:
        return f"training of detectors for {self.provenance['platform']}"

    def fit(self) -> list[Path]:
        """Fit the detectors, write the models, and delete the recordings on disk.

        Raises:
            BadInputError: The folder cannot be written.
        """
        from mavfi.detectors.training import fit, save  # imports every trainable detector

        of_all = {(name, ONLY_PROFILE) for name in of_all_fields(self.extras)}
        monitored = {(name, profile) for name in of_monitored_fields() for profile in PROFILES}
        every = list(self.recordings)
        found: dict[str, Model] = {}
        for environments, kinds in ((every, of_all), (every if self.alike else every[:1], monitored)):
            flown = [self.recordings[name] for name in environments]
            origin = self.provenance | {
                "environment": ", ".join(environments), "flights": sum(map(len, flown)),
                "seeds": [seed for own in flown for seed in own],
            }  # fmt: skip
            only = kinds if self.only is None else kinds.intersection(self.only)
            found |= fit([one for own in flown for one in own.values()], origin, extras=self.extras, only=only)
        files = save(found, self.folder)
        for disk in self.disks:
            disk.delete()
        return files


def record(
    folder: Path, flights: int = 100, mission: MissionSpec | None = None, *, workers: int = 2,
    progress: Progress | None = None, environments: Sequence[str] = (), extras: Sequence[str] = (),
    only: Collection[tuple[str, str]] | None = None,
) -> Training:  # fmt: skip
    """Fly error-free missions to train detectors on.

    Recordings are kept in the folder until the models are written: the same call resumes an interrupted training.

    Args:
        folder: Output folder of the models.
        flights: Successful missions per environment.
        mission: Options of the missions; environment, seed, start and goal are set by training.
        workers: Number of processes; the models do not depend on it.
        progress: Called with the numbers of recorded and required flights, for each environment in turn.
        environments: Environments of the missions; empty = `FAMILIES` for detectors of all fields, the first of them
            for those of monitored fields.
        extras: Optional dependencies whose detectors are fitted, too: "bench".
        only: Detectors to fit, as (name, profile); None = all in every profile.

    Raises:
        BadInputError: A name is unknown, too few flights arrive, or the folder cannot be written.
    """
    for detector in of_all_fields(extras).values():
        detector.check_installed()

    check_folder(folder)
    codes = only is None or any((name, ONLY_PROFILE) in only for name in of_all_fields(extras))
    names = environments or (FAMILIES if codes else FAMILIES[:1])
    scenarios = [training_mission(mission or MissionSpec(), environment=name) for name in names]
    disks = [KeptRecordings(folder, scenario, codes=codes) for scenario in scenarios]
    flown = [
        record_flights(scenario, flights, workers, progress, disk, codes=codes)
        for scenario, disk in zip(scenarios, disks, strict=True)
    ]
    scenario = scenarios[0]
    provenance = {
        "stack": scenario.autopilot.name,
        "platform": scenario.platform.name,
        "v_max": scenario.v_max,
        "planner": scenario.planner.name,
    }
    recordings = dict(zip(names, flown, strict=True))
    return Training(folder, recordings, provenance, disks, extras, only, alike=bool(environments))


def train(folder: Path, flights: int = 100, mission: MissionSpec | None = None, **more: Any) -> list[Path]:  # noqa: ANN401
    """Fly error-free missions, fit every detector in every profile, and write the models; see `record`."""
    return record(folder, flights, mission, **more).fit()


def count_false_alarms(
    models: Sequence[Model], folder: Path, flights: int, mission: MissionSpec, workers: int, progress: Progress,
    environments: Sequence[str] = (ENVIRONMENT,),
) -> list[dict[str, list[tuple[int, float]]]]:  # fmt: skip
    """Alarms and flight hours by flight of each model in the folder by environment, on error-free missions.

    The missions have other seeds than those of the training.

    Each environment has `flights` missions, flown as in `train`; `progress` is called with the numbers of completed
    and required flights.

    Raises:
        MavfiError: A worker was lost.
    """
    seeds = range(CHECKING_SEED, CHECKING_SEED + flights)
    places = [(name, training_mission(mission, seed, name)) for name in environments for seed in seeds]
    tasks = [_Task(scenario, model, folder) for _, scenario in places for model in models]
    counted: dict[tuple[str, str], list[tuple[int, float]]] = {}
    for done, (task, result) in enumerate(map_each(LocalExecutor(workers), _count_alarms, tasks), 1):
        assert task.model is not None  # only these are counted
        counted.setdefault((task.model.sha256, task.scenario.environment.name), []).append(result)
        progress(done, len(tasks))

    return [{name: sorted(counted.get((model.sha256, name), [])) for name in environments} for model in models]


def _count_alarms(task: _Task) -> tuple[int, float]:
    """Fly one mission; returns the number of alarms and the flight hours."""
    assert task.model is not None  # only these are counted
    detector, _ = detector_for(task.scenario, task.model.kind, task.model.profile, task.folder)
    log = fly(task.scenario, detector=detector).log
    return len(log.alarms), quality_of_flight(log).flight_time_s / 3600
