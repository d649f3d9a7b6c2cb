"""Description of a campaign as plain data, for the headers and notes of tables."""

from typing import Any

from mavfi.analysis.statistics import CONFIDENCE
from mavfi.campaign.config import ArmConfig, Campaign, label_of
from mavfi.campaign.ledger import status, stored_campaign
from mavfi.campaign.store import Store
from mavfi.faults.fault import find_level
from mavfi.mission import MissionSpec
from mavfi.plugins import extensions

_NAMED = (
    "vehicle", "map", "flight_controller", "grain", "same_twice", "answer_s", "degraded", "dead_node",
    "alarm", "epoch_liveness", "protection",
)  # fmt: skip
"""Keys of a mission that are listed when they differ from their defaults."""


def describe(store: Store) -> dict[str, Any]:
    """Describe the campaign of a ledger, and its progress.

    Returns:
        `title` and `lines` are text; views need `profile` (of the autopilot), `monitored_set`, `each` (unit to which
        the number of faults applies), `kernels` and `which`, `parts`, and what extras add, e.g. measured `overheads`.
    """
    campaign, progress = stored_campaign(store), status(store.directory)
    return {
        "name": campaign.name, "environments": [label_of(name) for name in campaign.environments],
        "seeds": [campaign.seeds.start, campaign.seeds.stop - 1], "on_design_seeds": campaign.on_design_seeds,
        "missions": campaign.missions, "faults": campaign.faults, "monitored_set": campaign.monitored_set,
        "parts": {name: part.model_dump(exclude_none=True) for name, part in campaign.parts.items()},
        "arms": {name: arm.model_dump(mode="json") for name, arm in campaign.arms.items()},
        "models": store.meta("identity")["models"], "confidence": CONFIDENCE, "versions": store.meta("versions") or {},
        **{name: read(store.directory) for name, read in extensions("mavfi.descriptions").items()},
        "digest": store.digest(), "done": progress.done,
        "total": progress.total, **drawn(campaign),
    }  # fmt: skip


def drawn(campaign: Campaign) -> dict[str, Any]:
    """Describe the sampling of a campaign's faults and the flights or processes that they are injected into."""
    about: dict[str, Any] = find_level(campaign.sampling.level).about(campaign)
    if "title" in about:
        return about
    how = about.pop("how")
    return about | _flights(campaign, about["each"], how)


def _flights(campaign: Campaign, each: str, how: str) -> dict[str, Any]:
    mission = campaign.spec(campaign.environments[0], campaign.first_seed)
    speed = "" if mission.v_max is None else f" · {mission.v_max:g} m/s"
    every = [campaign.spec(name, campaign.first_seed) for name in campaign.environments]
    seeds = f"seeds {campaign.seeds.start} to {campaign.seeds.stop - 1}"
    missions = f"{campaign.missions} mission{'s' * (campaign.missions != 1)} per environment ({seeds})"
    lines = [f"{missions}, {campaign.faults} fault{'s' * (campaign.faults != 1)} per {each}, {how}"]
    if campaign.arms:
        arms = ", ".join(_arm(name, arm) for name, arm in sorted(campaign.arms.items()))
        lines.append(f"arms: {arms}; coupling {mission.coupling}; monitored set {campaign.monitored_set}")
    if campaign.parts:
        parts = (f"{name} = {part.environment}" for name, part in campaign.parts.items())
        lines.append(f"parts: {', '.join(parts)}")
    own = [
        f"{key} {value}" for key in _NAMED if (value := getattr(mission, key)) != MissionSpec.model_fields[key].default
    ]
    lines += [f"mission: {', '.join(own)}"] * bool(own)
    title = (
        f"campaign {campaign.name} · autopilot profile {mission.autopilot} · "
        f"{', '.join(dict.fromkeys(spec.platform for spec in every))} · "
        f"{mission.planner}{speed}"
    )
    return {"profile": mission.autopilot, "title": title, "lines": lines}


def _arm(name: str, arm: ArmConfig) -> str:
    own = f"{name} ({arm.profile})" if name == arm.detector else f"{name} = {arm.detector} ({arm.profile})"
    changed = ", ".join(f"{key} {value}" for key, value in arm.mission.items())
    return " with ".join(part for part in (own if arm.detector else name, changed) if part)
