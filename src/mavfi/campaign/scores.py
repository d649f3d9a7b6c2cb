"""Scores of detectors on golden flights and on corrupted publications: detection against false alarms, any threshold.

Up to its strike a flight is the golden one.  So one golden flight shows every detector all publications, and, before
it goes on, what each fault would have made of the publication it strikes; nothing is recomputed.  Alarms are counted
as publications above the threshold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from mavfi.campaign.analysis.rows import ACTIVATED
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.statistics import Rate, wilson
from mavfi.campaign.analysis.table import NUMBER, RATE, Column, Table
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.executor import Executor, map_each
from mavfi.campaign.plan import FI, Arm, arms_of
from mavfi.campaign.run import ORDERED
from mavfi.campaign.store import Store
from mavfi.detectors.detector import Detector
from mavfi.faults.fault import StateFault
from mavfi.faults.state import StateInjector
from mavfi.hosts.local.flight import fly
from mavfi.hosts.loop.compose import resolve
from mavfi.hosts.watching import detector_for
from mavfi.qof import quality_of_flight
from mavfi.states import State

RATES_PER_HOUR = (0.1, 1.0, 10.0)
"""False alarms per flight hour at which detection is told."""


@dataclass(frozen=True, slots=True)
class Scores:
    """Scores of one detector; in units of its shipped threshold, so that > 1 is an alarm of today.

    Attributes:
        golden: Of the publications that it judges in golden flights, those above 0, descending. Shape (m,).
        judged: How many publications it judges there.
        hours: Exposure (h).
        struck: Of the publication that each fault strikes; 0 where it does not judge it. Shape (n,).
        harmful: Whether the fault loses the mission. Shape (n,).
    """

    golden: np.ndarray
    judged: int
    hours: float
    struck: np.ndarray
    harmful: np.ndarray

    def threshold_at(self, per_hour: float) -> float | None:
        """The lowest threshold with at most so many false alarms per hour; None if the exposure cannot show it."""
        allowed = int(per_hour * self.hours)
        if allowed < 1:
            return None
        return float(self.golden[allowed]) if allowed < len(self.golden) else 0.0

    def detected_at(self, per_hour: float) -> Rate | None:
        """Share of the harmful faults above that threshold, with Wilson's interval."""
        threshold = self.threshold_at(per_hour)
        if threshold is None:
            return None
        own = self.struck[self.harmful]
        return wilson(int((own > threshold).sum()), len(own))

    def area(self) -> float | None:
        """Area under the ROC curve of harmful corrupted publications against golden ones (Mann and Whitney's U)."""
        own = self.struck[self.harmful]
        if not len(own) or not self.judged:
            return None
        ascending = self.golden[::-1]
        silent = self.judged - len(ascending)  # publications with a score of 0
        below = np.searchsorted(ascending, own, "left") + silent * (own > 0)
        equal = np.searchsorted(ascending, own, "right") - np.searchsorted(ascending, own, "left") + silent * (own == 0)
        return float(np.mean((below + 0.5 * equal) / self.judged))

    def curve(self) -> list[tuple[float, float, float]]:
        """Threshold, false alarms per hour, share of harmful faults detected: the steps of the curve, descending."""
        own = self.struck[self.harmful]
        thresholds = np.unique(np.concatenate([self.golden, own[own > 0]]))[::-1]
        return [
            (float(t), float((self.golden > t).sum() / self.hours), float((own > t).mean()) if len(own) else 0.0)
            for t in thresholds
        ]


@dataclass(frozen=True, slots=True)
class _Task:
    """A golden flight and the faults that it is asked about; its text is in the message about a lost worker."""

    campaign: Campaign
    environment: str
    seed: int
    faults: tuple[StateFault, ...]
    models_dir: Path | None = None

    def __str__(self) -> str:
        return f"scores in {self.environment}-{self.seed}"


@dataclass(slots=True)
class _Kept:
    """Scores of one detector in one flight."""

    golden: list[float] = field(default_factory=list)
    judged: int = 0
    struck: dict[int, float] = field(default_factory=dict)


class _Scorer:
    """A recorder that shows detectors what is published, and what faults would have made of it."""

    def __init__(self, detectors: Mapping[str, Detector], faults: Sequence[StateFault]) -> None:
        self._detectors: Mapping[str, Any] = detectors
        self._injectors = {place: StateInjector(fault) for place, fault in enumerate(faults)}
        self.kept = {name: _Kept() for name in detectors}
        for detector in detectors.values():
            detector.start()

    def __call__(self, state: State, time_us: int) -> None:
        struck = [(place, self._injectors[place](state, time_us)) for place in self._injectors]
        changed = [(place, other) for place, other in struck if other is not state]
        for name, detector in self._detectors.items():
            kept = self.kept[name]
            for place, other in changed:
                kept.struck[place] = detector.score(other, time_us) or 0.0
            found = detector.score(state, time_us)
            if found is not None:
                kept.judged += 1
                if found > 0.0:
                    kept.golden.append(found)
            detector.accept(state, time_us)
        for place, _ in changed:
            del self._injectors[place]


