"""Flies campaigns mission by mission, alone or together; a stopped campaign resumes."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.executor import Executor
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.fingerprint import versions
from mavfi.campaign.ledger import ORDERED, Progress, Status, check_shard, check_versions, status
from mavfi.campaign.log import Log
from mavfi.campaign.mission import host_of, model_hashes, plan_of, scenarios_of
from mavfi.campaign.plan import arms_of
from mavfi.campaign.session import Flying, Session
from mavfi.campaign.shard import WHOLE, Shard
from mavfi.campaign.store import Store, held
from mavfi.campaign.warm_up import is_compiled, warm_up
from mavfi.config import STORED
from mavfi.detectors.registry import detector_options, mission_keys
from mavfi.flight.host import require_level
from mavfi.mission import Scenario


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
    return run_campaigns(
        {directory: campaign}, executor=executor, models_dir=models_dir, fast_forward=fast_forward, shard=shard,
        progress=None if progress is None else lambda _, now: progress(now),
    )[directory]  # fmt: skip


def run_campaigns(
    campaigns: Mapping[Path, Campaign], *, executor: Executor | None = None, models_dir: Path | None = None,
    fast_forward: bool = True, shard: Shard = WHOLE, progress: Callable[[Path, Progress], None] | None = None,
) -> dict[Path, Status]:  # fmt: skip
    """As `run_campaign`, for several campaigns by folder: those that fly the same missions share their golden flights.

    The ledgers are those of campaigns that are flown one after the other.
    """
    executor = executor or LocalExecutor(2)
    with ExitStack() as stack:
        sessions = []
        for directory, campaign in campaigns.items():
            tell = partial(progress, directory) if progress is not None else _ignore
            session = _session(stack, campaign, directory, models_dir, fast_forward, shard, tell)
            stack.enter_context(session.logged(executor))
            sessions.append(session)
        for session in sessions:
            _prepare(session, executor)
        Flying(sessions).fly(executor)
        return {directory: status(directory) for directory in campaigns}


def _ignore(_: Progress) -> None:
    """The progress of a campaign that nobody asked for."""


def _session(  # noqa: PLR0913 - what `run_campaigns` is given
    stack: ExitStack, campaign: Campaign, directory: Path, models_dir: Path | None, fast_forward: bool, shard: Shard,
    tell: Callable[[Progress], None],
) -> Session:  # fmt: skip
    """The session of a campaign; its ledger is closed with `stack`."""
    campaign, models_dir = _as_begun(campaign, directory), models_dir or _models_dir(directory)
    require_level(host_of(campaign), campaign.sampling.level)
    scenarios = scenarios_of(campaign, arms_of(campaign))
    models = model_hashes(campaign, scenarios, models_dir)
    plan = plan_of(campaign, models, scenarios)
    store = stack.enter_context(Store.create(directory, identity_of(campaign, scenarios, models)))
    check_versions(store, {**versions(), **plan.sampler.versions})
    check_shard(store, shard)
    store.write_meta({
        ORDERED: campaign.model_dump_json(),
        "models_dir": None if models_dir is None else _as_held(models_dir, directory),
        "missions": shard.missions(campaign),
    })  # fmt: skip
    return Session(
        plan, store, models_dir, fast_forward, shard, tell, Log(directory), plan.count(shard),
        counts=store.counts(),
    )  # fmt: skip


def _prepare(session: Session, executor: Executor) -> None:
    """Check the host, and compile in this process what its forks will need, if missions are left."""
    campaign = session.plan.campaign
    host, first = host_of(campaign), next(filter(None, map(session.left, session.worlds())), None)
    if first is None:
        return
    host.check()
    if host.in_process:
        session.tell(compiling=True)
    if host.in_process and executor.forks and not is_compiled(campaign):
        warm_up(first)


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
    options = {name: {**detector_options(arm.detector), **arm.options} for name, arm in arms}
    return {
        "campaign": campaign.identity(),
        "scenarios": {"/".join(place): scenario.to_json() for place, scenario in scenarios.items()},
        "models": dict(models),
        **({"mission_keys": keys} if keys else {}),
        **({"detector_options": used} if (used := {name: own for name, own in options.items() if own}) else {}),
    }
