"""Flies a campaign: golden runs, then the draw of every fault, then the injected runs; goes on where it stopped.

With forking it does so mission by mission, so that the worker that flew the golden runs of a mission still has them
when its injected runs begin where the golden ones were.  The ledger is the same either way.
"""

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
from mavfi.campaign.kernel_plan import kernels_of, plan_kernel_world
from mavfi.campaign.kernel_worker import run_any, with_siblings
from mavfi.campaign.nodes.config import NodeCampaign
from mavfi.campaign.plan import (
    PHASE_GOLDEN,
    PHASE_INJECTED,
    Arm,
    RunSpec,
    arms_of,
    count_runs,
    other_planners,
    plan_golden,
    plan_injected,
    plan_world,
    scenario_name,
)
from mavfi.campaign.store import Store
from mavfi.campaign.tools import host_tools
from mavfi.campaign.worker import End, RunResult, Task, Tools, forget_families
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
    arms: list[Arm]
    forking: bool
    started: float = field(default_factory=time.perf_counter)
    flown: int = 0
    counts: dict[str, tuple[int, int, int]] = field(default_factory=dict)

    def fly_phases(self) -> None:
        """All golden runs, then the draw of all faults, then all injected runs."""
        store, campaign, keys = self.store, self.campaign, self._keys()
        self._fly([[self.task(run.spec)] for run in store.runs(PHASE_GOLDEN, done=False)], lambda _: [])
        if not store.is_planned(PHASE_INJECTED):
            store.plan(PHASE_INJECTED, plan_injected(campaign, keys, self.arms, store.profiles()))
        self._fly([[self.task(run.spec)] for run in store.runs(PHASE_INJECTED, done=False)], lambda _: [])

    def fly_worlds(self) -> None:
        """The same, mission by mission."""
        self.counts = self.store.counts()
        worlds = _Worlds(self)
        self._fly(worlds.left(), worlds.follow)

    def _fly(self, groups: list[list[Task]], follow: Callable[[Task], list[Task]]) -> None:
        """Fly; every result is in the ledger before the next one is looked at, and what follows from it is planned."""
        self.counts = self.store.counts()
        self._tell()
        if not groups:
            return
        self._warm_up([task for group in groups for task in group])
        with closing(self.pool.run_groups(run_any, groups, follow)) as results:
            for task, result in results:
                flown = _lost(result) if isinstance(result, Lost) else result
                self.store.write(task.spec, flown.record, flown.profile, flown.note, flown.wall_s)
                self.flown += 1
                planned, done, success = self.counts[task.spec.setting]
                self.counts[task.spec.setting] = (planned, done + 1, success + bool(flown.record.get("success")))
                self._tell()

    def plan_world(self, world: tuple[str, int]) -> list[RunSpec]:
        """Draw and store the faults of a mission whose golden runs are done."""
        campaign, keys = self.campaign, self._keys()
        if campaign.kernels is None:
            specs = plan_world(campaign, keys, self.arms, world, self.store.profile(*world))
        else:
            golden = (run.record or {} for run in self.store.runs(PHASE_GOLDEN, done=True, world=world))
            specs = plan_kernel_world(campaign, keys, self.arms, world, golden)
        self.store.plan_part(PHASE_INJECTED, specs)
        for spec in specs.values():
            planned, done, success = self.counts.get(spec.setting, (0, 0, 0))
            self.counts[spec.setting] = (planned + 1, done, success)
        return list(specs.values())

    def plan_golden(self) -> None:
        """Store the golden runs."""
        self.store.plan(PHASE_GOLDEN, plan_golden(self.campaign, self._keys(), self.arms))

    def _keys(self) -> dict[str, str]:
        return {name: scenario.key() for name, scenario in self.scenarios.items()}

    def task(self, spec: RunSpec) -> Task:
        scenario = self.scenarios[spec.scenario_name].model_copy(update={"seed": spec.seed})
        draws = kernels_of(spec, self.campaign) if spec.phase == PHASE_GOLDEN else {}
        return Task(spec, scenario, self.tools, self.models_dir, self.forking, draws, self.campaign.kernels)

    def _warm_up(self, tasks: list[Task]) -> None:
        """Fly one error-free run of each arm here, so that workers inherit what is compiled; results are not used."""
        first = {task.spec.arm: task for task in reversed(tasks)}
        for task in first.values():
            run_any(replace(task, spec=replace(task.spec, fault=None)))
        forget_families()

    def _tell(self) -> None:
        done = sum(number for _, number, _ in self.counts.values())
        seconds = time.perf_counter() - self.started
        self.report(Progress(done, count_runs(self.campaign), dict(self.counts), self.flown, seconds))


