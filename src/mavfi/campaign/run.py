"""Flies campaigns mission by mission, alone or together; a stopped campaign resumes.

Missions are flown by an executor, and stored as they arrive.  Campaigns of a study fly together: missions of several
campaigns that start from the same golden flights, e.g. with faults in states and in instructions, are flown by one
worker, one after the other, and share these flights.  If a worker dies, its missions are repeated with each injected
run in a separate child process.
"""

import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mavfi.campaign.executors.executor import Done, Executor, Lost
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.extension import differ_in_size, extend_ledger
from mavfi.campaign.fingerprint import versions
from mavfi.campaign.ledger import ORDERED, Progress, Status, check_shard, check_versions, status
from mavfi.campaign.log import Log
from mavfi.campaign.mission import Job, MissionPlan, flights_of, fly_missions, share
from mavfi.campaign.plan import WHOLE, CompletedRun, Plan, Planned, Shard
from mavfi.campaign.resolve import ResolvedCampaign
from mavfi.campaign.store import IDENTITY, Store, read_meta
from mavfi.campaign.warm_up import fly_missions_anywhere, is_compiled, warm_up
from mavfi.detectors.registry import detector_options, mission_keys
from mavfi.errors import FROM_OUTSIDE, BadInputError, MachineError, machine_failure
from mavfi.record import End, FlightRecord, canonical

ATTEMPTS = 3  # further attempts after a machine failure, or for missions that crash their workers
PAUSE_S = 1.0  # between retries after a machine failure
_SessionMission = tuple[int, tuple[str, int]]  # number of a session; environment and seed of a mission in it


@dataclass(slots=True)
class Session:
    """Execution of one campaign within one process."""

    plan: Plan
    store: Store
    fast_forward: bool
    shard: Shard
    report: Callable[[Path, Progress], None] | None
    log: Log
    total: int  # runs of the shard
    flown: int = 0
    counts: dict[str, tuple[int, int, int]] = field(default_factory=dict)
    _flights: dict[str, Mapping[str, str]] = field(default_factory=dict)

    def worlds(self) -> Iterable[tuple[str, int]]:
        """All missions, environment by environment."""
        return self.shard.worlds(self.plan.campaign.config)

    def incomplete_mission(self, world: tuple[str, int]) -> MissionPlan | None:
        """A mission, if runs of it are missing."""
        if self.store.is_complete(world):
            return None
        return self.mission(world)

    def flights(self, environment: str) -> Mapping[str, str]:
        """What determines the golden flights of the missions in an environment, see `flights_of`."""
        if environment not in self._flights:
            self._flights[environment] = flights_of(self.plan.campaign, environment)
        return self._flights[environment]

    def mission(self, world: tuple[str, int]) -> MissionPlan:
        """A mission without its runs in the ledger."""
        return MissionPlan(self.plan.campaign, *world, self.fast_forward, self.store.done(world))

    def take(self, mission: MissionPlan, items: Sequence[Planned | CompletedRun], last: Done | Lost | None) -> None:
        """Store and log new items of a mission, and its end."""
        self.log.follow(mission, items, last)
        self.write(mission, items)

    def write(self, mission: MissionPlan, items: Sequence[Planned | CompletedRun]) -> None:
        """Store plans and results of a mission, in one transaction."""
        planned = [item for item in items if isinstance(item, Planned)]
        with self.store.writing():
            new_rows = self.store.plan(row for item in planned for row in item.rows)
            if any(item.last for item in planned):
                self.store.end_plan(mission.world)
            new_runs = self.store.write(item for item in items if isinstance(item, CompletedRun))
        for row in new_rows:
            self._count(row.setting, planned=1)
        for setting, run in new_runs:
            self._count(setting, done=1, success=int(run.success))
            self.flown += 1
            self.tell()

    def _count(self, setting: str, planned: int = 0, done: int = 0, success: int = 0) -> None:
        """Add to the numbers of runs of a setting."""
        before = self.counts.get(setting, (0, 0, 0))
        self.counts[setting] = before[0] + planned, before[1] + done, before[2] + success

    def give_up(self, mission: MissionPlan, lost: Lost) -> None:
        """Record a mission whose golden runs crash their process in every attempt; no faults are drawn from them.

        Faults drawn in an earlier session are `unknown`.

        Raises:
            MachineError: The worker was killed from outside.
        """
        if lost.signal in FROM_OUTSIDE:
            raise MachineError(f"mission {mission.environment}-{mission.seed}: {lost.reason}")
        self.log.note("gave_up", mission=f"{mission.environment}-{mission.seed}", reason=lost.reason)
        self.write(mission, [Planned.of(self.plan.golden(*mission.world), last=True)])
        missing = [run.spec for run in self.store.runs(done=False, world=mission.world)]
        for spec in missing:
            end = End.UNKNOWN
            if lost.died and spec.kind == "golden":
                end = End.DUE
            run = CompletedRun.of(spec.run_id, FlightRecord(end, error=lost.reason), lost.reason)
            self.log.flown(run)
            self.write(mission, [run])

    @contextmanager
    def logged(self, executor: Executor) -> Iterator[None]:
        """Log start and end of the session."""
        self.log.note(
            "begin",
            campaign=self.plan.campaign.config.name,
            versions=versions(),
            pid=os.getpid(),
            workers=executor.workers,
            runs_left=self.total - self._runs_done,
        )
        try:
            yield
        except BaseException as error:
            self.log.end(error, done=self._runs_done, total=self.total)
            raise
        self.log.end(None, done=self._runs_done, total=self._runs_done, digest=self.store.digest())

    @property
    def _runs_done(self) -> int:
        """Number of runs that have a result."""
        return sum(number for _, number, _ in self.counts.values())

    def tell(self, *, compiling: bool = False) -> None:
        """Report the progress, if somebody follows it."""
        if self.report is None:
            return
        self.report(
            self.store.directory,
            Progress(
                self._runs_done,
                self.total,
                dict(self.counts),
                flies=self.plan.campaign.config.flies,
                flown=self.flown,
                compiling=compiling,
            ),
        )


