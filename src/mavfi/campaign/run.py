"""Flies a campaign: golden runs, then the draw of every fault, then the injected runs; goes on where it stopped."""

import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from mavfi import __version__
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalPool, Lost
from mavfi.campaign.plan import (
    PHASE_GOLDEN,
    PHASE_INJECTED,
    Arm,
    RunSpec,
    arms_of,
    count_runs,
    plan_golden,
    plan_injected,
)
from mavfi.campaign.store import Store
from mavfi.campaign.tools import host_tools
from mavfi.campaign.worker import End, RunResult, Task, Tools, run_task
from mavfi.errors import BadInputError
from mavfi.mission import Scenario

_PACKAGES = ("numpy", "numba", "llvmlite", "mujoco-core", "scikit-learn")


@dataclass(frozen=True, slots=True)
class Status:
    """How far a campaign is.

    Attributes:
        done: Runs done, those of earlier sittings included.
        total: Runs of the whole campaign.
        settings: By setting: planned so far, done, done with success.
    """

    done: int
    total: int
    settings: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)

    @property
    def complete(self) -> bool:
        """Whether nothing is left to fly."""
        return self.done == self.total


@dataclass(frozen=True, slots=True)
class Progress(Status):
    """How far a campaign is while it is flown.

    Attributes:
        flown: Runs done in this sitting.
        seconds: Wall time of this sitting (s).
    """

    flown: int = 0
    seconds: float = 0.0

    @property
    def rate(self) -> float:
        """Runs per second in this sitting."""
        return self.flown / self.seconds if self.seconds > 0 else 0.0

    @property
    def remaining_s(self) -> float:
        """Wall time that is left at this rate (s); infinite before the first run."""
        return (self.total - self.done) / self.rate if self.rate > 0 else float("inf")


@dataclass(slots=True)
class _Sitting:
    """A campaign between start and stop of the process."""

    campaign: Campaign
    store: Store
    scenarios: Mapping[str, Scenario]
    models_dir: Path | None
    tools: Tools
    pool: LocalPool
    report: Callable[[Progress], None]
    started: float = field(default_factory=time.perf_counter)
    flown: int = 0

    def fly(self, phase: int) -> None:
        """Fly what is left of a phase; every result is in the ledger before the next one is looked at."""
        counts = self.store.counts()
        self._tell(counts)
        tasks = [self.task(run.spec) for run in self.store.runs(phase, done=False)]
        if not tasks:
            return
        self._warm_up(tasks)
        with closing(self.pool.run(run_task, tasks)) as results:
            for task, result in results:
                flown = _lost(result) if isinstance(result, Lost) else result
                self.store.write(task.spec, flown.record, flown.profile, flown.note, flown.wall_s)
                self.flown += 1
                planned, done, success = counts[task.spec.setting]
                counts[task.spec.setting] = (planned, done + 1, success + bool(flown.record.get("success")))
                self._tell(counts)

    def task(self, spec: RunSpec) -> Task:
        scenario = self.scenarios[spec.environment].model_copy(update={"seed": spec.seed})
        return Task(spec, scenario, self.tools, self.models_dir)

    def _warm_up(self, tasks: list[Task]) -> None:
        """Fly one error-free run of each arm here, so that workers inherit what is compiled; results are not used."""
        first = {task.spec.arm: task for task in reversed(tasks)}
        for task in first.values():
            run_task(replace(task, spec=replace(task.spec, fault=None)))

    def _tell(self, counts: dict[str, tuple[int, int, int]]) -> None:
        done = sum(number for _, number, _ in counts.values())
        seconds = time.perf_counter() - self.started
        self.report(Progress(done, count_runs(self.campaign), dict(counts), self.flown, seconds))


