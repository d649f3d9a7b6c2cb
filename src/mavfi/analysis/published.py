"""Values published in the paper (configs/figures/mavfi_paper.yaml), matched to table rows by their keys."""

from collections.abc import Mapping
from functools import cache
from typing import Any

from mavfi.analysis.measures import Measure
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import PERCENT
from mavfi.config import config_root, read_yaml

STATE_LEVEL = "state-level variant of the paper's Table I, which is at instruction level"
INSTRUCTION_LEVEL = "instruction level: the paper's Table I"


@cache
def _data() -> dict[str, Any]:
    return read_yaml(config_root() / "figures" / "mavfi_paper.yaml")


def figure(name: str, **key: str) -> Any:
    """Look up a published value (number or text) by environment, setting, stage etc.; None = not published."""
    published = _data()["figures"][name]
    value = published["values"]
    for column in published["by"]:
        if value is None:
            return None
        value = value.get(key[column])
    return value


def recovery(environment: str, setting: str) -> float | None:
    """Recovery rate (method - fi) / (golden - fi) from Table I; the paper quotes up to 89.6 % and 100 %."""
    if setting in ("golden", "fi"):
        return None
    golden, fi, method = (figure("success", environment=environment, setting=s) for s in ("golden", "fi", setting))
    if None in (golden, fi, method):
        return None
    return float((method - fi) / (golden - fi))


def worst_time(environment: str, setting: str) -> float | None:
    """Relative increase of the worst flight time; for a detector, the remaining increase."""
    worst = figure("worst_time", environment=environment)
    if worst is None:
        return None
    if setting == "fi":
        return float(worst)
    recovered = figure("worst_time_recovered", environment=environment, setting=setting)
    if recovered is None:
        return None
    return float(worst - recovered)


def comparable(campaign: Mapping[str, Any], detector_profile: str, arm: str = "") -> bool:
    """Whether an arm is comparable with the paper: its autopilot profile and, if any, its detector profile match.

    Flights with a custom planner, map, flight controller or detector are not.
    """
    data = _data()
    if {"", arm}.intersection(campaign.get("arms_with_plug_ins", ())):
        return False
    return campaign.get("profile") == data["profile"] and detector_profile in ("", data["detector_profile"])


def column(find: Any, heading: str = "paper", form: str = PERCENT) -> Measure:
    """A column with the published value for an environment and setting, in rows comparable with the paper."""

    def cell(runs: Runs) -> Any:
        if not len(runs) or not comparable(runs.campaign, runs.first("detector_profile"), runs.first("arm")):
            return None
        return find(runs.first("environment"), runs.first("setting"))

    return Measure("paper", heading, form, cell)


def success(environment: str, setting: str) -> float | None:
    """Success rate from Table I."""
    rate: float | None = figure("success", environment=environment, setting=setting)
    return rate
