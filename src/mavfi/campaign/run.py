"""Flies a campaign mission by mission; a stopped campaign resumes.

A worker that dies loses one mission, which is flown again with each run with a fault in a child of its own.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.executor import Executor, Lost
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.mission import (
    Flown,
    MissionPlan,
    Planned,
    fly_mission,
    host_of,
    plan_of,
    scenarios_of,
)
from mavfi.campaign.plan import Plan, arms_of
from mavfi.campaign.store import Store
from mavfi.errors import FROM_OUTSIDE, BadInputError, MachineError, machine_failure
from mavfi.flight_record import End, FlightRecord
from mavfi.hosts.host import require_level
from mavfi.hosts.watching import detector_for
from mavfi.mission import MissionStatus, Scenario
from mavfi.version import __version__

_PACKAGES = ("numpy", "numba", "llvmlite", "mujoco-core", "scikit-learn")
ATTEMPTS = 3  # how often a mission that takes its worker with it, golden runs included, is begun
PAUSE_S = 1.0  # between retries after a machine failure


@dataclass(frozen=True, slots=True)
class Status:
    """How far a campaign is."""

    done: int  # runs, those of earlier sessions included
    total: int  # runs of the whole campaign
    settings: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)
    """By setting: runs planned so far, done, done with success."""
    unknown: int = 0  # done runs with status unknown

    @property
    def complete(self) -> bool:
        """Whether nothing is left to fly."""
        return self.done == self.total


@dataclass(frozen=True, slots=True)
class Progress(Status):
    """How far a campaign is while it is flown."""

    flown: int = 0  # runs done in this session
    seconds: float = 0.0  # wall time since the first run of this session was done
    compiling: bool = False  # nothing is flown yet: kernels are being compiled

    @property
    def rate(self) -> float:
        """Runs per second in this session, from its first run on."""
        return (self.flown - 1) / self.seconds if self.seconds > 0 else 0.0

    @property
    def remaining_s(self) -> float:
        """Wall time that is left at this rate (s); infinite before the first run."""
        return (self.total - self.done) / self.rate if self.rate > 0 else float("inf")


@dataclass(slots=True)
class _Session:
    """A campaign between start and stop of the process."""

    plan: Plan
    store: Store
    models_dir: Path | None
    fast_forward: bool
    report: Callable[[Progress], None]
    started: float = 0.0
    flown: int = 0
    counts: dict[str, tuple[int, int, int]] = field(default_factory=dict)

    def missions(self) -> list[MissionPlan]:
        """What is left to fly."""
        complete = self.store.complete_missions()
        return [mission for mission in self._all_missions() if mission.world not in complete]

    def _all_missions(self) -> list[MissionPlan]:
        campaign, done = self.plan.campaign, self.store.done()
        worlds = [(environment, seed) for environment in campaign.environments for seed in campaign.seeds]
        return [
            MissionPlan(
                campaign, *world, self.models_dir, self.plan.models, self.fast_forward, done.get(world, frozenset())
            )
            for world in worlds
        ]

    def fly(self, executor: Executor, missions: list[MissionPlan]) -> None:
        """Fly missions; each item is in the ledger before the next one is taken."""
        self.tell()
        failed = ""
        for attempt in range(1 + ATTEMPTS):
            try:
                lost = {mission.world: (mission, end) for mission, end in self._fly_once(executor, missions)}
            except Exception as error:
                failed = machine_failure(error)
                if not failed:
                    raise
                if attempt == ATTEMPTS:
                    raise MachineError(failed) from error
                time.sleep(PAUSE_S)
                missions = self.missions()
                continue
            done = self.store.done()
            missions = [replace(m, done=done.get(m.world, frozenset()), alone=True) for m, _ in lost.values()]
            if not missions:
                return
        if failed:  # so it may be why workers died
            raise MachineError(failed)
        self._check_process(executor, {world: end for world, (_, end) in lost.items()})
        for mission in missions:
            self._give_up(mission, lost[mission.world][1])

    def _fly_once(self, executor: Executor, missions: list[MissionPlan]) -> Iterator[tuple[MissionPlan, Lost]]:
        with closing(executor.map(fly_mission, missions)) as items:
            for mission, item in items:
                match item:
                    case Lost():
                        yield mission, item
                    case Planned():
                        self._plan(mission, item)
                    case Flown():
                        self._write(item)

    def _plan(self, mission: MissionPlan, planned: Planned) -> None:
        self.store.plan(planned.specs)
        if planned.last:
            self.store.end_plan(mission.world)
        self.counts = self.store.counts()

    def _write(self, flown: Flown) -> None:
        self.store.write(flown.run_id, flown.record, flown.note, flown.wall_s)
        self.started = self.started or time.perf_counter()
        self.flown += 1
        setting = self.store.setting_of(flown.run_id)
        planned, done, success = self.counts[setting]
        self.counts[setting] = planned, done + 1, success + (flown.record.status == MissionStatus.SUCCESS.label)
        self.tell()

    def _check_process(self, executor: Executor, lost: Mapping[tuple[str, int], Lost]) -> None:
        """Check that workers die of their missions, not of this process, e.g. of code for which it had no memory.

        Raises:
            MachineError: No other mission was flown in this session, nor can be.
        """
        if self.flown:
            return
        others = [mission for mission in self._all_missions() if mission.world not in lost]
        with closing(executor.map(fly_mission, others[:1])) as items:
            if others and not any(isinstance(item, Lost) for _, item in items):
                return
        raise MachineError(f"no mission can be flown here: {next(iter(lost.values())).reason}")

    def _give_up(self, mission: MissionPlan, lost: Lost) -> None:
        """Record a mission whose golden runs take their process with them each time: nothing is drawn from these.

        Faults that were drawn in an earlier session are `unknown`.

        Raises:
            MachineError: Its worker was killed from outside.
        """
        if lost.signal in FROM_OUTSIDE:
            raise MachineError(f"mission {mission.environment}-{mission.seed}: {lost.reason}")
        self._plan(mission, Planned(tuple(self.plan.golden(*mission.world)), last=True))
        for spec in [run.spec for run in self.store.runs(done=False) if run.spec.world == mission.world]:
            end = End.DUE if lost.died and spec.kind == "golden" else End.UNKNOWN
            self._write(Flown(spec.run_id, FlightRecord(end, error=lost.reason), lost.reason))

    def tell(self, *, compiling: bool = False) -> None:
        """Report how far it is."""
        done = sum(number for _, number, _ in self.counts.values())
        seconds = time.perf_counter() - self.started if self.started else 0.0
        self.report(
            Progress(done, self.plan.count(), dict(self.counts), flown=self.flown, seconds=seconds, compiling=compiling)
        )


def run_campaign(
    campaign: Campaign, directory: Path, *, executor: Executor | None = None, models_dir: Path | None = None,
    fast_forward: bool = True, progress: Callable[[Progress], None] | None = None,
) -> Status:  # fmt: skip
    """Fly a campaign, or what is left of it; stopping it at any moment loses only the flights in the air.

    Args:
        campaign: What to fly.
        directory: Where its ledger is, or will be.
        executor: Runs the missions; None = two local processes.
        models_dir: Folder of trained models; None = the shipped ones.
        fast_forward: Whether runs may begin at checkpoints of their golden run; the ledger is the same either way.
        progress: Called after every run, in this process.

    Raises:
        BadInputError: A directory that cannot be written or holds another campaign; a name that is not known; a model
            that does not fit; versions that differ from those that the ledger was begun with.
    """
    host = host_of(campaign)
    require_level(host, campaign.sampling.level)
    scenarios = scenarios_of(campaign, arms_of(campaign))
    models = model_hashes(campaign, scenarios, models_dir)
    plan = plan_of(campaign, models, scenarios)
    with Store.create(directory, identity_of(campaign, scenarios, models)) as store:
        _check_versions(store)
        store.write_meta({
            "models_dir": None if models_dir is None else str(models_dir.absolute()),
            "missions": len(campaign.environments) * campaign.missions,
        })  # fmt: skip
        session = _Session(plan, store, models_dir, fast_forward, progress or (lambda _: None))
        missions = session.missions()
        session.counts = store.counts()
        if missions:
            host.check()
            if host.in_process:
                session.tell(compiling=True)
                _warm_up(missions[0])
        session.fly(executor or LocalExecutor(2), missions)
        return status(directory)


def _warm_up(mission: MissionPlan) -> None:
    """Fly golden runs and draw faults here, so that workers inherit the compiled code; results are not used."""
    for item in fly_mission(mission):
        if isinstance(item, Planned) and item.last:
            return


def identity_of(
    campaign: Campaign, scenarios: Mapping[tuple[str, str], Scenario], models: Mapping[str, str]
) -> dict[str, Any]:
    """Plain data that identify the campaign of a ledger."""
    return {
        "campaign": campaign.to_json(),
        "scenarios": {"/".join(place): scenario.to_json() for place, scenario in scenarios.items()},
        "models": dict(models),
    }


def model_hashes(
    campaign: Campaign, scenarios: Mapping[tuple[str, str], Scenario], models_dir: Path | None
) -> dict[str, str]:
    """Load every arm's detector for every environment, and return the sha256 of its model by arm.

    Raises:
        BadInputError: A detector is not known, or a model is absent or does not fit.
    """
    return {
        arm.name: detector_for(scenarios[environment, arm.name], arm.detector, arm.profile, models_dir)[1]
        for arm in arms_of(campaign)
        if arm.detector
        for environment in campaign.environments
    }


def status(directory: Path) -> Status:
    """How far a stored campaign is.

    Raises:
        BadInputError: There is none.
    """
    with Store.open(directory) as store:
        counts = store.counts()
        done = sum(number for _, number, _ in counts.values())
        total = sum(planned for planned, _, _ in counts.values())
        total = total if store.complete else plan_of(stored_campaign(store), {}, {}).count()
        return Status(done, total, counts, store.unknown())


def stored_campaign(store: Store) -> Campaign:
    """The campaign of a ledger."""
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
    """Note the versions that matter; a ledger with runs left to do that was begun with others is a BadInputError."""
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
