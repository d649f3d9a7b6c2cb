"""The paper's own figures (configs/figures/mavfi_paper.yaml), joined to rows by what these are of."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import polars as pl

from mavfi.campaign.analysis.measures import Measure
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.table import PERCENT
from mavfi.config import config_root, read_yaml

STATE_LEVEL = "state-level variant of the paper's Table I, which is at instruction level"
INSTRUCTION_LEVEL = "instruction level: the paper's Table I"


@cache
def _data() -> dict[str, Any]:
    return read_yaml(config_root() / "figures" / "mavfi_paper.yaml")


def figure(name: str, **key: str) -> Any:
    """One figure, a share or text, by environment, setting, stage, kernel or quantity; None = the paper has none."""
    found = _data()["figures"][name]
    value = found["values"]
    for column in found["by"]:
        value = None if value is None else value.get(key[column])
    return value


def recovery(environment: str, setting: str) -> float | None:
    """(method - fi) / (golden - fi) of Table I; the paper quotes up to 89.6 % and 100 %."""
    golden, fi, method = (figure("success", environment=environment, setting=s) for s in ("golden", "fi", setting))
    return None if None in (golden, fi, method) or setting in ("golden", "fi") else (method - fi) / (golden - fi)


def worst_time(environment: str, setting: str) -> float | None:
    """Increase of the worst flight time; with a detector, the increase that remains."""
    worst = figure("worst_time", environment=environment)
    if worst is None or setting == "fi":
        return None if worst is None else float(worst)
    recovered = figure("worst_time_recovered", environment=environment, setting=setting)
    return None if recovered is None else float(worst - recovered)


def comparable(campaign: Mapping[str, Any], detector_profile: str) -> bool:
    """Whether an arm of a campaign may stand beside the paper: its autopilot profile, and no other detector's."""
    data = _data()
    return campaign.get("profile") == data["profile"] and detector_profile in ("", data["detector_profile"])


def beside(find: Any, heading: str = "paper", form: str = PERCENT) -> Measure:
    """A column with the figure of an environment and setting, where rows and paper can be compared."""

    def of(own: Runs) -> Any:
        if not len(own) or not comparable(own.campaign, own.first("detector_profile")):
            return None
        return find(own.first("environment"), own.first("setting"))

    return Measure("paper", heading, form, of, counted=lambda own: own.where(pl.lit(value=False)))  # of no run of ours


def success(environment: str, setting: str) -> float | None:
    """Table I."""
    found: float | None = figure("success", environment=environment, setting=setting)
    return found