def run_campaign(  # noqa: PLR0913 - everything after the directory has a default
    campaign: Campaign,
    directory: Path,
    *,
    workers: int = 2,
    models_dir: Path | None = None,
    tools: Tools | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Status:
    """Fly a campaign, or what is left of it; stopping it at any moment loses only the flights in the air.

    Args:
        campaign: What to fly.
        directory: Where its ledger is, or will be.
        workers: Number of processes.
        models_dir: Folder of trained models; None = the shipped ones.
        tools: Host and detectors; None = the in-process host.
        progress: Called after every run, in this process.

    Returns:
        The end state.

    Raises:
        BadInputError: No worker; a directory that cannot be written or holds another campaign; a name that is not
            known; a model that does not fit; versions that differ from those of the first sitting.
    """
    pool = LocalPool(workers)
    tools = tools or host_tools()
    scenarios = campaign_scenarios(campaign, tools)
    arms = arms_of(campaign, model_hashes(campaign, scenarios, models_dir, tools))
    identity = {
        "campaign": campaign.model_dump(mode="json"),
        "scenarios": {name: scenario.to_json() for name, scenario in scenarios.items()},
        "models": {arm.name: arm.model for arm in arms if arm.name},
    }
    with Store.create(directory, identity) as store:
        _check_versions(store)
        store.write_meta({"models_dir": None if models_dir is None else str(models_dir.absolute())})
        sitting = _Sitting(campaign, store, scenarios, models_dir, tools, pool, progress or _silent)
        _fly_phases(sitting, arms)
        return status(directory)


def _fly_phases(sitting: _Sitting, arms: list[Arm]) -> None:
    store, campaign = sitting.store, sitting.campaign
    keys = {name: scenario.key() for name, scenario in sitting.scenarios.items()}
    store.plan(PHASE_GOLDEN, plan_golden(campaign, keys, arms))
    sitting.fly(PHASE_GOLDEN)
    if not store.is_planned(PHASE_INJECTED):
        store.plan(PHASE_INJECTED, plan_injected(campaign, keys, arms, store.profiles()))
    sitting.fly(PHASE_INJECTED)


def campaign_scenarios(campaign: Campaign, tools: Tools) -> dict[str, Scenario]:
    """Scenario with the campaign's first seed, by environment.

    Raises:
        BadInputError: A name is not known.
    """
    return {
        name: tools.make_scenario(
            name,
            campaign.first_seed,
            stack=campaign.stack,
            platform=campaign.platform,
            planner=campaign.planner,
            v_max=campaign.v_max,
            map_kind=campaign.map,
        )
        for name in campaign.environments
    }


def model_hashes(
    campaign: Campaign, scenarios: Mapping[str, Scenario], models_dir: Path | None, tools: Tools
) -> dict[str, str]:
    """Load every arm's detector for every environment, and answer the sha256 of its model.

    Raises:
        BadInputError: A detector is not known, or a model is absent or does not fit.
    """
    return {
        name: tools.load_detector(arm.detector, arm.profile, models_dir, scenario)[1]
        for name, arm in campaign.detectors.items()
        for scenario in scenarios.values()
    }


def status(directory: Path) -> Status:
    """How far a stored campaign is.

    Raises:
        BadInputError: There is none.
    """
    with Store.open(directory) as store:
        counts = store.counts()
        done = sum(number for _, number, _ in counts.values())
        return Status(done, count_runs(stored_campaign(store)), counts)


def stored_campaign(store: Store) -> Campaign:
    """The campaign that a ledger holds."""
    return Campaign.model_validate(store.meta("identity")["campaign"])


def versions() -> dict[str, str]:
    """Versions that decide the bits of a flight."""
    found = {"mavfi": __version__}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "absent"
    return found


def _check_versions(store: Store) -> None:
    here = versions()
    held: dict[str, Any] | None = store.meta("versions")
    if held is None:
        store.write_meta({"versions": here})
        return
    differing = [name for name in here if held.get(name) != here[name]]
    if differing and not store.complete:
        name = differing[0]
        raise BadInputError(
            f"{store.directory}: was begun with {name} {held.get(name)}, here is {here[name]}; runs cannot be mixed"
        )


def _lost(lost: Lost) -> RunResult:
    end = End.DUE if lost.died else End.UNKNOWN
    error = "worker died each time" if lost.died else "no answer in time"
    return RunResult({"end": end, "error": error}, None, lost.reason)


def _silent(_: Progress) -> None:
    """Tell nobody."""
