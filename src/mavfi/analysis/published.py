"""Values published in the paper (configs/figures/mavfi_paper.yaml), matched to table rows by their keys."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from mavfi.analysis.likeness import paper_data
from mavfi.analysis.measures import Measure, MeasureFactory
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import PERCENT

STATE_LEVEL = "state-level variant of the paper's Table I, which is at instruction level"
INSTRUCTION_LEVEL = "instruction level: the paper's Table I"


def figure(name: str, **key: str) -> Any:
    """Look up a published value (number or text) by environment, setting, stage etc.; None = not published."""
    published = paper_data()["figures"][name]
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


# ---- which runs the paper's values may stand beside ------------------------------------------------------------------
def same_missions(campaign: Mapping[str, Any]) -> bool:
    """Whether a campaign flew the paper's missions, with whatever faults."""
    return bool(campaign.get("profile")) and not _unlike(campaign, "mission")


def compared(campaign: Mapping[str, Any]) -> bool:
    """Whether a campaign is comparable with the paper's Table I: its missions, and how its faults are drawn."""
    return same_missions(campaign) and not _unlike(campaign, "faults")


def comparable(runs: Runs) -> bool:
    """Whether runs of one arm are comparable with those of the paper's Table I."""
    if not len(runs) or not compared(runs.campaign):
        return False
    if runs.first("detector_profile") not in ("", paper_data()["detector_profile"]):
        return False
    return not runs.campaign.get("unlike_the_paper", {}).get("arms", {}).get(runs.first("arm"))


def _unlike(campaign: Mapping[str, Any], part: str) -> list[str]:
    """What differs from the paper in a part of a campaign's description, see `likeness.differences`."""
    texts: list[str] = campaign.get("unlike_the_paper", {}).get(part, [])
    return texts


def level_note(runs: Runs, note: str) -> str:
    """A note on how the level of faults compares with the paper's; instead, why nothing is compared with it."""
    if compared(runs.campaign):
        return note
    reasons = [*_unlike(runs.campaign, "mission"), *_unlike(runs.campaign, "faults")]
    return f"not compared with the paper, which flew otherwise: {', '.join(reasons) or 'its own missions'}"


def titled(start: str, title: str) -> Callable[[Runs], str]:
    """A title that begins with what it is in the paper, "Fig. 3: ", if the paper's missions were flown."""

    def title_of(runs: Runs) -> str:
        if same_missions(runs.campaign):
            return f"{start}{title}"
        return f"{title[0].upper()}{title[1:]}"

    return title_of


def beside(measure: Measure) -> MeasureFactory:
    """A column with the paper's values: only in tables of campaigns that are comparable with it."""

    def columns(runs: Runs, by: tuple[str, ...]) -> Iterable[Measure]:
        del by
        if compared(runs.campaign):
            yield measure

    return columns


def column(find: Any, heading: str = "paper", form: str = PERCENT) -> MeasureFactory:
    """A column with the published value for an environment and setting, see `beside`."""

    def cell(runs: Runs) -> Any:
        if not comparable(runs):
            return None
        return find(runs.first("environment"), runs.first("setting"))

    return beside(Measure("paper", heading, form, cell))


def success(environment: str, setting: str) -> float | None:
    """Success rate from Table I."""
    rate: float | None = figure("success", environment=environment, setting=setting)
    return rate
