"""Flies the study of assumptions: rounds of readings until they are rejected, then the frozen one with detectors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from mavfi.analysis.rows import KERNEL_DUE
from mavfi.analysis.runs import Runs
from mavfi.campaign.begin import begin
from mavfi.campaign.config import Campaign, label_of
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.run import run_campaigns
from mavfi.campaign.training import record
from mavfi.extras.paper.cli_report import StudyBar
from studies.assumptions.design import DETECTORS, AssumptionStudy, AxisChange, PaperReading
from studies.assumptions.fit import EnvironmentFlights, Fit, Flights, Judgement, fit, judge

FIT = "fit"
JUDGED = "judged"
MODELS = "models"
"""Subfolders: rounds of the readings, flights of the frozen ones, trained models."""
NOT_REJECTED = 0.05
"""p from which on a reading is not rejected."""


@dataclass
class FlownReading:
    """A reading whose flights exist.

    Attributes:
        flights: By environment of the paper.
        ledgers: Folders, in the order of the rounds.
    """

    flights: dict[str, EnvironmentFlights]
    ledgers: list[Path]

    def add(self, flights: Mapping[str, EnvironmentFlights], ledger: Path) -> None:
        """Add a round."""
        for name, part in flights.items():
            if name in self.flights:
                part = self.flights[name].plus(part)
            self.flights[name] = part
        self.ledgers.append(ledger)


@dataclass(frozen=True, slots=True)
class FittedReading:
    """A reading, whose flights it counts, and its fit."""

    reading: PaperReading
    flown: PaperReading
    fit: Fit


@dataclass(frozen=True, slots=True)
class JudgedDetectors:
    """The frozen reading with a reading of the detectors.

    Attributes:
        name: Name of the reading of the detectors.
        judgement: On the paper's eight detector cells.
        runs: Its runs, with the settings named as the paper's: golden, fi, dr_gaussian, dr_autoencoder.
    """

    name: str
    judgement: Judgement
    runs: Runs


@dataclass(frozen=True, slots=True)
class FrozenReading:
    """A reading that is fitted no more, on fresh seeds, with all readings of the detectors.

    Attributes:
        fitted: The reading and its fit.
        flights: Fresh flights, by environment; settings "fi" and those of all arms.
        detectors: Judged readings of the detectors, in the order of the study.
    """

    fitted: FittedReading
    flights: Mapping[str, EnvironmentFlights]
    detectors: Sequence[JudgedDetectors]


@dataclass(frozen=True, slots=True)
class AssumptionResults:
    """All results of the study.

    Attributes:
        study: Its definition.
        flown: Readings that were flown.
        changes: The changes of anchors that lead to each single-change reading.
        fitted: All fitted readings, best criterion first.
        frozen: The best of them, each of another kind, and the other accepted ways of counting their flights.
        ledgers: Digest of each ledger, by folder.
    """

    study: AssumptionStudy
    flown: Mapping[PaperReading, FlownReading]
    changes: Mapping[PaperReading, Sequence[AxisChange]]
    fitted: Sequence[FittedReading]
    frozen: Sequence[FrozenReading]
    ledgers: Mapping[str, str]


def fly_assumptions(study: AssumptionStudy, folder: Path, workers: int, bar: StudyBar) -> AssumptionResults:
    """Fly the study, or what is left of it: every ledger resumes.

    1. Single changes of both anchors fly in rounds; a reading that the paper's golden and injection cells reject is
       flown no further.
    2. The best changes of each anchor are combined in pairs, which fly in the same rounds.
    3. The readings that fit best, each of another kind, are frozen, and flown on fresh seeds with all
       readings of the detectors.
    """
    executor = LocalExecutor(workers)
    changes = study.single_changes()
    flown: dict[PaperReading, FlownReading] = {}
    _fly_rounds(study, dict.fromkeys(map(study.flights_of, changes)), folder, executor, bar, flown)

    best = _best_changes(study, changes, flown)
    pairs = study.pairs(best)
    _fly_rounds(study, dict.fromkeys(map(study.flights_of, pairs)), folder, executor, bar, flown)

    fitted = sorted(_all_fits(study, flown), key=lambda item: item.fit.criterion)
    best_of_kinds: dict[str, FittedReading] = {}
    for item in fitted:
        # deviances of fewer flights are smaller: only readings that flew all rounds compete
        if len(flown[item.flown].ledgers) == study.rounds.number:
            best_of_kinds.setdefault(study.kind_of(item.reading), item)
    frozen: list[FrozenReading] = []
    for best_of_kind in list(best_of_kinds.values())[: study.rounds.frozen]:
        judged = _fly_with_detectors(study, best_of_kind.flown, folder, executor, workers, bar)
        # the fitted cells do not tell how its flights are to be counted, if they reject none of these ways
        ways = [item for item in fitted if item.flown == best_of_kind.flown and item.fit.p_value >= NOT_REJECTED]
        frozen += [_judge(study, item, judged) for item in ways or [best_of_kind]]

    paths = [path for part in flown.values() for path in part.ledgers]
    paths += sorted((folder / JUDGED).iterdir())
    ledgers = {str(path.relative_to(folder)): _digest(path) for path in paths}
    return AssumptionResults(study, flown, changes, fitted, frozen, ledgers)


# ---- rounds ----------------------------------------------------------------------------------------------------------
def _fly_rounds(  # noqa: PLR0913 - what the study is flown with
    study: AssumptionStudy,
    readings: Mapping[PaperReading, None],
    folder: Path,
    executor: LocalExecutor,
    bar: StudyBar,
    flown: dict[PaperReading, FlownReading],
) -> None:
    """Fly readings in rounds; those that have been flown already, or are rejected, are left out."""
    active = [reading for reading in readings if reading not in flown]
    for number in range(study.rounds.number):
        campaigns = {folder / FIT / f"{reading.folder}-{number}": study.campaign(reading, number) for reading in active}
        bar.begin_step(f"round {number + 1}, {len(active)} readings")
        begun = {path: begin(campaign, path) for path, campaign in campaigns.items()}
        run_campaigns(begun, executor=executor, progress=bar.show_campaigns)
        for reading, (path, campaign) in zip(active, campaigns.items(), strict=True):
            flown.setdefault(reading, FlownReading({}, [])).add(flights_in(path, campaign, study), path)
        active = [reading for reading in active if _may_be_the_best(study, reading, flown)]


def _may_be_the_best(study: AssumptionStudy, reading: PaperReading, flown: Mapping[PaperReading, FlownReading]) -> bool:
    """Whether some way of counting a reading's flights is not rejected, and not far behind the best reading."""
    best = min(item.fit.criterion for item in _all_fits(study, flown))
    fits = [item.fit for item in _fits(study, reading, flown[reading])]
    limit = best + study.rounds.behind
    return any(fit.p_value >= study.rounds.reject_below and fit.criterion <= limit for fit in fits)


