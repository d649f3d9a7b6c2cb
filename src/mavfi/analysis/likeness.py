"""What a campaign does otherwise than the paper: its figures are only shown beside what it flew, too.

`configs/figures/mavfi_paper.yaml` says what the paper flew.  `analysis.published` applies this to tables and figures.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any

from mavfi.campaign.config import ArmConfig, Campaign
from mavfi.config import config_root, read_yaml
from mavfi.mission import MissionSpec
from mavfi.states import PPC_STAGES

_LEVELS = ("state", "instruction")
"""Levels of faults that are compared with the paper's instructions; states are called its variant."""
_OPEN_KEYS = ("scheme", "sites", "strata", "kernels", "share", "restart_s")
"""Keys of the sampling on which the paper's text leaves a choice; others change what one fault is."""
_OPEN_OPTIONS = ("policy",)
"""Options of detectors on which the paper's text leaves a choice."""


@cache
def paper_data() -> dict[str, Any]:
    """What the paper flew, and its figures."""
    return read_yaml(config_root() / "figures" / "mavfi_paper.yaml")


def differences(campaign: Campaign, about: Mapping[str, Any]) -> dict[str, Any]:
    """What a campaign does otherwise than the paper, in words; all empty = comparable with its Table I.

    Args:
        campaign: The campaign, with missions of mavfi.
        about: What its level says of its faults, see `Level.about`.

    Returns:
        Plain data: `mission`, e.g. "planner rrt_star"; `faults`, in how they are drawn, e.g. "no faults in planning";
        `arms`, by name, what differs in detector or mission, without arms that are the paper's.
    """
    arms = {name: _of_arm(name, arm) for name, arm in campaign.arms.items()}
    return {
        "mission": _of_mission(campaign),
        "faults": _of_faults(campaign, about),
        "arms": {name: texts for name, texts in arms.items() if texts},
    }


def _of_mission(campaign: Campaign) -> list[str]:
    """Keys of the missions that the paper's do not have, and worlds that only have the name of one of its worlds."""
    texts = []
    papers_environments = paper_data()["figures"]["success"]["values"]
    for name, part in campaign.parts.items():
        is_other = part.environment != name or part.platform is not None
        if name in papers_environments and is_other:
            texts.append(f"{name} = {part.environment} on {part.platform or 'the same computer'}")
    ignored: tuple[str, ...] = ("environment", "seed")
    if campaign.parts:  # platforms that are compared with each other, as in the paper's Fig. 9
        ignored = ("environment", "seed", "platform")
    papers_mission = MissionSpec(**paper_data()["mission"])
    spec = campaign.first_mission
    for key in MissionSpec.model_fields:
        value = getattr(spec, key)
        if key not in ignored and value != getattr(papers_mission, key):
            texts.append(f"{key} {value}")
    return texts


def _of_faults(campaign: Campaign, about: Mapping[str, Any]) -> list[str]:
    """Keys of the sampling that change what one fault is, and stages without faults."""
    level = campaign.sampling.level
    if level not in _LEVELS:
        return [f"faults at level {level}"]
    changed = campaign.sampling.model_dump(mode="json", exclude_defaults=True)
    texts = [f"{key} {_in_words(value)}" for key, value in changed.items() if key not in ("level", *_OPEN_KEYS)]
    if about.get("each") != "stage":
        texts.append(f"{campaign.faults} faults per {about.get('each')}, not per stage")
        return texts
    texts += [f"no faults in {stage}" for stage in PPC_STAGES if stage not in about.get("stages", ())]
    return texts


def _in_words(value: object) -> object:
    """A value of a key; of members with names, the names; of a key with keys of its own, these with their values."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {entry}" for key, entry in value.items())
    if isinstance(value, list | tuple) and all(isinstance(member, Mapping) and "name" in member for member in value):
        return ", ".join(str(member["name"]) for member in value)
    return value


def _of_arm(name: str, arm: ArmConfig) -> list[str]:
    """Detector, profile, options and mission of an arm that has the name of one of the paper's detectors."""
    texts = [f"{key} {value}" for key, value in arm.mission.items()]
    texts += [f"option {key} {value}" for key, value in arm.options.items() if key not in _OPEN_OPTIONS]
    if arm.detector != name:
        texts.append(f"detector {arm.detector or 'none'}")
    if arm.profile != paper_data()["detector_profile"]:
        texts.append(f"profile {arm.profile}")
    return texts