@dataclass(frozen=True, slots=True)
class Flying:
    """The sessions of campaigns that are flown together."""

    sessions: Sequence[Session]

    def fly(self, executor: Executor) -> None:
        """Fly the incomplete missions; items are stored in their ledgers before the next ones are fetched."""
        for session in self.sessions:
            session.tell()
        jobs: Iterable[Job] = self.jobs()
        failure = ""
        for attempt in range(1 + ATTEMPTS):
            try:
                lost_missions = list(self._fly_once(executor, jobs))
            except Exception as error:
                # A failure of the machine may pass: fly everything that is missing again.
                failure = machine_failure(error)
                if not failure:
                    raise
                for session in self.sessions:
                    session.log.note("retry", attempt=attempt + 1, of=1 + ATTEMPTS, reason=failure)
                if attempt == ATTEMPTS:
                    raise MachineError(failure) from error
                time.sleep(PAUSE_S)
                jobs = self.jobs()
                continue
            # Missions that have lost their worker are repeated one by one, each run in a process of its own.
            jobs = [((number, self._alone(number, mission)),) for number, mission, _ in lost_missions]
            if not jobs:
                return
        if failure:  # the machine failure may have killed the workers
            raise MachineError(failure)
        self._check_process(executor, lost_missions)
        for number, mission, end in lost_missions:
            self.sessions[number].give_up(self._alone(number, mission), end)

    def jobs(self) -> Iterator[Job]:
        """Incomplete missions: those with the same golden flights together, the others one by one."""
        for group in self._groups():
            job = []
            for number, world in group:
                mission = self.sessions[number].incomplete_mission(world)
                if mission is not None:
                    job.append((number, mission))
            if job:
                yield tuple(job)

    def _groups(self) -> Iterable[Sequence[_SessionMission]]:
        """Missions that can be one job, in the order of their sessions; those with instrumented kernels are first.

        Their golden flight takes the checkpoints for the others, so at most one of them is in a group.
        """
        groups: list[list[_SessionMission]] = []
        groups_by_seed: dict[int, list[list[_SessionMission]]] = {}
        for number in sorted(range(len(self.sessions)), key=lambda number: not self._instruments(number)):
            for environment, seed in self.sessions[number].worlds():
                groups_of_seed = groups_by_seed.setdefault(seed, [])
                group = None
                if not self._instruments(number):  # instrumented kernels join no group
                    flights = self.sessions[number].flights(environment)
                    for other in groups_of_seed:
                        if all(share(flights, self.sessions[n].flights(there)) for n, (there, _) in other):
                            group = other
                            break
                if group is None:
                    group = []
                    groups.append(group)
                    groups_of_seed.append(group)
                group.append((number, (environment, seed)))
        return groups

    def _instruments(self, number: int) -> bool:
        return self.sessions[number].plan.campaign.sampler.instruments

    def _alone(self, number: int, mission: MissionPlan) -> MissionPlan:
        """The missing runs of a mission, each of which is flown in a process of its own."""
        return replace(mission, done=self.sessions[number].store.done(mission.world), alone=True)

    def _fly_once(self, executor: Executor, jobs: Iterable[Job]) -> Iterator[tuple[int, MissionPlan, Lost]]:
        """Fly jobs; yields number and mission of those that a worker has not completed before it was lost."""
        for session in self.sessions:
            session.log.forget()
        function = fly_missions if executor.forks else fly_missions_anywhere
        with closing(executor.map(function, jobs)) as batches:
            for job, items in batches:
                end = items[-1] if isinstance(items[-1], (Done, Lost)) else None
                numbered = [item for item in items if not isinstance(item, (Done, Lost))]
                for number, mission in job:
                    session = self.sessions[number]
                    new_items = [item for session_number, item in numbered if session_number == number]
                    if new_items or end is not None:
                        session.take(mission, new_items, end)
                    if isinstance(end, Lost) and not session.store.is_complete(mission.world):
                        yield number, mission, end

    def _check_process(self, executor: Executor, lost_missions: Sequence[tuple[int, MissionPlan, Lost]]) -> None:
        """Check that the missions crashed their workers, not this process, e.g. by compilation without memory.

        Raises:
            MachineError: No other mission was flown in this session, nor can be flown.
        """
        if any(session.flown for session in self.sessions):
            return
        crashed = {(number, mission.world) for number, mission, _ in lost_missions}
        missions = ((number, world) for number, session in enumerate(self.sessions) for world in session.worlds())
        for number, world in missions:
            if (number, world) not in crashed:  # the first one that has not crashed its worker
                job = ((number, self.sessions[number].mission(world)),)
                if not list(self._fly_once(executor, [job])):
                    return
                break
        raise MachineError(f"no mission can be flown here: {lost_missions[0][2].reason}")


