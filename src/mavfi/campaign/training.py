"""Flies the error-free missions that detectors are trained on, trains them, and counts their false alarms.

Recordings stay on disk until the models are saved, so that training can be resumed.
"""

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.campaign.config import TRAINING_SEED
from mavfi.campaign.executors.executor import map_each
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.fingerprint import code, versions
from mavfi.detectors.model import FITTED_TO, Model
from mavfi.detectors.registry import figures_of, trainable
from mavfi.detectors.training import MONITORED_FIELDS, Training
from mavfi.errors import BadInputError
from mavfi.files import check_folder
from mavfi.flight.compose import detector_for, resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec, MissionStatus, Scenario
from mavfi.outcomes import quality_of_flight
from mavfi.record import read_arrays

CHECKING_SEED = TRAINING_SEED + 500_000
"""First seed of the flights on which false alarms are counted, far beyond those of training."""
Progress = Callable[[int, int], None]
Recorded = tuple[Any, ...]
"""What was recorded of one flight, for each training in turn."""
_MOST_FLIGHTS_PER_WANTED = 3
"""Largest number of missions flown for each that must reach its goal."""
FOLDER = ".flights"
"""Folder of the recordings, in the folder of the models."""


class KeptRecordings:
    """Recordings by seed, in a subfolder named by a hash of scenario, trainings, versions and code of mavfi."""

    def __init__(self, folder: Path, scenario: Scenario, trainings: Sequence[Training] = (MONITORED_FIELDS,)) -> None:
        self._trainings = trainings
        self._parent = folder / FOLDER
        self._folder = self._parent / _key(scenario, trainings)

    def load(self, seeds: Iterable[int]) -> dict[int, Recorded]:
        """Load the recordings of these seeds; an unreadable file counts as absent."""
        recordings = {}
        for seed in seeds:
            try:
                arrays = read_arrays(self._path(seed))
                recorded = tuple(
                    training.parts(*(arrays[name] for name in training.parts._fields)) for training in self._trainings
                )
            except (BadInputError, KeyError):
                continue
            if all(training.is_whole(part) for training, part in zip(self._trainings, recorded, strict=True)):
                recordings[seed] = recorded
        return recordings

    def save(self, seed: int, recorded: Recorded) -> None:
        """Write a recording atomically; raises a BadInputError if the folder cannot be written."""
        path = self._path(seed)
        unfinished = path.with_suffix(".part")
        arrays: dict[str, Any] = {}
        for part in recorded:
            arrays |= part._asdict()
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with unfinished.open("wb") as file:
                np.savez_compressed(file, **arrays)
            os.replace(unfinished, path)
        except OSError as error:
            raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None

    def delete(self) -> None:
        """Remove these recordings, and the parent folder if it is then empty."""
        shutil.rmtree(self._folder, ignore_errors=True)
        with contextlib.suppress(OSError):  # absent, or used by another training
            self._parent.rmdir()

    def _path(self, seed: int) -> Path:
        return self._folder / f"{seed}.npz"


def _key(scenario: Scenario, trainings: Sequence[Training]) -> str:
    """Hash of all inputs of a recording except the seed."""
    arrays = [name for training in trainings for name in training.parts._fields]
    scenario_key = scenario.model_copy(update={"seed": 0}).key()
    parts = {"scenario": scenario_key, "arrays": arrays, "versions": versions(), "code": code()}
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class _FlightTask:
    """A flight; its text appears in the message about a lost worker."""

    scenario: Scenario
    model: Model | None = None
    folder: Path | None = None
    trainings: Sequence[Training] = ()

    def __str__(self) -> str:
        purpose = "training" if self.model is None else "checking"
        return f"{purpose} flight with seed {self.scenario.seed}"


def training_mission(mission: MissionSpec, seed: int = TRAINING_SEED, environment: str = "training") -> Scenario:
    """The mission in a training world; autopilot profile, platform, planner etc. are unchanged.

    Raises:
        BadInputError: A name is unknown, or options are incompatible.
    """
    world = {"environment": environment, "seed": seed, "start": None, "goal": None}
    return resolve(mission.model_copy(update=world))


def trainings_of(only: Collection[tuple[str, str]] | None = None) -> tuple[Training, ...]:
    """The trainings of the detectors that are to be fitted; `only` as for `record`."""
    classes = trainable()
    names: Collection[str] = classes
    if only is not None:
        names = {name for name, _ in only}
    return tuple(dict.fromkeys(detector.training for name, detector in classes.items() if name in names))


def environments_of(trainings: Iterable[Training]) -> list[str]:
    """Environments of the flights by default."""
    return list(dict.fromkeys(name for training in trainings for name in training.environments))


