"""The paper's own figures (configs/figures/mavfi_paper.yaml), joined to rows by what these are of."""

from collections.abc import Iterator, Mapping
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


@cache
def figures() -> pl.DataFrame:
    """All figures: figure, source, environment, setting, stage, kernel, quantity ("" = of none), value, text."""
    rows = [
        {"figure": name, "source": figure["source"], **_EMPTY, **key,
         "value": None if isinstance(value, str) else value, "text": value if isinstance(value, str) else ""}
        for name, figure in _data()["figures"].items()
        for key, value in _leaves(figure["values"], figure["by"])
    ]  # fmt: skip
    return pl.DataFrame(rows, infer_schema_length=None)


_EMPTY = dict.fromkeys(("environment", "setting", "stage", "kernel", "quantity"), "")


def _leaves(values: Any, by: list[str]) -> Iterator[tuple[dict[str, str], Any]]:
    if not by:
        yield {}, values
        return
    for name, inner in values.items():
        for key, value in _leaves(inner, by[1:]):
            yield {by[0]: name, **key}, value


@cache
def _lookup() -> dict[tuple[str, frozenset[tuple[str, str]]], Any]:
    return {
        (row["figure"], frozenset((k, row[k]) for k in _EMPTY if row[k])): row["text"] or row["value"]
        for row in figures().iter_rows(named=True)
    }


def figure(name: str, **key: str) -> Any:
    """One figure, a share or text; None = the paper has none.

    Args:
        name: Of the figure.
        key: Environment, setting, stage, kernel or quantity, as the figure has it.
    """
    return _lookup().get((name, frozenset(key.items())))


def recovery(environment: str, setting: str) -> float | None:
    """(method - fi) / (golden - fi) of Table I; the paper quotes up to 89.6 % and 100 %."""
    golden, fi, method = (figure("success", environment=environment, setting=s) for s in ("golden", "fi", setting))
    return None if None in (golden, fi, method) or setting in ("golden", "fi") else (method - fi) / (golden - fi)


def worst_time(environment: str, setting: str) -> float | None:
    """Increase of the worst flight time; with a detector what is left of it."""
    worst = figure("worst_time", environment=environment)
    if worst is None or setting == "fi":
        return None if worst is None else float(worst)
    recovered = figure("worst_time_recovered", environment=environment, setting=setting)
    return None if recovered is None else float(worst - recovered)


def comparable(campaign: Mapping[str, Any], detector_profile: str) -> bool:
    """Whether an arm of a campaign may stand beside the paper: its autopilot profile, and no other detector's."""
    data = _data()
    return campaign.get("profile") == data["profile"] and detector_profile in ("", data["detector_profile"])


def beside(find: Any, heading: str = "paper", form: str = PERCENT, key: str = "paper") -> Measure:
    """The paper's figure for the environment and setting of the rows, where the two can be compared.

    Args:
        find: Environment, setting -> figure.
        heading: Of the column.
        form: Of the figure.
        key: Of the column.
    """

    def of(own: Runs) -> Any:
        if not len(own) or not comparable(own.campaign, own.first("detector_profile")):
            return None
        return find(own.first("environment"), own.first("setting"))

    return Measure(key, heading, form, of)


def success(environment: str, setting: str) -> float | None:
    """Table I."""
    found: float | None = figure("success", environment=environment, setting=setting)
    return found
