"""Compilation of kernels, once per machine: on all processors, in the parent of workers, or in the first worker."""

import fcntl
import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from mavfi.campaign.compiling import STAGES, compile_stage
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.executor import Executor, map_each
from mavfi.campaign.mission import Job, MissionPlan, fly_mission, fly_missions, has_custom_detectors
from mavfi.campaign.plan import CompletedRun, Planned
from mavfi.campaign.resolve import Arm, ResolvedCampaign, resolve
from mavfi.detectors.registry import is_named
from mavfi.errors import BadInputError
from mavfi.mission import Scenario
from mavfi.numerics.dependencies import packages_digest
from mavfi.numerics.jit import code_folder, in_turns
from mavfi.states import DETECTORS, PLANNERS


def warm_up(mission: MissionPlan) -> None:
    """Fly golden runs and draw faults to compile the required code; results are discarded.

    With a custom detector, only those without a detector: it may not return, or end this process.
    """
    if has_custom_detectors(mission):
        campaign = mission.campaign
        mission = replace(mission, campaign=resolve(_bare(campaign.config), campaign.models_dir, campaign.models))
    for item in fly_mission(mission):
        if isinstance(item, Planned) and item.last:
            return


@dataclass(frozen=True, slots=True)
class _Stage:
    """A stage of a flight; its text, like that of other tasks, appears in the message about a lost worker."""

    name: str
    scenario: Scenario

    def compile(self) -> None:
        compile_stage(self.name, self.scenario)


@dataclass(frozen=True, slots=True)
class _Detector:
    """The detector of an arm with its shipped model, if there is one: the code of other models is the same."""

    campaign: ResolvedCampaign
    arm: Arm
    scenario: Scenario

    def compile(self) -> None:
        with suppress(BadInputError):
            self.campaign.detector(self.arm, self.scenario)


@dataclass(frozen=True, slots=True)
class _Mission:
    """A mission up to its draw of faults."""

    campaign: Campaign

    def compile(self) -> None:
        campaign = _with_shipped_models(self.campaign)
        if campaign is not None:
            warm_up(MissionPlan(campaign, self.campaign.environments[0], self.campaign.first_seed))


_CompileTask = _Stage | _Detector | _Mission


def compile_ahead(
    campaigns: Iterable[Campaign], executor: Executor, progress: Callable[[int, int], None] = lambda *_: None
) -> None:
    """Compile the code of several campaigns in an executor's processes; nothing if that was done before.

    First come the stages of a flight, then instrumented kernels and detectors, last what only a whole mission calls.
    Instrumented detectors have the shipped models: the code of other models is the same.

    Args:
        campaigns: The campaigns.
        executor: Runs the tasks.
        progress: Called after every task with the numbers of tasks done and in all.

    Raises:
        BadInputError: A campaign cannot be flown.
        MavfiError: A worker was lost.
    """
    # hosts with processes of their own compile nothing
    left = [resolve(campaign) for campaign in campaigns if not is_compiled(campaign)]
    left = [campaign for campaign in left if campaign.host.in_process]
    # each round uses the code of those before it
    rounds: list[list[_CompileTask]] = [
        list(_stages(left)),
        [*_kernels(left), *_detectors(left)],
        [_Mission(_bare(campaign.config)) for campaign in left],
    ]
    total = sum(map(len, rounds))
    done = 0
    for tasks in rounds:
        for _ in map_each(executor, _compile, tasks):
            done += 1
            progress(done, total)

    # A campaign whose models are not shipped compiles the rest of its code itself.
    incomplete = set()
    for tasks in rounds:
        for task in tasks:
            if isinstance(task, _Mission) and _with_shipped_models(task.campaign) is None:
                incomplete.add(task.campaign.name)
    for campaign in left:
        if campaign.config.name not in incomplete:
            _warm_file(campaign.config).touch()


def compile_flight(scenario: Scenario, executor: Executor) -> None:
    """Compile the stages of one flight in an executor's processes.

    Raises:
        BadInputError: The scenario cannot be flown.
        MavfiError: A worker was lost.
    """
    for _ in map_each(executor, _compile, [_Stage(stage, scenario) for stage in STAGES]):
        pass


def is_compiled(campaign: Campaign) -> bool:
    """Whether the cache has all of a campaign's code, by `compile_ahead` or on a machine that flew it."""
    return _warm_file(campaign).exists()


def _compile(task: _CompileTask) -> None:
    """Perform a task, in a worker."""
    with in_turns():
        task.compile()


def _with_shipped_models(campaign: Campaign) -> ResolvedCampaign | None:
    """The campaign with the shipped models of its detectors; None = one is not shipped: the campaign compiles it."""
    try:
        return resolve(campaign).with_models()
    except BadInputError:
        return None