# ---- flies campaigns mission by mission, alone or together; a stopped campaign resumes -----------------------------


def run_campaign(
    campaign: ResolvedCampaign,
    directory: Path,
    *,
    executor: Executor | None = None,
    fast_forward: bool = True,
    shard: Shard = WHOLE,
    extend: bool = False,
    progress: Callable[[Progress], None] | None = None,
) -> Status:
    """Fly the missing runs of a campaign; a stop at any time loses only the flights in progress.

    Args:
        campaign: The campaign, as resolved by `campaign.begin`.
        directory: Folder of its ledger, existing or new.
        executor: Runs the missions; None = two local processes.
        fast_forward: Whether runs may start at checkpoints of their golden run; the ledger is the same either way.
        shard: Subset of missions; the ledgers of all shards can be merged.
        extend: Whether the ledger may be that of a smaller campaign, whose runs are kept; see `campaign.extension`.
        progress: Called after every run, in this process.

    Raises:
        BadInputError: The directory cannot be written or holds another campaign, or versions differ from those with
            which the ledger was started.
    """
    return run_campaigns(
        {directory: campaign},
        executor=executor,
        fast_forward=fast_forward,
        shard=shard,
        extend=extend,
        progress=None if progress is None else lambda _, now: progress(now),
    )[directory]


