"""Runs of a kernel campaign: golden ones that count and draw, and those with faults, several from one."""

import time
from dataclasses import replace

from mavfi.campaign.kernel_plan import DRAWN
from mavfi.campaign.kernel_profiles import KEY
from mavfi.campaign.plan import RunSpec
from mavfi.campaign.worker import RunResult, Task, detector_of, plain, record_of, run_guarded, run_task

_flown: dict[str, RunResult] = {}
"""Runs that were flown with one that was asked for, and are not asked for yet."""


def run_any(task: Task) -> RunResult:
    """Fly a run of any level and record it.

    Args:
        task: The run.
    """
    if is_struck(task.spec):
        return run_guarded(lambda: _struck(task))
    if task.draws:
        return run_guarded(lambda: _counted(task))
    return run_task(task)


def is_struck(spec: RunSpec) -> bool:
    """Whether a run has a fault in an instruction."""
    return spec.fault is not None and spec.fault.level == "instruction"


def with_siblings(tasks: list[Task]) -> list[Task]:
    """Runs of one mission that are flown from one golden flight, told of each other, and one after the other."""
    arms: dict[str, list[RunSpec]] = {}
    for task in tasks:
        if is_struck(task.spec):
            arms.setdefault(task.spec.arm, []).append(task.spec)
    order = list(arms)
    told = [replace(task, siblings=tuple(arms[task.spec.arm])) if is_struck(task.spec) else task for task in tasks]
    return sorted(told, key=lambda task: order.index(task.spec.arm) if is_struck(task.spec) else -1)


def _counted(task: Task) -> RunResult:
    """Fly a golden run, count what its kernels execute, and draw their faults."""
    assert task.tools.draw is not None and task.kernels is not None  # asked for by the campaign's law
    spec = task.spec
    drawn = task.tools.draw(task.scenario, task.draws, task.kernels, spec.environment, spec.seed)
    record = record_of(drawn.golden.log)
    record[KEY] = plain(drawn.kernels)
    record[DRAWN] = {kernel: [fault.to_json() for fault in faults] for kernel, faults in drawn.faults.items()}
    return RunResult(record)


def _struck(task: Task) -> RunResult:
    """A run with a fault in an instruction; its siblings are flown with it."""
    if task.spec.run_id not in _flown:
        assert task.tools.strike is not None  # such runs are planned only where the host can fly them
        _flown.clear()
        started = time.perf_counter()
        specs = task.siblings or (task.spec,)
        faults = [spec.fault for spec in specs if spec.fault is not None]
        flights = task.tools.strike(task.scenario, faults, detector_of(task))
        wall_s = (time.perf_counter() - started) / len(specs)
        for spec, flight in zip(specs, flights, strict=True):
            _flown[spec.run_id] = RunResult(record_of(flight.log), wall_s=wall_s)
    return _flown.pop(task.spec.run_id)