def record_flight(task: _FlightTask) -> Recorded | None:
    """Fly one error-free mission; returns None if it misses its goal."""
    recorders = [training.recorder(task.scenario.autopilot.name) for training in task.trainings]
    log = fly(task.scenario, recorders=[recorder.accept for recorder in recorders]).log
    if log.status is not MissionStatus.SUCCESS:
        return None
    return tuple(recorder.recording() for recorder in recorders)


def record_flights(
    scenario: Scenario,
    count: int,
    workers: int,
    progress: Progress | None = None,
    disk: KeptRecordings | None = None,
    trainings: Sequence[Training] = (MONITORED_FIELDS,),
) -> dict[int, Recorded]:
    """Fly missions with consecutive seeds, starting with the scenario's, until `count` have reached their goals.

    Recordings are stored on `disk`, if given, so that a stop loses only the flights in progress; `progress` is called
    with the numbers of recorded and required flights, for the first time before the first flight.

    Returns:
        What the trainings need of each flight, by seed, ascending; it does not depend on the number of workers.

    Raises:
        BadInputError: `count` is below 1, or too few missions reach their goals.
        MavfiError: A worker was lost.
    """
    if count < 1:
        raise BadInputError(f"flights: {count}; allowed: 1 or more")
    executor = LocalExecutor(workers)
    report = progress or (lambda *_: None)
    by_seed: dict[int, Recorded] = {}
    tried = 0
    while len(by_seed) < count:
        if tried >= _MOST_FLIGHTS_PER_WANTED * count:
            raise BadInputError(
                f"training: only {len(by_seed)} of {tried} missions reached their goals; {count} wanted"
            )
        # As many seeds as successful flights are missing: which ones are flown does not depend on the workers.
        seeds = range(scenario.seed + tried, scenario.seed + tried + count - len(by_seed))
        if disk is not None:
            by_seed |= disk.load(seeds)
        report(len(by_seed), count)
        missions = [scenario.model_copy(update={"seed": seed}) for seed in seeds if seed not in by_seed]
        tasks = [_FlightTask(mission, trainings=trainings) for mission in missions]
        if tasks and tried == 0:
            record_flight(tasks[0])  # compiles in this process; workers inherit the code
        tried += len(seeds)
        for task, recorded in map_each(executor, record_flight, tasks):
            if recorded is None:
                continue
            by_seed[task.scenario.seed] = recorded
            if disk is not None:
                disk.save(task.scenario.seed, recorded)
            report(len(by_seed), count)
    return dict(sorted(by_seed.items()))


@dataclass(frozen=True, slots=True)
class RecordedFlights:
    """Recorded flights, and what is to be fitted to them.

    Attributes:
        folder: Of the models.
        trainings: Those for which the flights were recorded.
        flights: What was recorded, by environment and seed.
        provenance: Origin of the models, without seeds.
        disks: Copies of the recordings.
        only: See `record`.
        fits_all_environments: Whether all detectors are fitted to all environments, not to those of their training.
    """

    folder: Path
    trainings: Sequence[Training]
    flights: dict[str, dict[int, Recorded]]
    provenance: dict[str, Any]
    disks: list[KeptRecordings]
    only: Collection[tuple[str, str]] | None
    fits_all_environments: bool

    def __str__(self) -> str:
        return f"training of detectors for {self.provenance['platform']}"

    def fit(self) -> list[Path]:
        """Fit the detectors, write the models, and delete the recordings on disk.

        Raises:
            BadInputError: The folder cannot be written.
        """
        models: dict[str, Model] = {}
        for number, training in enumerate(self.trainings):
            environments = training.environments
            if self.fits_all_environments:
                environments = tuple(self.flights)

            # the recordings of this training, and where they come from
            seeds: list[int] = []
            recordings = []
            for name in environments:
                for seed, recorded in self.flights[name].items():
                    seeds.append(seed)
                    recordings.append(recorded[number])
            provenance = self.provenance | {
                "environment": ", ".join(environments),
                "flights": len(recordings),
                "seeds": seeds,
            }
            models |= fit(training, recordings, provenance, self.only)
        files = [model.save(self.folder) for model in models.values()]
        for disk in self.disks:
            disk.delete()
        return files


