"""Flies a campaign mission by mission; a stopped campaign resumes.

If a worker dies, its mission is repeated with each injected run in a separate child process.
"""

import itertools
import json
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.executor import Done, Executor, Lost
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.fingerprint import versions
from mavfi.campaign.log import Log
from mavfi.campaign.mission import MissionPlan, fly_mission, host_of, model_hashes, plan_of, scenarios_of
from mavfi.campaign.outside import held
from mavfi.campaign.pace import Pace
from mavfi.campaign.plan import Flown, Plan, Planned, arms_of, golden_done, is_golden
from mavfi.campaign.sequential import Precision
from mavfi.campaign.shard import WHOLE, Shard
from mavfi.campaign.store import Store
from mavfi.campaign.warm_up import fly_mission_anywhere, is_compiled, warm_up
from mavfi.config import STORED, parse
from mavfi.detectors.registry import detector_options, mission_keys
from mavfi.errors import FROM_OUTSIDE, BadInputError, MachineError, machine_failure
from mavfi.flight_record import End, FlightRecord
from mavfi.hosts.host import require_level
from mavfi.mission import Scenario

SHARD = "shard"
ORDERED = "campaign"
"""Metadata key: the campaign as JSON text in its order of keys; the identity has sorted keys."""
ATTEMPTS = 3  # further attempts after a machine failure, or for missions that crash their workers
PAUSE_S = 1.0  # between retries after a machine failure


@dataclass(frozen=True, slots=True)
class Status:
    """Progress of a stored campaign."""

    done: int  # runs, earlier sessions included
    total: int  # runs of the complete campaign
    settings: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)
    """By setting: runs planned so far, done, successful."""
    unknown: int = 0  # done runs with status unknown
    shard: Shard = WHOLE  # shard in the ledger

    @property
    def complete(self) -> bool:
        """Whether all runs are done."""
        return self.done == self.total


@dataclass(frozen=True, slots=True)
class Progress(Status):
    """Progress of a running campaign."""

    flown: int = 0  # runs done in this session
    rate: float = 0.0  # runs per second over the latest runs; 0 = unknown yet
    remaining_s: float = math.inf  # remaining wall time (s); infinite = unknown yet
    compiling: bool = False  # kernels are being compiled; no run has been flown yet


