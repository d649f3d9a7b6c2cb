"""What was flown, as plain data: what headers and notes of tables say."""

from functools import singledispatch
from typing import Any

from mavfi.campaign.analysis.statistics import CONFIDENCE
from mavfi.campaign.config import Campaign, InstructionSampling, RegisterSampling, StateSampling
from mavfi.campaign.run import status, stored_campaign
from mavfi.campaign.store import Store


def describe(store: Store) -> dict[str, Any]:
    """The campaign of a ledger, and how far it is.

    Args:
        store: The ledger.
    """
    campaign, progress = stored_campaign(store), status(store.directory)
    mission = campaign.spec(campaign.environments[0], campaign.first_seed)
    return {
        "name": campaign.name, "host": campaign.host, "profile": mission.autopilot, "platform": mission.platform,
        "planner": mission.planner, "v_max": mission.v_max, "coupling": mission.coupling,
        "environments": list(campaign.environments), "seeds": [campaign.seeds.start, campaign.seeds.stop - 1],
        "on_design_seeds": campaign.on_design_seeds, "missions": campaign.missions, "faults": campaign.faults,
        "monitored_set": campaign.monitored_set,
        "arms": {name: arm.model_dump(mode="json") for name, arm in campaign.arms.items()},
        "models": store.meta("identity")["models"], "confidence": CONFIDENCE, "versions": store.meta("versions") or {},
        "digest": store.digest(), "done": progress.done, "total": progress.total, **_sampling(campaign.sampling),
        **_node(campaign),
    }  # fmt: skip


@singledispatch
def _sampling(sampling: Any) -> dict[str, Any]:
    raise TypeError(f"no description of {type(sampling).__name__}")


@_sampling.register
def _(sampling: StateSampling) -> dict[str, Any]:
    each = {"stage_balanced": "stage", "groups": "group"}[sampling.scheme]
    return {"level": sampling.level, "each": each, "strata": dict(sampling.strata), "sites": sampling.sites}


@_sampling.register
def _(sampling: InstructionSampling) -> dict[str, Any]:
    return {
        "level": sampling.level, "each": sampling.share, "kernels": list(sampling.kernels), "which": sampling.which,
        "model": sampling.model, "scheme": sampling.scheme,
    }  # fmt: skip


@_sampling.register
def _(sampling: RegisterSampling) -> dict[str, Any]:
    return {"level": sampling.level, "each": "kind of registers", "symbol": sampling.symbol, "walk": sampling.walk}


def _node(campaign: Campaign) -> dict[str, Any]:
    """What a foreign node is, which has no autopilot profile."""
    if campaign.node is None:
        return {}
    return {"node": campaign.node.name, "command": list(campaign.node.command), "profile": "", "platform": ""}