class _Worlds:
    """What is left to fly, by mission: its golden runs, and once these are done its injected runs."""

    def __init__(self, sitting: _Sitting) -> None:
        self._sitting = sitting
        self._golden: dict[tuple[str, int], list[Task]] = {}
        self._injected: dict[tuple[str, int], list[Task]] = {}
        for run in sitting.store.runs():
            tasks = self._golden if run.spec.phase == PHASE_GOLDEN else self._injected
            left = tasks.setdefault(_world(run.spec), [])
            if run.record is None:
                left.append(sitting.task(run.spec))
        self._airborne = {world: len(tasks) for world, tasks in self._golden.items() if tasks}

    def left(self) -> list[list[Task]]:
        """Groups to begin with; the faults of missions whose golden runs are done are drawn here."""
        for world, tasks in self._golden.items():
            if not tasks and world not in self._injected:
                self._injected[world] = self._plan(world)
        self._end_plan()
        groups = [tasks or with_siblings(self._injected.get(world, [])) for world, tasks in self._golden.items()]
        return [group for group in groups if group]

    def follow(self, task: Task) -> list[Task]:
        """The injected runs of a mission, after the last of its golden runs."""
        world = _world(task.spec)
        if world not in self._airborne:
            return []
        self._airborne[world] -= 1
        if self._airborne[world]:
            return []
        del self._airborne[world]
        tasks = with_siblings(self._plan(world))
        self._end_plan()
        return tasks

    def _plan(self, world: tuple[str, int]) -> list[Task]:
        return [self._sitting.task(spec) for spec in self._sitting.plan_world(world)]

    def _end_plan(self) -> None:
        """Note that every mission is planned, once it is."""
        if not self._airborne and not self._sitting.store.is_planned(PHASE_INJECTED):
            self._sitting.store.end_plan(PHASE_INJECTED)


def _world(spec: RunSpec) -> tuple[str, int]:
    return spec.environment, spec.seed


def run_campaign(  # noqa: PLR0913 - everything after the directory has a default
    campaign: Campaign,
    directory: Path,
    *,
    workers: int = 2,
    models_dir: Path | None = None,
    tools: Tools | None = None,
    forking: bool = True,
    progress: Callable[[Progress], None] | None = None,
) -> Status:
    """Fly a campaign, or what is left of it; stopping it at any moment loses only the flights in the air.

    Args:
        campaign: What to fly.
        directory: Where its ledger is, or will be.
        workers: Number of processes.
        models_dir: Folder of trained models; None = the shipped ones.
        tools: Host and detectors; None = the in-process host.
        forking: Whether runs begin at their golden twin's checkpoints, where the tools can do so; the ledger is the
            same either way.
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
        "campaign": campaign.to_json(),
        "scenarios": {name: scenario.to_json() for name, scenario in scenarios.items()},
        "models": {arm.name: arm.model for arm in arms if arm.name},
    }
    with Store.create(directory, identity) as store:
        check_versions(store)
        store.write_meta({"models_dir": None if models_dir is None else str(models_dir.absolute())})
        forks = (forking and tools.make_family is not None) or campaign.kernels is not None
        sitting = _Sitting(campaign, store, scenarios, models_dir, tools, pool, progress or _silent, arms, forks)
        sitting.plan_golden()
        if forks:
            sitting.fly_worlds()
        else:
            sitting.fly_phases()
        return status(directory)


def campaign_scenarios(campaign: Campaign, tools: Tools) -> dict[str, Scenario]:
    """Scenario with the campaign's first seed, by its name in the ledger.

    Raises:
        BadInputError: A name is not known.
    """
    planners = {"": campaign.planner, **{name: name for name in other_planners(campaign)}}
    return {
        scenario_name(environment, arm, ""): tools.make_scenario(
            environment,
            campaign.first_seed,
            stack=campaign.stack,
            platform=campaign.platform,
            planner=planner,
            v_max=campaign.v_max,
            map_kind=campaign.map,
            vehicle=campaign.vehicle,
        )
        for environment in campaign.environments
        for arm, planner in planners.items()
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
        return Status(done, _total(store), counts)


def _total(store: Store) -> int:
    identity = store.meta("identity")["campaign"]
    if store.is_of_nodes:
        return NodeCampaign.model_validate(identity).count
    return count_runs(stored_campaign(store))


def stored_campaign(store: Store) -> Campaign:
    """The campaign that a ledger holds.

    Raises:
        BadInputError: It holds trials on a ROS node, not flights.
    """
    store.require_flights()
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


def check_versions(store: Store) -> None:
    """Note the versions that matter, or refuse to go on with others than a ledger was begun with.

    Raises:
        BadInputError: They differ, and something is left to do.
    """
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
