"""Scores of detectors on golden and corrupted publications: detection against false alarms at any threshold.

Injected and golden flight are identical up to the injection.  One golden flight therefore serves all faults: each
detector scores every publication, and at the site of a fault also its corrupted copy.  Recovery is off; publications
above the threshold count as alarms.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from mavfi.analysis.rows import ACTIVATED
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate, clustered_rate
from mavfi.analysis.table import NUMBER, RATE, Column, Table
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.executor import Executor, map_each
from mavfi.campaign.ledger import ORDERED
from mavfi.campaign.plan import FI
from mavfi.campaign.resolve import Arm
from mavfi.campaign.resolve import resolve as resolve_campaign
from mavfi.campaign.store import Store
from mavfi.config import STORED
from mavfi.detectors.detector import Detector
from mavfi.flight.compose import detector_for, resolve
from mavfi.flight.fly import fly
from mavfi.levels.state.fault import StateFault
from mavfi.levels.state.injector import StateInjector
from mavfi.mission import OF_A_DETECTOR, MissionSpec
from mavfi.outcomes import quality_of_flight
from mavfi.states import State

RATES_PER_HOUR = (0.1, 1.0, 10.0)
"""False alarms per flight hour at which detection is reported."""


@dataclass(frozen=True, slots=True)
class Scores:
    """Scores of one detector, in units of its shipped threshold: > 1 is an alarm at that threshold.

    Attributes:
        golden: Positive scores of publications in golden flights, descending. Shape (m,).
        judged: Number of scored publications in golden flights.
        hours: Exposure (h).
        corrupted: Score of the publication corrupted by each fault; 0 if it is not scored. Shape (n,).
        harmful: Whether the fault loses the mission. Shape (n,).
        missions: Number of the mission of each fault. Shape (n,).
    """

    golden: np.ndarray
    judged: int
    hours: float
    corrupted: np.ndarray
    harmful: np.ndarray
    missions: np.ndarray

    @property
    def harmful_scores(self) -> np.ndarray:
        """Scores of the publications that harmful faults corrupted."""
        scores: np.ndarray = self.corrupted[self.harmful]
        return scores

    def threshold_at(self, per_hour: float) -> float | None:
        """Lowest threshold with at most this rate of false alarms; None if the exposure is too short for the rate."""
        allowed = int(per_hour * self.hours)
        if allowed < 1:
            return None
        if allowed < len(self.golden):
            return float(self.golden[allowed])
        return 0.0

    def detected_at(self, per_hour: float) -> Rate | None:
        """Share of harmful faults above `threshold_at` this rate; missions are the clusters of its interval."""
        threshold = self.threshold_at(per_hour)
        if threshold is None:
            return None
        detected = self.harmful_scores > threshold
        return clustered_rate(detected.tolist(), self.missions[self.harmful].tolist())

    def area(self) -> float | None:
        """Area under the ROC curve of harmful corrupted publications against golden ones; None without both."""
        return self._metric("roc_auc_score")

    def precision(self) -> float | None:
        """Average precision: area under the curve of precision over recall, harmful corrupted publications to find.

        Precision depends on the share of corrupted publications, here one per harmful fault among the golden ones.
        """
        return self._metric("average_precision_score")

    def _metric(self, metric: str) -> float | None:
        """A metric of the scores as a classifier of harmful publications; None without both kinds."""
        from sklearn import metrics

        harmful = self.harmful_scores
        if not len(harmful) or not self.judged:
            return None
        scores = np.concatenate([harmful, self.golden, [0.0]])
        weights = np.ones(len(scores))
        weights[-1] = self.judged - len(self.golden)  # the last sample stands for all golden scores of 0
        labels = np.arange(len(scores)) < len(harmful)
        finite = np.minimum(scores, np.finfo(float).max)
        return float(getattr(metrics, metric)(labels, finite, sample_weight=weights))

    def curve(self) -> list[tuple[float, float, float]]:
        """Steps of the curve, descending: threshold, false alarms per hour, share of harmful faults detected."""
        harmful = self.harmful_scores
        thresholds = np.unique(np.concatenate([self.golden, harmful[harmful > 0]]))[::-1]
        alarms = _count_above(self.golden, thresholds) / self.hours
        shares = _count_above(harmful, thresholds) / max(len(harmful), 1)
        return list(zip(thresholds.tolist(), alarms.tolist(), shares.tolist(), strict=True))


def _count_above(scores: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Number of scores above each threshold; both without NaN."""
    counts: np.ndarray = len(scores) - np.searchsorted(np.sort(scores), thresholds, side="right")
    return counts


