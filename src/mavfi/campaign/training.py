"""Flies the error-free missions that detectors are trained on, and trains them."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from mavfi.campaign.config import TRAINING_SEED
from mavfi.campaign.executors.local import LocalPool, Lost
from mavfi.campaign.recordings import KeptRecordings
from mavfi.campaign.tools import host_tools
from mavfi.campaign.worker import Tools
from mavfi.detectors.recorder import Recorder, Recording
from mavfi.errors import BadInputError, MavfiError
from mavfi.mission import MissionStatus, Scenario

ENVIRONMENT = "training"
"""Randomised worlds; the laws of the evaluation environments are not among them."""
_MOST_FLIGHTS_PER_WANTED = 3


@dataclass(frozen=True, slots=True)
class _Task:
    scenario: Scenario
    tools: Tools


def record_flight(task: _Task) -> Recording | None:
    """Fly one error-free mission; None if it did not reach its goal."""
    recorder = Recorder()
    flight = task.tools.fly(task.scenario, None, recorder, want_profile=False)
    return recorder.recording() if flight.log.status is MissionStatus.SUCCESS else None


def record_flights(  # noqa: PLR0913 - what is flown, and what is told of it
    scenario: Scenario,
    count: int,
    workers: int,
    tools: Tools,
    progress: Callable[[int, int], None] | None = None,
    disk: KeptRecordings | None = None,
) -> dict[int, Recording]:
    """Fly until `count` missions have reached their goals.

    Args:
        scenario: Mission whose seed is the first one.
        count: Flights wanted.
        workers: Number of processes; the result does not depend on it.
        tools: What is flown with.
        progress: Called with flights kept and wanted, for the first time before anything is flown.
        disk: Where recordings are kept, so that stopping loses only the flights in the air; None = nowhere.

    Returns:
        Recordings by seed, ascending.

    Raises:
        BadInputError: `count` is below 1, or too few missions reach their goals.
        MavfiError: A worker was lost.
    """
    if count < 1:
        raise BadInputError(f"flights: {count}; allowed: 1 or more")
    tell = progress or _silent
    kept: dict[int, Recording] = {}
    tried = 0
    warm = False
    while len(kept) < count:
        if tried >= _MOST_FLIGHTS_PER_WANTED * count:
            raise BadInputError(f"training: only {len(kept)} of {tried} missions reached their goals; {count} wanted")
        seeds = range(scenario.seed + tried, scenario.seed + tried + count - len(kept))
        tried += len(seeds)
        if disk is not None:
            kept |= disk.load(seeds)
        tell(len(kept), count)
        tasks = [_Task(scenario.model_copy(update={"seed": seed}), tools) for seed in seeds if seed not in kept]
        if tasks and not warm:
            record_flight(tasks[0])  # compiles in this process, and workers inherit it
            warm = True
        with closing(LocalPool(workers).run(record_flight, tasks)) as results:
            for task, recording in results:
                if isinstance(recording, Lost):
                    raise MavfiError(f"training flight with seed {task.scenario.seed}: {recording.reason}")
                if recording is None:
                    continue
                kept[task.scenario.seed] = recording
                if disk is not None:
                    disk.save(task.scenario.seed, recording)
                tell(len(kept), count)
    return dict(sorted(kept.items()))


def train(  # noqa: PLR0913 - what models are trained for, and how
    folder: Path,
    flights: int = 100,
    *,
    stack: str = "published",
    platform: str = "i9-9940x",
    planner: str = "rrt_connect",
    v_max: float | None = None,
    workers: int = 2,
    tools: Tools | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Fly error-free missions in randomised worlds, fit every detector in every profile, and write the models.

    Flights are kept in the folder until the models are written: the same call goes on where it was stopped.

    Args:
        folder: Where the models are written.
        flights: Missions that reach their goals.
        stack: Name or path of the stack.
        platform: Name or path of the modelled computer.
        planner: Name of the planner.
        v_max: Speed limit (m/s); None = the default.
        workers: Number of processes; the models do not depend on it.
        tools: None = the in-process host.
        progress: Called with flights kept and wanted.

    Returns:
        The files.

    Raises:
        BadInputError: A name is not known, too few flights arrive, or the folder cannot be written.
    """
    from mavfi.detectors.training import fit, save  # scikit-learn takes a second to load; only training needs it

    _check_writable(folder)
    tools = tools or host_tools()
    scenario = tools.make_scenario(
        ENVIRONMENT, TRAINING_SEED, stack=stack, platform=platform, planner=planner, v_max=v_max
    )
    disk = KeptRecordings(folder, scenario)
    recordings = record_flights(scenario, flights, workers, tools, progress, disk)
    provenance = {
        "stack": scenario.stack.name,
        "platform": scenario.platform.name,
        "v_max": scenario.v_max,
        "planner": scenario.planner.name,
        "environment": ENVIRONMENT,
        "flights": flights,
        "seeds": list(recordings),
    }
    files = save(fit(list(recordings.values()), provenance), folder)
    disk.delete()
    return files


def _silent(_: int, __: int) -> None:
    """Tell nobody."""


def _check_writable(folder: Path) -> None:
    """Fail before the flights, not after them."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".mavfi-probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise BadInputError(f"{folder}: cannot be written ({error.strerror})") from None