def scored_arms(campaign: Campaign) -> list[Arm]:
    """Arms whose detectors have scores and watch the campaign's own mission."""
    return [arm for arm in arms_of(campaign) if arm.detector and not arm.overrides]


def _score(task: _Task) -> tuple[float, dict[str, _Kept]]:
    """Hours of a golden flight, and the scores in it by arm."""
    scenario = resolve(task.campaign.spec(task.environment, task.seed))
    loaded = {
        arm.name: detector_for(scenario, arm.detector, arm.profile, task.models_dir)[0]
        for arm in scored_arms(task.campaign)
    }
    scorer = _Scorer({name: own for name, own in loaded.items() if hasattr(own, "score")}, task.faults)
    log = fly(scenario, recorders=[scorer]).log
    return quality_of_flight(log).flight_time_s / 3600, scorer.kept


def scores(directories: Sequence[Path], executor: Executor, models_dir: Path | None = None) -> dict[str, Scores]:
    """Scores of the detectors of campaigns with the same arms, by arm, over all of their missions and state faults.

    Args:
        directories: Folders of complete ledgers with faults in states.
        executor: Runs the flights.
        models_dir: Folder of trained models; None = the shipped ones.

    Raises:
        BadInputError: There is no ledger.
        MavfiError: A worker was lost.
    """
    tasks, harmful = [], {}
    for directory in directories:
        for task, losses in _tasks(directory, models_dir):
            tasks.append(task)
            harmful[len(tasks) - 1] = losses
    places = {id(task): place for place, task in enumerate(tasks)}
    found = {places[id(task)]: result for task, result in map_each(executor, _score, tasks)}
    names = list(dict.fromkeys(name for _, kept in found.values() for name in kept))
    hours = sum(own for own, _ in found.values())
    lost = np.array([loss for place in sorted(found) for loss in harmful[place]], bool)
    return {name: _joined([found[place][1][name] for place in sorted(found)],
                          [len(harmful[place]) for place in sorted(found)], hours, lost) for name in names}  # fmt: skip


def _tasks(directory: Path, models_dir: Path | None) -> list[tuple[_Task, list[bool]]]:
    """One task for each mission, and which of its faults lose it."""
    rows = {row["run_id"]: row for row in Runs.read(directory).injected.where(setting=FI, site_outcome=ACTIVATED)}
    with Store.open(directory) as store:
        campaign = Campaign.model_validate_json(store.meta(ORDERED))
        specs = [run.spec for run in store.runs(done=True)]
    faults: dict[tuple[str, int], list[tuple[StateFault, bool]]] = {
        (environment, seed): [] for environment in campaign.environments for seed in campaign.seeds
    }
    for spec in specs:
        row = rows.get(spec.run_id)
        if row is not None:
            faults[spec.world].append(
                (cast(StateFault, spec.fault), bool(row["golden_success"]) and not row["success"])
            )
    return [
        (_Task(campaign, *world, tuple(fault for fault, _ in own), models_dir), [lost for _, lost in own])
        for world, own in faults.items()
    ]


def _joined(kept: Sequence[_Kept], counts: Sequence[int], hours: float, harmful: np.ndarray) -> Scores:
    golden = np.sort(np.array([score for own in kept for score in own.golden]))[::-1]
    struck = [own.struck.get(place, 0.0) for own, count in zip(kept, counts, strict=True) for place in range(count)]
    return Scores(golden, sum(own.judged for own in kept), hours, np.array(struck), harmful)


def table(found: Mapping[str, Scores]) -> Table:
    """Detection of harmful faults at fixed rates of false alarms, and the area under the ROC curve."""
    columns = [Column("arm", "scheme"), Column("harmful", "harmful", NUMBER), Column("auc", "ROC area", "number .4f")]
    columns += [Column(f"at_{rate:g}", f"detected at {rate:g}/h", RATE) for rate in RATES_PER_HOUR]
    columns += [Column("hours", "exposure", "number .2f h")]
    rows = [
        (name, int(own.harmful.sum()), own.area(), *(own.detected_at(rate) for rate in RATES_PER_HOUR), own.hours)
        for name, own in found.items()
    ]
    notes = (
        "threshold of each detector moved to so many false alarms per hour of golden flight, counted as publications "
        "above it; — = the exposure is too short to show the rate",
        "harmful: activated faults that lose the mission without a detector; [95 % interval: Wilson], n",
        "ROC: corrupted publications of harmful faults against publications of golden flights",
    )
    return Table("scores", "Detection at fixed rates of false alarms", tuple(columns), rows, notes=notes)


def curves_csv(found: Mapping[str, Scores]) -> str:
    """The curves of all detectors: scheme, threshold, false alarms per hour, share of harmful faults detected."""
    lines = ["scheme,threshold,false_alarms_per_hour,detected"]
    for name, own in found.items():
        lines += [f"{name},{threshold!r},{alarms!r},{share!r}" for threshold, alarms, share in own.curve()]
    return "\n".join(lines) + "\n"