@dataclass(slots=True)
class _Session:
    """Execution of a campaign within one process."""

    plan: Plan
    store: Store
    models_dir: Path | None
    fast_forward: bool
    shard: Shard
    report: Callable[[Progress], None]
    log: Log
    total: int  # runs of the shard
    precision: Precision | None = None  # what decides that an environment has enough missions
    pace: Pace = field(default_factory=lambda: Pace(time.perf_counter()))
    flying: set[tuple[str, int]] = field(default_factory=set)
    flown: int = 0
    counts: dict[str, tuple[int, int, int]] = field(default_factory=dict)

    def missions(self) -> Iterator[MissionPlan]:
        """Incomplete missions, environment by environment; alternating if a half-width ends the campaign."""
        worlds: Iterable[tuple[str, int]] = self.shard.worlds(self.plan.campaign)
        if self.precision is not None:
            worlds = sorted(worlds, key=lambda world: world[1])
        for world in worlds:
            if not self.store.is_complete(world) and not (self.precision and self.precision.met(world[0])):
                yield self._mission(world)

    def _mission(self, world: tuple[str, int]) -> MissionPlan:
        plan = self.plan
        return MissionPlan(
            plan.campaign, *world, self.models_dir, plan.models, plan.keys(world[0]), self.fast_forward,
            self.store.done(world),
        )  # fmt: skip

    def fly(self, executor: Executor) -> None:
        """Fly the incomplete missions; items are stored in the ledger before the next ones are fetched."""
        self.pace = Pace(time.perf_counter())
        self.tell()
        missions: Iterable[MissionPlan] = self.missions()
        failed = ""
        for attempt in range(1 + ATTEMPTS):
            try:
                lost = {mission.world: (mission, end) for mission, end in self._fly_once(executor, missions)}
            except Exception as error:
                failed = machine_failure(error)
                if not failed:
                    raise
                self.log.note("retry", attempt=attempt + 1, of=1 + ATTEMPTS, reason=failed)
                if attempt == ATTEMPTS:
                    raise MachineError(failed) from error
                time.sleep(PAUSE_S)
                missions = self.missions()
                continue
            missions = [replace(m, done=self.store.done(m.world), alone=True) for m, _ in lost.values()]
            if not missions:
                return
        if failed:  # the machine failure may have killed the workers
            raise MachineError(failed)
        self._check_process(executor, {world: end for world, (_, end) in lost.items()})
        for mission in missions:
            self._give_up(mission, lost[mission.world][1])

    def _fly_once(
        self, executor: Executor, missions: Iterable[MissionPlan]
    ) -> Iterator[tuple[MissionPlan, Lost]]:  # fmt: skip
        self.flying.clear()
        function = fly_mission if executor.forks else fly_mission_anywhere
        with closing(executor.map(function, missions)) as batches:
            for mission, items in self.log.following(batches):
                self.flying.add(mission.world)
                self._write(mission, items)
                last = items[-1]
                if isinstance(last, (Done, Lost)):
                    self.flying.discard(mission.world)
                if isinstance(last, Done):
                    self.pace.over(mission.world)
                if isinstance(last, Lost):
                    yield mission, last

    def _write(self, mission: MissionPlan, items: Sequence[object]) -> None:
        """Store plans and results of a mission, in one transaction."""
        planned = [item for item in items if isinstance(item, Planned)]
        with self.store.writing():
            new = self.store.plan(row for item in planned for row in item.rows)
            if any(item.last for item in planned):
                self.store.end_plan(mission.world)
            done = self.store.write(item for item in items if isinstance(item, Flown))
        for row in new:
            self._count(row.setting, 1, 0, 0)
        for setting, item in done:
            self._count(setting, 0, 1, item.success)
            self.pace.note(time.perf_counter(), mission.world, is_golden(setting), item.wall_s)
            self.flown += 1
            self.tell()

    def _count(self, setting: str, *more: int) -> None:
        planned, done, success = map(sum, zip(self.counts.get(setting, (0, 0, 0)), more, strict=True))
        self.counts[setting] = planned, done, success

    def _check_process(self, executor: Executor, lost: Mapping[tuple[str, int], Lost]) -> None:
        """Check that the missions crashed their workers, not this process, e.g. by compilation without memory.

        Raises:
            MachineError: No other mission was flown in this session, nor can be flown.
        """
        if self.flown:
            return
        others = (world for world in self.shard.worlds(self.plan.campaign) if world not in lost)
        other = [self._mission(world) for world in itertools.islice(others, 1)]
        if other and not list(self._fly_once(executor, other)):
            return
        raise MachineError(f"no mission can be flown here: {next(iter(lost.values())).reason}")

    def _give_up(self, mission: MissionPlan, lost: Lost) -> None:
        """Record a mission whose golden runs crash their process in every attempt; no faults are drawn from them.

        Faults drawn in an earlier session are `unknown`.

        Raises:
            MachineError: The worker was killed from outside.
        """
        if lost.signal in FROM_OUTSIDE:
            raise MachineError(f"mission {mission.environment}-{mission.seed}: {lost.reason}")
        self.log.note("gave_up", mission=f"{mission.environment}-{mission.seed}", reason=lost.reason)
        self._write(mission, [Planned.of(self.plan.golden(*mission.world), last=True)])
        for spec in [run.spec for run in self.store.runs(done=False, world=mission.world)]:
            end = End.DUE if lost.died and spec.kind == "golden" else End.UNKNOWN
            flown = Flown.of(spec.run_id, FlightRecord(end, error=lost.reason), lost.reason)
            self.log.flown(flown)
            self._write(mission, [flown])

    @contextmanager
    def logged(self, executor: Executor) -> Iterator[None]:
        """Log start and end of the session."""
        self.log.note(
            "begin", campaign=self.plan.campaign.name, versions=versions(), pid=os.getpid(),
            workers=executor.workers, runs_left=self.total - self._done,
        )  # fmt: skip
        try:
            yield
        except BaseException as error:
            self.log.end(error, done=self._done, total=self.total)
            raise
        self.log.end(None, done=self._done, total=self._done, digest=self.store.digest())

    @property
    def _done(self) -> int:
        return sum(number for _, number, _ in self.counts.values())

    def tell(self, *, compiling: bool = False) -> None:
        """Report the progress."""
        done, total = self._done, self.total
        if self.precision is not None and self.flying:
            total = max(done + 1, round(total * self.precision.expected() / self.plan.campaign.total_missions))
        golden_left = self.plan.golden_count(self.shard) - golden_done(self.counts)
        left = {True: golden_left, False: total - done - golden_left}
        remaining_s = self.pace.remaining_s(left, len(self.flying))
        self.report(Progress(
            done, total, dict(self.counts), flown=self.flown, rate=self.pace.rate, remaining_s=remaining_s,
            compiling=compiling,
        ))  # fmt: skip


