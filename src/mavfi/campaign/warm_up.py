"""Compilation of kernels, once per machine: in the parent process of forked workers, or in the first worker."""

import fcntl
import hashlib
from collections.abc import Iterator

from mavfi.campaign.mission import MissionPlan, fly_mission, host_of
from mavfi.campaign.plan import Flown, Planned
from mavfi.numerics.jit import code_folder


def warm_up(mission: MissionPlan) -> None:
    """Fly golden runs and draw faults to compile the required code; results are discarded."""
    for item in fly_mission(mission):
        if isinstance(item, Planned) and item.last:
            return


def fly_mission_anywhere(mission: MissionPlan) -> Iterator[Planned | Flown]:
    """`fly_mission` in a process that is not a fork of the campaign's."""
    if host_of(mission.campaign).in_process:
        _warm_up_machine(mission)
    yield from fly_mission(mission)


def _warm_up_machine(mission: MissionPlan) -> None:
    """Compile in one process of this machine, while the others wait."""
    folder = code_folder()
    folder.mkdir(parents=True, exist_ok=True)
    key = hashlib.sha256(mission.campaign.model_dump_json().encode()).hexdigest()[:16]
    done = folder / f"{key}.warm"
    if done.exists():
        return
    with (folder / "warm-up.lock").open("w", encoding="utf-8") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            warm_up(mission)
            done.touch()