def _fits(study: AssumptionStudy, flown: PaperReading, part: FlownReading) -> list[FittedReading]:
    """Fits of all readings that count the flights of one."""
    return [
        FittedReading(reading, flown, fit_of(study, reading, part.flights)) for reading in study.counted_alike(flown)
    ]


def fit_of(study: AssumptionStudy, reading: PaperReading, flights: Mapping[str, EnvironmentFlights]) -> Fit:
    """Fit of a reading's flights, counted as it says."""
    return fit(flights, study.value("deaths", reading["deaths"]), study.value("losses", reading["losses"]))


def _all_fits(study: AssumptionStudy, flown: Mapping[PaperReading, FlownReading]) -> list[FittedReading]:
    return [item for reading, part in flown.items() for item in _fits(study, reading, part)]


def _best_changes(
    study: AssumptionStudy,
    changes: Mapping[PaperReading, Sequence[AxisChange]],
    flown: Mapping[PaperReading, FlownReading],
) -> dict[str, list[AxisChange]]:
    """Changes that alter flights, by anchor, the best first: each by the best way of counting its flights."""
    ranked: dict[str, list[tuple[float, AxisChange]]] = {name: [] for name in study.anchors}
    for reading, leading in changes.items():
        part = study.flights_of(reading)
        criterion = min(item.fit.criterion for item in _fits(study, part, flown[part]))
        for change in leading:
            if not study.value(change.axis, change.value).only_counts or change.axis in ("where", "bit", "when"):
                ranked[change.anchor].append((criterion, change))
    return {name: [change for _, change in sorted(items, key=lambda item: item[0])] for name, items in ranked.items()}


# ---- flights of a ledger ---------------------------------------------------------------------------------------------
def flights_in(path: Path, campaign: Campaign, study: AssumptionStudy) -> dict[str, EnvironmentFlights]:
    """The flights of a ledger, by environment of the paper."""
    runs = Runs.read(path)
    names = dict(zip(map(label_of, campaign.environments), study.environments, strict=True))
    return {name: _environment_flights(runs.where(environment=label)) for label, name in names.items()}


def _environment_flights(runs: Runs) -> EnvironmentFlights:
    golden = _flights(runs.golden.where(arm=""))
    faulty = {setting: _flights(part) for (setting,), part in runs.injected.where("judged").groups("setting").items()}
    return EnvironmentFlights(golden, faulty)


