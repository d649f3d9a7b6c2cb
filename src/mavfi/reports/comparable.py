"""What may stand beside the paper's figures: its own stack, without a detector or with one in the profile `paper`."""

from typing import Any

_BESIDE = {
    "success": "paper",
    "success_by_policy": "paper",
    "recovery": "paper",
    "flight_times": "paper_worst",
    "overheads": "paper",
}
"""Tables of an analysis, and where their entries hold the paper's figure."""
PAPERS_STACK, PAPERS_PROFILE = "published", "paper"


def only_comparable(analysis: dict[str, Any]) -> dict[str, Any]:
    """The analysis without the paper's figures where they cannot be compared.

    Args:
        analysis: As of `mavfi.campaign.analysis.analyse`.
    """
    return {
        **analysis,
        **{table: [_entry(analysis, e, key) for e in analysis[table]] for table, key in _BESIDE.items()},
    }


def _entry(analysis: dict[str, Any], entry: dict[str, Any], key: str) -> dict[str, Any]:
    return entry if is_comparable(analysis["campaign"], entry["setting"]) else {**entry, key: None}


def is_comparable(campaign: dict[str, Any], setting: str) -> bool:
    """Whether a setting of a campaign is one of the paper's."""
    arm = campaign["detectors"].get(setting.partition("_")[2])
    return campaign["stack"] == PAPERS_STACK and (arm is None or arm["profile"] == PAPERS_PROFILE)
