"""Compilation of kernels, once per machine: in the parent process of forked workers, or in the first worker."""

import fcntl
import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from mavfi.campaign.config import Campaign, InstructionSampling
from mavfi.campaign.executors.executor import Executor, map_each
from mavfi.campaign.mission import MissionPlan, fly_mission, host_of
from mavfi.campaign.plan import Flown, Planned
from mavfi.numerics.jit import code_folder
from mavfi.states import DETECTORS


def warm_up(mission: MissionPlan) -> None:
    """Fly golden runs and draw faults to compile the required code; results are discarded."""
    for item in fly_mission(mission):
        if isinstance(item, Planned) and item.last:
            return


def compile_ahead(campaigns: Iterable[Campaign], executor: Executor) -> None:
    """Compile the code of several campaigns, one campaign per worker at a time; nothing if that was done before.

    Detectors are left out: their models may not exist yet.  Each process then finds the code in the cache.

    Raises:
        BadInputError: A campaign cannot be flown.
        MavfiError: A worker was lost.
    """
    bare = [_without_detectors(campaign) for campaign in campaigns if host_of(campaign).in_process]
    bare.sort(key=lambda campaign: not isinstance(campaign.sampling, InstructionSampling))  # these take longest
    missions = [
        MissionPlan(campaign, campaign.environments[0], campaign.first_seed)
        for campaign in bare
        if not _done(campaign).exists()
    ]
    for mission, _ in map_each(executor, warm_up, missions):
        _done(mission.campaign).touch()


def fly_mission_anywhere(mission: MissionPlan) -> Iterator[Planned | Flown]:
    """`fly_mission` in a process that is not a fork of the campaign's."""
    if host_of(mission.campaign).in_process:
        _warm_up_machine(mission)
    yield from fly_mission(mission)


def _warm_up_machine(mission: MissionPlan) -> None:
    """Compile in one process of this machine, while the others wait."""
    done = _done(mission.campaign)
    if done.exists():
        return
    with (code_folder() / "warm-up.lock").open("w", encoding="utf-8") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            warm_up(mission)
            done.touch()


def _without_detectors(campaign: Campaign) -> Campaign:
    """The campaign without arms that have a detector, and without faults in detectors."""
    arms = {name: arm for name, arm in campaign.arms.items() if not arm.detector}
    sampling = campaign.sampling
    if isinstance(sampling, InstructionSampling):
        kernels = tuple(kernel for kernel in sampling.kernels if kernel not in DETECTORS)
        sampling = sampling.model_copy(update={"kernels": kernels})
    return campaign.model_copy(update={"arms": arms, "sampling": sampling})


def _done(campaign: Campaign) -> Path:
    """File that exists if the code of a campaign is in the cache."""
    folder = code_folder()
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{hashlib.sha256(campaign.model_dump_json().encode()).hexdigest()[:16]}.warm"