def _flights(runs: Runs) -> Flights:
    frame = runs.frame
    return Flights(
        frame["success"].to_numpy(),
        frame["kernel_effect"].is_in(KERNEL_DUE).to_numpy() & (frame["level"] != "state").to_numpy(),
        frame["flight_time_s"].fill_null(np.inf).to_numpy(),
        frame["world"].to_numpy(),
    )


def _digest(path: Path) -> str:
    return str(Runs.read(path).campaign["digest"])


# ---- the frozen readings with detectors ------------------------------------------------------------------------------
class JudgedFlights(NamedTuple):
    """Fresh flights of a frozen reading.

    Attributes:
        flights: By environment of the paper; settings "fi" and those of all arms.
        runs: The same runs, by worlds of the detectors' training.
    """

    flights: Mapping[str, EnvironmentFlights]
    runs: Mapping[tuple[str, ...], Runs]


def _fly_with_detectors(  # noqa: PLR0913 - what the study is flown with
    study: AssumptionStudy,
    reading: PaperReading,
    folder: Path,
    executor: LocalExecutor,
    workers: int,
    bar: StudyBar,
) -> JudgedFlights:
    """Train the detectors, and fly a frozen reading with each reading of them."""
    flights: dict[str, EnvironmentFlights] = {}
    runs_by_training: dict[tuple[str, ...], Runs] = {}
    for training in dict.fromkeys(detectors.training for detectors in study.detectors.values()):
        campaign = study.judged_campaign(reading, training)
        name = "_".join(training) or "generated"
        models = folder / MODELS / f"{reading['difficulty']}-{name}"
        _train(study, campaign, training, models, workers, bar)
        path = folder / JUDGED / f"{reading.folder}-{name}"
        bar.begin_step(f"judged flights, detectors trained on {name} worlds")
        begun = begin(campaign, path, models_dir=models)
        run_campaigns({path: begun}, executor=executor, progress=bar.show_campaigns)
        runs_by_training[training] = _named_as_the_papers(Runs.read(path), campaign, study)
        # the arms of all trainings together
        for environment, part in flights_in(path, campaign, study).items():
            arms = {**flights[environment].faulty, **part.faulty} if environment in flights else part.faulty
            flights[environment] = EnvironmentFlights(part.golden, arms)
    return JudgedFlights(flights, runs_by_training)


def _judge(study: AssumptionStudy, frozen: FittedReading, judged: JudgedFlights) -> FrozenReading:
    """Compare a frozen reading, with each reading of the detectors, with the paper's detector cells."""
    deaths = study.value("deaths", frozen.reading["deaths"])
    losses = study.value("losses", frozen.reading["losses"])
    detectors = []
    for name, reading in study.detectors.items():
        settings = {f"dr_{kind}": f"dr_{study.arm_of(name, kind)}" for kind in DETECTORS}
        judgement = judge(frozen.fit, judged.flights, deaths, losses, settings)
        detectors.append(JudgedDetectors(name, judgement, _of_detectors(judged.runs[reading.training], settings)))
    return FrozenReading(frozen, judged.flights, detectors)


def _train(  # noqa: PLR0913
    study: AssumptionStudy, campaign: Campaign, training: tuple[str, ...], folder: Path, workers: int, bar: StudyBar
) -> None:
    """Train both detectors, unless their models are in the folder."""
    detectors = {(arm.detector, arm.profile) for arm in campaign.arms.values()}
    if not list(folder.glob("*.json")):
        mission = campaign.first_mission
        show: Callable[[int, int], None] = bar.show
        bar.begin_step("training flights")
        recorded = record(
            folder,
            study.training_flights,
            mission,
            workers=workers,
            progress=show,
            environments=training,
            only=detectors,
        )
        bar.begin_step("fitting of detectors")
        recorded.fit()


def _named_as_the_papers(runs: Runs, campaign: Campaign, study: AssumptionStudy) -> Runs:
    """Runs whose environments are named as the paper's, and whose faults count alike, as drawn."""
    names: dict[str, str] = dict(zip(map(label_of, campaign.environments), study.environments, strict=True))
    faulty = pl.col("kind") == "injected"
    return runs.adding(
        environment=pl.col("environment").replace(names),
        population=pl.when(faulty).then(pl.lit("all_bits")).otherwise(pl.col("population")),
    )


def _of_detectors(runs: Runs, settings: Mapping[str, str]) -> Runs:
    """Runs without a detector, and those with the two arms of one reading of the detectors, named as the paper's."""
    named: dict[str, Any] = {here: papers for papers, here in settings.items()}
    bare = pl.col("arm") == ""
    chosen = runs.where(bare | pl.col("setting").is_in(list(named)))
    return chosen.adding(setting=pl.col("setting").replace(named))
