"""One `RunSpec` -> one record: flies, and writes down what happened; judges nothing."""

import math
import time
import traceback
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mavfi.campaign.plan import PHASE_GOLDEN, RunSpec
from mavfi.detectors.detector import Detector
from mavfi.errors import SpecMismatchError
from mavfi.faults.fault import Fault
from mavfi.flight_log import FlightLog, Profile
from mavfi.mission import Scenario
from mavfi.qof import quality_of_flight

MOST_ALARMS = 20
"""Alarms of a flight with a fault that are kept one by one, beside those in the `AFTERMATH`; all are counted."""
MOST_GOLDEN_ALARMS = 1000
"""The same of an error-free flight: what its twins' alarms are compared with."""
INSTANT = 0.5e-6
"""Instants that differ by less are the same: times are whole microseconds (s)."""
AFTERMATH = 1.0
"""Time from the injection within which every alarm is kept (s)."""
_KEPT_META = ("course_m", "time_limit_s", "compute_us", "recompute_us", "publications", "rejected_commands")


class End(StrEnum):
    """How a run ended, as a piece of computation: with a log; by dying each time; or for a reason that is ours."""

    FLOWN = "flown"
    DUE = "due"
    UNKNOWN = "unknown"


class Flight(Protocol):
    """What a host gives back."""

    log: FlightLog
    profile: Profile | None


class Fly(Protocol):
    """A host: flies one mission."""

    def __call__(
        self, scenario: Scenario, fault: Fault | None, detector: Detector | None, *, want_profile: bool
    ) -> Flight:
        """Fly, and answer log and, if wanted, profile."""


class LoadDetector(Protocol):
    """Makes the detector of an arm."""

    def __call__(
        self, detector: str, profile: str, models_dir: Path | None, scenario: Scenario
    ) -> tuple[Detector, str]:
        """Load, refuse what does not fit the scenario, and answer the sha256 of the model too."""


class MakeScenario(Protocol):
    """Resolves names of configurations."""

    def __call__(
        self,
        environment: str,
        seed: int,
        *,
        stack: str,
        platform: str,
        planner: str,
        v_max: float | None,
        map_kind: str = "dense",
    ) -> Scenario:
        """Make the scenario; raises `BadInputError` for a name that is not known."""


@dataclass(frozen=True, slots=True)
class Tools:
    """What runs are flown with; all are known by their module, so that a worker can be told which they are."""

    fly: Fly
    load_detector: LoadDetector
    make_scenario: MakeScenario


@dataclass(frozen=True, slots=True)
class Task:
    """A run, and all that is needed to fly it.

    Attributes:
        spec: The run.
        scenario: Its mission.
        tools: What it is flown with.
        models_dir: Folder of trained models; None = the shipped ones.
    """

    spec: RunSpec
    scenario: Scenario
    tools: Tools
    models_dir: Path | None = None


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run leaves.

    Attributes:
        record: Plain data, a pure function of the task.
        profile: Of golden runs without a detector.
        note: Traceback of a run that ended in an exception of ours.
        wall_s: What it took (s); never part of the record.
    """

    record: dict[str, Any]
    profile: bytes | None = None
    note: str = ""
    wall_s: float = field(default=0.0, compare=False)


def fly_task(task: Task) -> Flight:
    """Fly a run again, for its whole log.

    Args:
        task: The run.

    Raises:
        SpecMismatchError: The detector's model is not the one that the run was planned with.
    """
    spec = task.spec
    detector = None
    if spec.detector:
        detector, model = task.tools.load_detector(spec.detector, spec.profile, task.models_dir, task.scenario)
        if model != spec.model:
            raise SpecMismatchError(
                f"{spec.run_id}: planned with the model {spec.model[:12]}, but {task.models_dir} holds {model[:12]}"
            )
    return task.tools.fly(task.scenario, spec.fault, detector, want_profile=wants_profile(spec))


def wants_profile(spec: RunSpec) -> bool:
    """Whether faults are drawn from this run's publications."""
    return spec.phase == PHASE_GOLDEN and not spec.detector


def run_task(task: Task) -> RunResult:
    """Fly a run and record it; an exception of ours is recorded as `unknown`, never as an effect of the fault.

    Args:
        task: The run.
    """
    started = time.perf_counter()
    try:
        flight = fly_task(task)
        record = record_of(flight.log)
        profile = None if flight.profile is None else flight.profile.to_bytes()
    except Exception as error:  # whatever it is, the campaign goes on, counts it and shows it
        note = traceback.format_exc()
        return RunResult({"end": End.UNKNOWN, "error": type(error).__name__}, None, note, time.perf_counter() - started)
    return RunResult(record, profile, "", time.perf_counter() - started)


def record_of(log: FlightLog) -> dict[str, Any]:
    """What is kept of a flight, as plain data.

    Args:
        log: The flight.

    Returns:
        end, status, success, digest, flight_time_s, energy_j, distance_m, injections, alarms (see
        `kept_alarms`), alarm_counts (by "source/action/outcome"), alarms_total, events (counts by kind), replans, and
        of the log's meta data the modelled compute times, numbers of publications and of rejected commands, course
        and time limit.
    """
    qof = quality_of_flight(log)
    events = Counter(event.kind for event in log.events)
    alarm_counts = Counter(f"{a['source']}/{a['action']}/{a['outcome']}" for a in log.alarms)
    meta = {key: log.meta[key] for key in _KEPT_META if key in log.meta}
    record: dict[str, Any] = plain(
        {
            "end": End.FLOWN,
            "status": log.status.label,
            "success": log.status.label == "success",
            "digest": log.digest(),
            "flight_time_s": qof.flight_time_s,
            "energy_j": qof.energy_j,
            "distance_m": qof.distance_m,
            "injections": log.injections,
            "alarms": kept_alarms(log),
            "alarms_total": len(log.alarms),
            "alarm_counts": dict(alarm_counts),
            "events": dict(events),
            "replans": max(0, events["plan"] - 1),
            "meta": meta,
        }
    )
    return record


def kept_alarms(log: FlightLog) -> list[dict[str, Any]]:
    """The first alarms of a flight, and all within `AFTERMATH` of a fault that hit; in order of time."""
    struck = [injection["time_s"] for injection in log.injections if injection["hit"]]
    most = MOST_ALARMS if log.injections else MOST_GOLDEN_ALARMS
    return [
        alarm
        for place, alarm in enumerate(log.alarms)
        if place < most or any(-INSTANT < alarm["time_s"] - time_s <= AFTERMATH for time_s in struck)
    ]


def plain(value: Any) -> Any:
    """Make data fit for JSON: NumPy numbers and arrays become Python's; infinities and NaN become text."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value