def run_campaign(
    campaign: Campaign, directory: Path, *, executor: Executor | None = None, models_dir: Path | None = None,
    fast_forward: bool = True, shard: Shard = WHOLE, progress: Callable[[Progress], None] | None = None,
) -> Status:  # fmt: skip
    """Fly the missing runs of a campaign; a stop at any time loses only the flights in progress.

    Args:
        campaign: The campaign.
        directory: Folder of its ledger, existing or new.
        executor: Runs the missions; None = two local processes.
        models_dir: Folder of trained models; None = that of the ledger, or the shipped ones.
        fast_forward: Whether runs may start at checkpoints of their golden run; the ledger is the same either way.
        shard: Subset of missions; the ledgers of all shards can be merged.
        progress: Called after every run, in this process.

    Raises:
        BadInputError: The directory cannot be written or holds another campaign, a name is unknown, a model does not
            match, or versions differ from those with which the ledger was started.
    """
    campaign, models_dir = _as_begun(campaign, directory), models_dir or _models_dir(directory)
    host = host_of(campaign)
    require_level(host, campaign.sampling.level)
    scenarios = scenarios_of(campaign, arms_of(campaign))
    models = model_hashes(campaign, scenarios, models_dir)
    plan = plan_of(campaign, models, scenarios)
    executor = executor or LocalExecutor(2)
    with Store.create(directory, identity_of(campaign, scenarios, models)) as store:
        check_versions(store, {**versions(), **plan.sampler.versions})
        check_shard(store, shard)
        store.write_meta({
            ORDERED: campaign.model_dump_json(),
            "models_dir": None if models_dir is None else _as_held(models_dir, directory),
            "missions": shard.missions(campaign),
        })  # fmt: skip
        session = _Session(
            plan, store, models_dir, fast_forward, shard, progress or (lambda _: None), Log(directory),
            plan.count(shard), Precision.of(campaign, store, shard), counts=store.counts(),
        )  # fmt: skip
        with session.logged(executor):
            first = next(session.missions(), None)
            if first is not None:
                host.check()
                if host.in_process:
                    session.tell(compiling=True)
                if host.in_process and executor.forks and not is_compiled(campaign):
                    warm_up(first)
            session.fly(executor)
            if session.precision is not None:
                store.write_meta({"missions": len(store.planned())})
        return status(directory)


def _as_begun(campaign: Campaign, directory: Path) -> Campaign:
    """The campaign with its keys in the order of its ledger, which determines draws and positions of runs."""
    with suppress(ValueError):  # no ledger, or damage, which is reported when the ledger is opened
        begun = Campaign.model_validate_json(held(directory, ORDERED) or "", context=STORED)
        return begun if begun == campaign else campaign
    return campaign


def _models_dir(directory: Path) -> Path | None:
    path = held(directory, "models_dir")
    return None if path is None else directory / path


def _as_held(models_dir: Path, directory: Path) -> str:
    """The path as stored in a ledger: relative if inside the ledger's folder, so that both can be moved."""
    path, own = models_dir.absolute(), directory.absolute()
    return str(path.relative_to(own) if path.is_relative_to(own) else path)


def identity_of(
    campaign: Campaign, scenarios: Mapping[tuple[str, str], Scenario], models: Mapping[str, str]
) -> dict[str, Any]:
    """Identity of a ledger's campaign, as plain data."""
    arms = campaign.arms.items()
    keys = {name: dict(own) for name, arm in arms if (own := mission_keys(arm.detector))}
    options = {name: dict(own) for name, arm in arms if (own := detector_options(arm.detector))}
    return {
        "campaign": campaign.to_json(),
        "scenarios": {"/".join(place): scenario.to_json() for place, scenario in scenarios.items()},
        "models": dict(models),
        **({"mission_keys": keys} if keys else {}),
        **({"detector_options": options} if options else {}),
    }


def status(directory: Path) -> Status:
    """Progress of a stored campaign.

    Raises:
        BadInputError: The folder holds no ledger.
    """
    with Store.open(directory) as store:
        return status_of(store)


def status_of(store: Store) -> Status:
    """Progress of the campaign in an open ledger."""
    counts = store.counts()
    done = sum(number for _, number, _ in counts.values())
    total = sum(planned for planned, _, _ in counts.values())
    shard = shard_of(store)
    total = total if store.complete else plan_of(stored_campaign(store), {}, {}).count(shard)
    return Status(done, total, counts, store.unknown().total(), shard)


def shard_of(store: Store) -> Shard:
    """The shard of a ledger; raises a BadInputError if its entry is invalid."""
    return Shard.parse(store.meta(SHARD) or str(WHOLE), str(store.directory))


def stored_campaign(store: Store) -> Campaign:
    """The campaign of a ledger (older ones do not store the order of keys); raises a BadInputError if invalid."""
    text = store.meta(ORDERED)
    given = store.meta("identity")["campaign"] if text is None else json.loads(text)
    return parse(Campaign, given, str(store.directory), stored=True)


def check_shard(store: Store, shard: Shard) -> None:
    """Store the shard; raises a BadInputError if the ledger belongs to another one."""
    if store.meta(SHARD) is None:
        store.write_meta({SHARD: str(shard)})
    if shard_of(store) != shard:
        raise BadInputError(f"{store.directory}: holds shard {shard_of(store)}, not {shard}; choose another directory")


def check_versions(store: Store, versions_there: Mapping[str, str], there: str = "here is") -> None:
    """Store the versions; raises a BadInputError if an incomplete ledger was started with others.

    Args:
        store: The ledger.
        versions_there: Versions of the runs to be added.
        there: Words before such a version in the message.
    """
    held: dict[str, Any] | None = store.meta("versions")
    if held is None:
        store.write_meta({"versions": dict(versions_there)})
        return
    differing = [name for name in versions_there if held.get(name) != versions_there[name]]
    if differing and not store.complete:
        name = differing[0]
        raise BadInputError(
            f"{store.directory}: was begun with {name} {held.get(name)}, {there} {versions_there[name]}; runs "
            "cannot be mixed"
        )