def _scenarios(campaign: ResolvedCampaign) -> Iterator[tuple[Arm, Scenario]]:
    """Each arm, with its scenario in the first environment."""
    scenarios = campaign.with_scenarios(campaign.config.environments[:1]).scenarios.values()
    return zip(campaign.arms, scenarios, strict=True)


def _stages(campaigns: Sequence[ResolvedCampaign]) -> Iterator[_Stage]:
    """The stages of flights with different code."""
    tasks: dict[tuple[str, ...], _Stage] = {}
    for campaign in campaigns:
        for _, scenario in _scenarios(campaign):
            for stage in STAGES:
                planner = scenario.planner.name if stage == "plan_path" else ""
                key = stage, scenario.autopilot.name, scenario.map.kind, planner
                tasks.setdefault(key, _Stage(stage, scenario))
    yield from sorted(tasks.values(), key=lambda task: list(STAGES).index(task.name))


def _kernels(campaigns: Sequence[ResolvedCampaign]) -> list[_Mission]:
    """Campaigns with faults in instructions of one kernel or detector each, the longest compilations first."""
    order = [*DETECTORS, *PLANNERS]
    ranked = []
    for campaign in campaigns:
        for kernel in campaign.config.sampling.instrumented:
            rank = order.index(kernel) if kernel in order else len(order)
            ranked.append((rank, _Mission(_with_kernels(campaign.config, (kernel,)))))
    return [mission for _, mission in sorted(ranked, key=lambda entry: entry[0])]


def _detectors(campaigns: Sequence[ResolvedCampaign]) -> list[_Detector]:
    """Detectors of all arms, without duplicates."""
    tasks: dict[tuple[str, ...], _Detector] = {}
    for campaign in campaigns:
        for arm, scenario in _scenarios(campaign):
            if not arm.detector:
                continue
            trained_for = campaign.spec(campaign.config.environments[0], arm).trained_for
            key = arm.detector, arm.profile, scenario.autopilot.name, trained_for, str(arm.options)
            tasks[key] = _Detector(campaign, arm, scenario)
    return list(tasks.values())


def _bare(campaign: Campaign) -> Campaign:
    """The campaign without arms that have a detector, and without faults in detectors."""
    kernels = campaign.sampling.instrumented
    if kernels:
        custom = campaign.custom_detectors.values()
        in_detectors = {name for name in kernels if any(plug_in.is_called(name) for plug_in in custom)}
        return _with_kernels(campaign, tuple(name for name in kernels if name not in {*DETECTORS, *in_detectors}))
    if hasattr(campaign.sampling, "kernels"):  # whose memory: of all kernels, since the detectors are missing
        sampling = campaign.sampling.model_copy(update={"kernels": (), "groups": ()})
        campaign = campaign.model_copy(update={"sampling": sampling})
    return _with_arms(campaign, ())


def _with_kernels(campaign: Campaign, kernels: tuple[str, ...]) -> Campaign:
    """The campaign with faults in other kernels, and only those of its detectors that are among them."""
    sampling = campaign.sampling.model_copy(update={"kernels": kernels})
    return _with_arms(campaign.model_copy(update={"sampling": sampling}), kernels)


def _with_arms(campaign: Campaign, detectors: tuple[str, ...]) -> Campaign:
    """The campaign with only those arms that have no detector or one of these."""
    custom = campaign.custom_detectors
    arms = {}
    for name, arm in campaign.arms.items():
        is_one = any(is_named(arm.detector, detector) for detector in detectors)
        if name in custom:
            is_one = any(custom[name].is_called(detector) for detector in detectors)
        if is_one or not arm.detector:
            arms[name] = arm
    return campaign.model_copy(update={"arms": arms})


def fly_missions_anywhere(job: Job) -> Iterator[tuple[int, Planned | CompletedRun]]:
    """`fly_missions` in a process that is not a fork of the campaigns'."""
    for _, mission in job:
        if mission.campaign.host.in_process:
            _warm_up_machine(mission)
    yield from fly_missions(job)


def _warm_up_machine(mission: MissionPlan) -> None:
    """Compile in one process of this machine, while the others wait."""
    warm_file = _warm_file(mission.campaign.config)
    if warm_file.exists():
        return
    with (code_folder() / "warm-up.lock").open("w", encoding="utf-8") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not warm_file.exists():
            warm_up(mission)
            warm_file.touch()


def _warm_file(campaign: Campaign) -> Path:
    """File that exists if the code of a campaign is in the cache."""
    folder = code_folder()
    folder.mkdir(parents=True, exist_ok=True)
    campaign_digest = hashlib.sha256(campaign.model_dump_json().encode()).hexdigest()[:16]
    return folder / f"{campaign_digest}-{packages_digest()}.warm"
