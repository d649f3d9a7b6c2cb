"""One `RunSpec` -> one record: flies, and writes down what happened; judges nothing."""

import math
import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mavfi.campaign.config import KernelFaults
from mavfi.campaign.plan import PHASE_GOLDEN, RunSpec, is_null
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
KERNEL_KEYS = ("kernel_outcome", "due_end")
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


class Family(Protocol):
    """All flights of one mission, without flying twice what is the same."""

    def fly(self, fault: Fault | None, detector: Detector | None, arm: str) -> Flight:
        """Answer what `Fly` answers, bit for bit; with a profile where there is neither fault nor detector."""


class MakeFamily(Protocol):
    """Begins the flights of a mission."""

    def __call__(self, scenario: Scenario) -> Family:
        """Get ready; nothing is flown yet."""


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
        vehicle: str | None = None,
    ) -> Scenario:
        """Make the scenario; raises `BadInputError` for a name that is not known."""


class DrawnFaults(Protocol):
    """A golden flight, what its kernels executed, and faults in their instructions."""

    @property
    def golden(self) -> Flight:
        """The flight."""

    @property
    def kernels(self) -> dict[str, dict[str, Any]]:
        """Counts by kernel, as plain data."""

    @property
    def faults(self) -> dict[str, list[Fault]]:
        """Faults by kernel."""


class DrawKernels(Protocol):
    """Flies a golden mission, counts, and draws."""

    def __call__(
        self, scenario: Scenario, draws: Mapping[str, int], kernels: KernelFaults, environment: str, seed: int
    ) -> DrawnFaults:
        """Draw so many faults in each kernel."""


class StrikeKernels(Protocol):
    """Flies one mission with each of some faults in instructions."""

    def __call__(self, scenario: Scenario, faults: Sequence[Fault], detector: Detector | None) -> Sequence[Flight]:
        """Fly; one flight for each fault, all under the same detector."""


@dataclass(frozen=True, slots=True)
class Tools:
    """What runs are flown with; all are known by their module, so that a worker can be told which they are.

    Attributes:
        fly: Flies a run the long way.
        load_detector: Makes an arm's detector.
        make_scenario: Resolves names.
        make_family: For runs that begin at their golden twin's checkpoints; None = all are flown the long way.
        draw: Counts the instructions of kernels and draws faults in them; None = the host cannot.
        strike: Flies faults in instructions; None = the host cannot.
    """

    fly: Fly
    load_detector: LoadDetector
    make_scenario: MakeScenario
    make_family: MakeFamily | None = None
    draw: DrawKernels | None = None
    strike: StrikeKernels | None = None


@dataclass(frozen=True, slots=True)
class Task:
    """A run, and all that is needed to fly it.

    Attributes:
        spec: The run.
        scenario: Its mission.
        tools: What it is flown with.
        models_dir: Folder of trained models; None = the shipped ones.
        forking: Whether the run may begin where its golden twin was, and end as a known flight did.
        draws: How many faults in instructions of which kernels this golden run draws.
        kernels: How they are drawn.
        siblings: Runs with such faults that are flown from the same golden flight, this one included.
    """

    spec: RunSpec
    scenario: Scenario
    tools: Tools
    models_dir: Path | None = None
    forking: bool = False
    draws: Mapping[str, int] = field(default_factory=dict)
    kernels: KernelFaults | None = None
    siblings: tuple[RunSpec, ...] = ()


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
    return task.tools.fly(task.scenario, spec.fault, detector_of(task), want_profile=wants_profile(spec))


def detector_of(task: Task) -> Detector | None:
    """The detector of a run's arm; None = nothing watches.

    Raises:
        SpecMismatchError: The detector's model is not the one that the run was planned with.
    """
    spec = task.spec
    if not spec.detector:
        return None
    detector, model = task.tools.load_detector(spec.detector, spec.profile, task.models_dir, task.scenario)
    if model != spec.model:
        raise SpecMismatchError(
            f"{spec.run_id}: planned with the model {spec.model[:12]}, but {task.models_dir} holds {model[:12]}"
        )
    return detector


def wants_profile(spec: RunSpec) -> bool:
    """Whether faults are drawn from this run's publications."""
    return spec.phase == PHASE_GOLDEN and not spec.detector


@dataclass(slots=True)
class _Known:
    """A family with the detectors of its arms."""

    family: Family
    detectors: dict[str, Detector | None] = field(default_factory=dict)


MOST_FAMILIES = 2
"""Families that a worker keeps: while the last runs of one mission are under way, the next one is begun."""
_families: dict[tuple[Any, ...], _Known] = {}


def fly_forked(task: Task) -> Flight:
    """Fly a run as one of its family, of which this process keeps what it has flown.

    Runs with an empty mask, whose purpose is to fly through the injector, are flown the long way, and so is what cannot
    be forked, e.g. with a user's planner of which no copy can be made.

    Args:
        task: The run.

    Raises:
        Exception: Whatever `fly_task` raises.
    """
    spec, make = task.spec, task.tools.make_family
    if make is None or is_null(spec):
        return fly_task(task)
    key = (task.tools, task.models_dir, spec.scenario, spec.environment, spec.seed)
    try:
        known = _families.pop(key, None) or _Known(make(task.scenario))
        if spec.arm not in known.detectors:
            known.detectors[spec.arm] = detector_of(task)
        flight = known.family.fly(spec.fault, known.detectors[spec.arm], spec.arm)
    except Exception:  # the family is not kept; the long way says what is to be recorded
        return fly_task(task)
    _families[key] = known
    while len(_families) > MOST_FAMILIES:
        del _families[next(iter(_families))]
    return flight


def forget_families() -> None:
    """Free what `fly_forked` keeps."""
    _families.clear()


def run_task(task: Task) -> RunResult:
    """Fly a run and record it; an exception of ours is recorded as `unknown`, never as an effect of the fault.

    Args:
        task: The run.
    """
    return run_guarded(lambda: _run(task))


def _run(task: Task) -> RunResult:
    flight = fly_forked(task) if task.forking else fly_task(task)
    wanted = flight.profile if wants_profile(task.spec) else None
    return RunResult(record_of(flight.log), None if wanted is None else wanted.to_bytes())


def run_guarded(work: Callable[[], RunResult]) -> RunResult:
    """Do what flies and records a run; an exception of ours is recorded as `unknown`.

    Args:
        work: Where it says what it took, that is kept.
    """
    started = time.perf_counter()
    try:
        result = work()
    except Exception as error:  # whatever it is, the campaign goes on, counts it and shows it
        note = traceback.format_exc()
        return RunResult({"end": End.UNKNOWN, "error": type(error).__name__}, None, note, time.perf_counter() - started)
    return replace(result, wall_s=result.wall_s or time.perf_counter() - started)


def record_of(log: FlightLog) -> dict[str, Any]:
    """What is kept of a flight, as plain data.

    Args:
        log: The flight.

    Returns:
        end, status, success, digest, flight_time_s, energy_j, distance_m, injections, alarms (see
        `kept_alarms`), alarm_counts (by "source/action/outcome"), alarms_total, events (counts by kind), replans, and
        of the log's meta data the modelled compute times, numbers of publications and of rejected commands, course
        and time limit; of flights with a fault in an instruction also what the kernel did, and how the mission would
        have ended with its death.
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
            **{key: log.meta[key] for key in KERNEL_KEYS if key in log.meta},
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
