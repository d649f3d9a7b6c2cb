"""What a report says around its tables: what was flown, and whether the null runs were the golden ones."""

from collections.abc import Mapping
from typing import Any

from mavfi.campaign.analysis.runs import Runs


def header(campaign: Mapping[str, Any]) -> list[str]:
    """What was flown, in lines.

    Args:
        campaign: As of `analysis.about.describe`.
    """
    lines = [
        campaign["title"], *campaign["lines"],
        f"{campaign['done']} of {campaign['total']} runs done · digest {campaign['digest'][:16]}…",
        " · ".join(versions(campaign)),
    ]  # fmt: skip
    if campaign["on_design_seeds"]:
        lines.append("Flown on design seeds: no figure for publication.")
    if campaign["done"] < campaign["total"]:
        lines.append("Not complete: what follows is of the runs that are done.")
    return lines


def versions(campaign: Mapping[str, Any]) -> list[str]:
    """Versions that decide the bits of a flight, ours first."""
    ordered = sorted(campaign["versions"].items(), key=lambda item: item[0] != "mavfi")
    return [f"{name} {version}" for name, version in ordered]


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