def fit(
    training: Training,
    recordings: Sequence[Any],
    provenance: Mapping[str, Any],
    only: Collection[tuple[str, str]] | None = None,
) -> dict[str, Model]:
    """Fit the detectors of a kind of training.

    Args:
        training: The training.
        recordings: Its recordings of error-free flights.
        provenance: Origin of the flights: `stack` (the autopilot profile), platform, v_max, planner, and further keys
            (seeds, flights).
        only: See `record`.

    Returns:
        Models by "<kind>-<profile>".  Identical recordings give identical models.

    Raises:
        BadInputError: See `Training.fit`.
    """
    missing = [key for key in FITTED_TO if key not in provenance]
    if missing:
        raise BadInputError(f"provenance of a model: lacks {', '.join(missing)}")
    origin = {**provenance, "versions": {name: version(name) for name in ("numpy", "scikit-learn")}}
    classes = {name: detector for name, detector in trainable().items() if detector.training == training}
    models = {}
    for profile in training.profiles:
        fitted = {name: detector for name, detector in classes.items() if only is None or (name, profile) in only}
        if fitted:
            figures = {name: figures_of(name, profile) for name in fitted}
            for model in training.fit(fitted, profile, recordings, origin, figures):
                models[f"{model.kind}-{profile}"] = model
    return models


def record(
    folder: Path,
    flights: int = 100,
    mission: MissionSpec | None = None,
    *,
    workers: int = 2,
    progress: Progress | None = None,
    environments: Sequence[str] = (),
    only: Collection[tuple[str, str]] | None = None,
) -> RecordedFlights:
    """Fly error-free missions to train detectors on.

    Recordings are kept in the folder until the models are written: the same call resumes an interrupted training.

    Args:
        folder: Output folder of the models.
        flights: Successful missions per environment.
        mission: Options of the missions; environment, seed, start and goal are set by training.
        workers: Number of processes; the models do not depend on it.
        progress: Called with the numbers of recorded and required flights, for each environment in turn.
        environments: Environments of the missions; empty = those of each detector's training.
        only: Detectors to fit, as (name, profile); None = all in every profile.

    Raises:
        BadInputError: A name is unknown, too few flights arrive, or the folder cannot be written.
    """
    # Refuse before the first flight what would fail after the last.
    check_folder(folder)

    # Fly the missions of all environments.
    trainings = trainings_of(only)
    scenarios = {
        name: training_mission(mission or MissionSpec(), environment=name)
        for name in environments or environments_of(trainings)
    }
    disks = [KeptRecordings(folder, scenario, trainings) for scenario in scenarios.values()]
    recordings = {
        name: record_flights(scenario, flights, workers, progress, disk, trainings)
        for (name, scenario), disk in zip(scenarios.items(), disks, strict=True)
    }

    # What the models are fitted to is the same in all environments.
    scenario = next(iter(scenarios.values()))
    provenance = {
        "stack": scenario.autopilot.name,
        "platform": scenario.platform.name,
        "v_max": scenario.v_max,
        "planner": scenario.planner.name,
    }
    return RecordedFlights(
        folder,
        trainings,
        recordings,
        provenance,
        disks,
        only,
        fits_all_environments=bool(environments),
    )


def count_false_alarms(
    models: Sequence[Model],
    folder: Path,
    flights: int,
    mission: MissionSpec,
    workers: int,
    progress: Progress,
    environments: Sequence[str] = ("training",),
) -> list[dict[str, list[tuple[int, float]]]]:
    """Count the alarms of models on error-free missions with other seeds than those of the training.

    Each environment has `flights` missions, flown as in `train`; `progress` is called with the numbers of completed
    and required flights.

    Returns:
        For each model, by environment: alarms and flight hours of each mission.

    Raises:
        MavfiError: A worker was lost.
    """
    seeds = range(CHECKING_SEED, CHECKING_SEED + flights)
    scenarios = [training_mission(mission, seed, name) for name in environments for seed in seeds]
    tasks = [_FlightTask(scenario, model, folder) for scenario in scenarios for model in models]
    counted: dict[tuple[str, str], list[tuple[int, float]]] = {}
    progress(0, len(tasks))
    for done, (task, result) in enumerate(map_each(LocalExecutor(workers), _count_alarms, tasks), 1):
        assert task.model is not None  # only these are counted
        counted.setdefault((task.model.sha256, task.scenario.environment.name), []).append(result)
        progress(done, len(tasks))

    return [{name: sorted(counted.get((model.sha256, name), [])) for name in environments} for model in models]


def _count_alarms(task: _FlightTask) -> tuple[int, float]:
    """Fly one mission; returns the number of alarms and the flight hours."""
    assert task.model is not None  # only these are counted
    detector, _ = detector_for(task.scenario, task.model.kind, task.model.profile, task.folder)
    log = fly(task.scenario, detector=detector).log
    return len(log.alarms), quality_of_flight(log).flight_time_s / 3600
