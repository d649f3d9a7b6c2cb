"""What a report says around its tables: what was flown, and whether the null runs were the golden ones."""

from collections.abc import Callable, Mapping
from typing import Any

from mavfi.campaign.analysis.measures import POPULATIONS
from mavfi.campaign.analysis.runs import Runs

Campaign = Mapping[str, Any]


def null_line(runs: Runs) -> str:
    """Whether flights with an empty mask were the golden ones."""
    null = runs.null
    differing = [row["run_id"] for row in null if row["effect"] != "masked"]
    if not len(null):
        return "Null runs: none flown."
    if not differing:
        return f"Null runs: all {len(null)} with an empty mask have the digest of their golden runs."
    return f"Null runs: {len(differing)} of {len(null)} DIFFER from their golden runs: {', '.join(differing)}"


def unknown_line(runs: Runs) -> str:
    """How many runs could not be judged, which is a defect; "" = none."""
    unknown = runs.where(judged=False)["run_id"]
    return f"Unknown: {len(unknown)} runs could not be judged: {', '.join(unknown[:5])}" if unknown else ""


def header(campaign: Campaign) -> list[str]:
    """What was flown, in lines.

    Args:
        campaign: As of `analysis.about.describe`.
    """
    versions = sorted(campaign["versions"].items(), key=lambda item: item[0] != "mavfi")
    lines = [
        *_what(campaign),
        f"{campaign['done']} of {campaign['total']} runs done · digest {campaign['digest'][:16]}…",
        " · ".join(f"{name} {version}" for name, version in versions),
    ]
    if campaign["on_design_seeds"]:
        lines.append("Flown on design seeds: no figure for publication.")
    if campaign["done"] < campaign["total"]:
        lines.append("Not complete: what follows is of the runs that are done.")
    return lines


def _what(campaign: Campaign) -> list[str]:
    if "node" in campaign:
        where = f"from the next call of {campaign['symbol']!r} on" if campaign["symbol"] else "from a random instant on"
        return [
            f"campaign {campaign['name']} · node {campaign['node']}",
            f"{campaign['command'][0]} · one bit per trial, {where}, after up to {campaign['walk']} instructions",
        ]
    speed = "" if campaign["v_max"] is None else f" · {campaign['v_max']:g} m/s"
    seeds = f"seeds {campaign['seeds'][0]} to {campaign['seeds'][1]}"
    lines = [
        f"campaign {campaign['name']} · autopilot profile {campaign['profile']} · {campaign['platform']} · "
        f"{campaign['planner']}{speed}",
        f"{campaign['missions']} missions per environment ({seeds}), {campaign['faults']} faults per "
        f"{campaign['each']}, {_DRAWN[campaign['level']](campaign)}",
    ]
    if campaign["arms"]:
        arms = ", ".join(_arm(name, arm) for name, arm in sorted(campaign["arms"].items()))
        lines.append(f"arms: {arms}; coupling {campaign['coupling']}; monitored set {campaign['monitored_set']}")
    return lines


def _arm(name: str, arm: Mapping[str, Any]) -> str:
    detector, profile = arm["detector"], arm["profile"]
    told = f"{name} ({profile})" if name == detector else f"{name} = {detector} ({profile})" if detector else name
    changed = ", ".join(f"{key} {value}" for key, value in arm.get("mission", {}).items())
    return f"{told} with {changed}" if changed else told


def _states(campaign: Campaign) -> str:
    shares = sorted(campaign["strata"].items(), reverse=True)
    strata = " : ".join(f"{POPULATIONS.get(name, name)} {share:g}" for name, share in shares)
    return f"drawn {strata}, fields: {campaign['sites']}"


def _instructions(campaign: Campaign) -> str:
    stratified = ", drawn by value class and source line" if campaign["scheme"] == "stratified" else ""
    return f"instructions: {campaign['which']}, model {campaign['model']}{stratified}"


_DRAWN: dict[str, Callable[[Campaign], str]] = {"state": _states, "instruction": _instructions}
"""How the faults of a level were drawn."""
