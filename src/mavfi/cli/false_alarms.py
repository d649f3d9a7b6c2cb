"""Alarms of freshly trained models on error-free flights that they were not trained on."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from mavfi.campaign.config import TRAINING_SEED
from mavfi.campaign.executors.local import LocalPool, Lost
from mavfi.campaign.analysis.statistics import EventRate, event_rate_by_flight
from mavfi.campaign.tools import host_tools
from mavfi.campaign.training import ENVIRONMENT
from mavfi.detectors.model import Model
from mavfi.errors import MavfiError
from mavfi.mission import Scenario
from mavfi.qof import quality_of_flight

FIRST_SEED = TRAINING_SEED + 500_000
"""Far behind the seeds of training."""


@dataclass(frozen=True, slots=True)
class _Task:
    index: int
    kind: str
    profile: str
    folder: Path
    scenario: Scenario


def _fly(task: _Task) -> tuple[int, float]:
    """Alarms, and hours of flight."""
    tools = host_tools()
    detector, _ = tools.load_detector(task.kind, task.profile, task.folder, task.scenario)
    log = tools.fly(task.scenario, None, detector, want_profile=False).log
    return len(log.alarms), quality_of_flight(log).flight_time_s / 3600


def count_false_alarms(  # noqa: PLR0913 - what is flown, and how
    models: list[Model], folder: Path, flights: int, workers: int, stack: str, progress: Callable[[int, int], None]
) -> list[EventRate]:
    """Fly error-free missions with each model, and count its alarms.

    Args:
        models: Trained for one stack, platform, planner and speed limit.
        folder: Where their files are.
        flights: Missions for each model.
        workers: Processes.
        stack: Name or path of the stack.
        progress: Called with flights done and wanted.

    Returns:
        Alarms per flight hour by model.
    """
    origin = models[0].provenance
    tasks = []
    for seed in range(FIRST_SEED, FIRST_SEED + flights):
        scenario = host_tools().make_scenario(
            ENVIRONMENT, seed, stack=stack, platform=origin["platform"], planner=origin["planner"],
            v_max=origin["v_max"],
        )  # fmt: skip
        tasks += [_Task(index, model.kind, model.profile, folder, scenario) for index, model in enumerate(models)]
    counted: list[list[tuple[int, float]]] = [[] for _ in models]
    done = 0
    with closing(LocalPool(workers).run(_fly, tasks)) as results:
        for task, result in results:
            if isinstance(result, Lost):
                raise MavfiError(f"checking flight with seed {task.scenario.seed}: {result.reason}")
            counted[task.index].append(result)
            done += 1
            progress(done, len(tasks))
    return [
        event_rate_by_flight([events for events, _ in sorted(own)], [hours for _, hours in sorted(own)])
        for own in counted
    ]