@dataclass(frozen=True, slots=True)
class _ScoringTask:
    """A golden flight and the faults scored in it; its text appears in the message about a lost worker."""

    mission: MissionSpec
    arms: tuple[Arm, ...]
    faults: tuple[StateFault, ...]
    harmful: tuple[bool, ...]
    models_dir: Path | None = None

    def __str__(self) -> str:
        return f"scores in {self.mission.environment}-{self.mission.seed}"


@dataclass(slots=True)
class _FlightScores:
    """Scores of one detector in one flight.

    Attributes:
        golden: Positive scores of publications.
        judged: Number of scored publications.
        hours: Flight time (h).
        corrupted: Score of the corrupted publication, by index of the fault.
    """

    golden: list[float] = field(default_factory=list)
    judged: int = 0
    hours: float = 0.0
    corrupted: dict[int, float] = field(default_factory=dict)


class _ScoreRecorder:
    """Recorder in which detectors score each publication, and its corrupted copies at fault sites."""

    def __init__(self, detectors: Mapping[str, Detector], faults: Sequence[StateFault]) -> None:
        self._detectors: Mapping[str, Any] = detectors  # those that have `score`
        self._injectors = {number: StateInjector(fault) for number, fault in enumerate(faults)}
        self.scores = {name: _FlightScores() for name in detectors}
        for detector in detectors.values():
            detector.start()

    def __call__(self, state: State, time_us: int) -> None:
        # 1. Faults whose site this publication is: None = the message is lost.
        corrupted = {}
        for number, injector in self._injectors.items():
            corrupted_copy = injector(state, time_us)
            if corrupted_copy is not state:
                corrupted[number] = corrupted_copy

        # 2. Score the corrupted copies before the publication itself, which alone is accepted.
        for name, detector in self._detectors.items():
            scores = self.scores[name]
            for number, corrupted_copy in corrupted.items():
                scores.corrupted[number] = 0.0
                if corrupted_copy is not None:
                    scores.corrupted[number] = detector.score(corrupted_copy, time_us) or 0.0
            score = detector.score(state, time_us)
            if score is not None:
                scores.judged += 1
                if score > 0.0:
                    scores.golden.append(score)
            detector.accept(state, time_us)

        # 3. Each fault strikes once.
        for number in corrupted:
            del self._injectors[number]


def unscored(campaigns: Iterable[Campaign], scores_of_arms: Mapping[str, Scores]) -> dict[str, str]:
    """Arms with a detector that have no scores, with the reason."""
    reasons: dict[str, str] = {}
    for campaign in campaigns:
        for arm in resolve_campaign(campaign).arms:
            if arm.detector and arm.name not in scores_of_arms:
                reasons[arm.name] = "it compares with a seal, or has no scores"
                other_keys = sorted(set(arm.overrides) - set(OF_A_DETECTOR))
                if other_keys:
                    reasons[arm.name] = f"its mission differs ({', '.join(other_keys)})"
    return reasons


def _score(task: _ScoringTask) -> dict[str, _FlightScores]:
    """Fly a golden flight; returns the scores by arm."""
    scenario = resolve(task.mission)
    detectors = {}
    for arm in task.arms:
        trained_for = arm.overrides.get("trained_for", task.mission.trained_for)
        detector = detector_for(scenario, arm.detector, arm.profile, task.models_dir, trained_for, arm.options).detector
        if not detector.seals:
            detectors[arm.name] = detector
    recorder = _ScoreRecorder(detectors, task.faults)
    log = fly(scenario, recorders=[recorder]).log
    hours = quality_of_flight(log).flight_time_s / 3600
    for flight_scores in recorder.scores.values():
        flight_scores.hours = hours
    return recorder.scores


def scores(
    directories: Sequence[Path],
    executor: Executor,
    models_dir: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Scores]:
    """Scores of the detectors of campaigns, by arm, over all of their missions and state faults.

    A mission shared by several campaigns is flown and counted once.  Detectors without scores are omitted: those
    without a method `score`, and those that compare with a seal, which has no threshold.

    Args:
        directories: Folders of complete ledgers with faults in states.
        executor: Runs the flights.
        models_dir: Folder of trained models; None = the shipped ones.
        progress: Called with the number of missions done and their total.

    Raises:
        BadInputError: A folder holds no ledger.
        MavfiError: A worker was lost.
    """
    tasks = _tasks(directories, models_dir)
    flown: list[tuple[_ScoringTask, dict[str, _FlightScores]]] = []
    progress(0, len(tasks))
    for task_and_scores in map_each(executor, _score, tasks):
        flown.append(task_and_scores)
        progress(len(flown), len(tasks))
    # Flights end in any order: sums of floats must not depend on it.
    order = {id(task): number for number, task in enumerate(tasks)}
    flown.sort(key=lambda task_and_scores: order[id(task_and_scores[0])])

    scores_of_arms = {}
    for name in dict.fromkeys(arm.name for task in tasks for arm in task.arms):
        joined = _join([(task, by_arm[name]) for task, by_arm in flown if name in by_arm])
        if joined.judged:
            scores_of_arms[name] = joined
    return scores_of_arms