def run_campaigns(
    campaigns: Mapping[Path, ResolvedCampaign],
    *,
    executor: Executor | None = None,
    fast_forward: bool = True,
    shard: Shard = WHOLE,
    extend: bool = False,
    progress: Callable[[Path, Progress], None] | None = None,
) -> dict[Path, Status]:
    """As `run_campaign`, for several campaigns by folder: those that fly the same missions share their golden flights.

    The ledgers are those of campaigns that are flown one after the other.
    """
    executor = executor or LocalExecutor(2)
    with ExitStack() as stack:
        sessions = []
        for directory, campaign in campaigns.items():
            session = _session(stack, campaign, directory, fast_forward, shard, extend, progress)
            stack.enter_context(session.logged(executor))
            sessions.append(session)
        for session in sessions:
            _prepare(session, executor)
        Flying(sessions).fly(executor)
        return {directory: status(directory) for directory in campaigns}


def _session(  # noqa: PLR0913 - what `run_campaigns` is given
    stack: ExitStack,
    campaign: ResolvedCampaign,
    directory: Path,
    fast_forward: bool,
    shard: Shard,
    extend: bool,
    progress: Callable[[Path, Progress], None] | None,
) -> Session:
    """The session of a campaign; its ledger is closed with `stack`."""
    # The ledger; one that exists must hold the same campaign, or a smaller one that is extended.
    identity: dict[str, Any] = json.loads(canonical(identity_of(campaign)))
    stored_identity = read_meta(directory, IDENTITY)
    extends = extend and stored_identity not in (None, identity)
    identity_to_open = identity
    if extends:
        identity_to_open = stored_identity
    try:
        store = stack.enter_context(Store.create(directory, identity_to_open))
    except BadInputError as error:
        if stored_identity in (None, identity_to_open) or not differ_in_size(stored_identity, identity):
            raise
        raise BadInputError(f"{error}, or keep its runs with --extend") from None
    # The folder of models, relative if it is inside the ledger's, so that both can be moved.
    models_dir = None
    if campaign.models_dir is not None:
        path = campaign.models_dir.absolute()
        if path.is_relative_to(directory.absolute()):
            path = path.relative_to(directory.absolute())
        models_dir = str(path)
    plan = Plan(campaign)
    check_versions(store, {**versions(), **campaign.sampler.versions}, adds_runs=extends)
    check_shard(store, shard)
    with store.writing():
        if extends:
            extend_ledger(store, plan, identity, shard)
        store.write_meta(
            {
                ORDERED: campaign.config.model_dump_json(),
                "models_dir": models_dir,
                "missions": shard.missions(campaign.config),
            }
        )
    return Session(
        plan,
        store,
        fast_forward,
        shard,
        progress,
        Log(directory),
        plan.count(shard),
        counts=store.counts(),
    )


def _prepare(session: Session, executor: Executor) -> None:
    """Check the host, and compile in this process what its forks will need, if missions are left."""
    campaign = session.plan.campaign
    missions = (session.incomplete_mission(world) for world in session.worlds())
    first = next((mission for mission in missions if mission is not None), None)
    if first is None:
        return
    campaign.host.check()
    if not campaign.host.in_process:
        return
    session.tell(compiling=True)
    if executor.forks and not is_compiled(campaign.config):
        warm_up(first)


def identity_of(campaign: ResolvedCampaign) -> dict[str, Any]:
    """Identity of a ledger's campaign, as plain data."""
    scenarios = {"/".join(name): scenario.to_json() for name, scenario in campaign.scenarios.items()}
    identity: dict[str, Any] = {
        "campaign": campaign.config.identity(),
        "scenarios": scenarios,
        "models": dict(campaign.models),
    }
    # Keys that came later, absent if empty, so that ledgers without them keep their identity.
    default_keys = {}
    options = {}
    for name, arm in campaign.config.arms.items():
        default_keys[name] = dict(mission_keys(arm.detector))
        options[name] = {**detector_options(arm.detector), **arm.options}
    for key, by_arm in (("mission_keys", default_keys), ("detector_options", options)):
        present = {name: values for name, values in by_arm.items() if values}
        if present:
            identity[key] = present
    return identity