def _tasks(directories: Sequence[Path], models_dir: Path | None) -> list[_ScoringTask]:
    """One task per mission, with the faults of all campaigns that contain it."""
    tasks: dict[str, _ScoringTask] = {}
    for directory in directories:
        # the faults of the campaign, and whether each loses its mission
        judged = Runs.read(directory).injected.where("judged", setting=FI, site_outcome=ACTIVATED)
        lost = {row["run_id"]: bool(row["golden_success"]) and not row["success"] for row in judged}
        with Store.open(directory) as store:
            campaign = Campaign.model_validate_json(store.meta(ORDERED), context=STORED)
            specs = [run.spec for run in store.runs(done=True) if run.spec.run_id in lost]

        # arms with a detector on the campaign's own mission, independent of their recovery options
        arms = tuple(
            arm for arm in resolve_campaign(campaign).arms if arm.detector and set(arm.overrides) <= set(OF_A_DETECTOR)
        )

        # the faults of each mission are added to its task, which another campaign may have begun
        for environment in campaign.environments:
            for seed in campaign.seeds:
                mission = campaign.spec(environment, seed)
                here = [spec for spec in specs if spec.world == (environment, seed)]
                key = mission.model_dump_json()
                task = tasks.get(key, _ScoringTask(mission, arms, (), (), models_dir))
                tasks[key] = replace(
                    task,
                    arms=tuple({arm.name: arm for arm in (*task.arms, *arms)}.values()),
                    faults=(*task.faults, *(cast(StateFault, spec.fault) for spec in here)),
                    harmful=(*task.harmful, *(lost[spec.run_id] for spec in here)),
                )
    return list(tasks.values())


def _join(flown: Sequence[tuple[_ScoringTask, _FlightScores]]) -> Scores:
    """Scores of a detector over all flights."""
    golden: list[float] = []
    corrupted: list[float] = []
    harmful: list[bool] = []
    missions: list[int] = []
    for mission, (task, scores_of_flight) in enumerate(flown):
        golden += scores_of_flight.golden
        missions += [mission] * len(task.faults)
        corrupted += [scores_of_flight.corrupted.get(number, 0.0) for number in range(len(task.faults))]
        harmful += task.harmful
    return Scores(
        golden=np.sort(np.array(golden))[::-1],
        judged=sum(scores_of_flight.judged for _, scores_of_flight in flown),
        hours=sum(scores_of_flight.hours for _, scores_of_flight in flown),
        corrupted=np.array(corrupted),
        harmful=np.array(harmful, bool),
        missions=np.array(missions, np.int64),
    )


def table(
    scores_of_schemes: Mapping[str, Scores], parts: Sequence[str], left_out: Mapping[str, str] | None = None
) -> Table:
    """Detection of harmful faults at fixed false-alarm rates, and the areas under the ROC and PR curves.

    Args:
        scores_of_schemes: Scores by scheme.
        parts: Names of the parts whose missions and faults these are.
        left_out: Schemes without scores, with the reason (`unscored`).
    """
    columns = (
        Column("arm", "scheme"),
        Column("harmful", "harmful", NUMBER),
        Column("auc", "ROC area", "number .4f"),
        Column("precision", "PR area", "number .4f"),
        *(Column(f"at_{rate:g}", f"detected at {rate:g}/h", RATE) for rate in RATES_PER_HOUR),
        Column("hours", "exposure", "number .2f h"),
    )
    rows = []
    for name, scheme in scores_of_schemes.items():
        detected = map(scheme.detected_at, RATES_PER_HOUR)
        harmful = int(scheme.harmful.sum())
        rows.append((name, harmful, scheme.area(), scheme.precision(), *detected, scheme.hours))
    notes = (
        "threshold of each detector moved to so many false alarms per hour of golden flight, counted as publications "
        "above it; — = the exposure is too short to show the rate",
        f"one golden flight for each mission of these parts, their faults together: {', '.join(parts)}",
        "harmful: activated faults that lose the mission without a detector; [95 % interval: Wilson, n reduced by the "
        "design effect of missions], n",
        "ROC: corrupted publications of harmful faults against publications of golden flights; PR: precision over "
        "recall for the same publications (average precision), which falls with their share",
        *(f"{name}: not scored: {reason}" for name, reason in (left_out or {}).items()),
    )
    return Table("scores", "Detection at fixed rates of false alarms", columns, rows, notes=notes)
