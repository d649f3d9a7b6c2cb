"""Numbers as text for people: the same everywhere in a report."""

from collections.abc import Callable, Mapping
from typing import Any

from mavfi.campaign.analysis.statistics import EventRate, Rate
from mavfi.campaign.analysis.table import PER_HOUR, PERCENT, POINTS, RATE, SIGNED, SMALL, Cell, Column, Table

ABSENT = "—"


def percent(share: float | None, digits: int = 1) -> str:
    """A share as per cent."""
    return ABSENT if share is None else f"{100 * share:.{digits}f} %"


def signed_percent(share: float | None) -> str:
    """A relative change as per cent."""
    return ABSENT if share is None else f"{100 * share:+.1f} %"


def small_percent(share: float | None) -> str:
    """A small share as per cent, with as many digits as it needs."""
    return ABSENT if share is None else f"{100 * share:.3g} %"


def interval(low: float | None, high: float | None) -> str:
    """Bounds of a share, in per cent."""
    return "" if low is None or high is None else f"[{100 * low:.1f}, {100 * high:.1f}]"


def rate(found: Rate | float | None) -> str:
    """A rate in per cent with its interval and n: "93.3 [78.7, 98.2] 28/30"; a weighted rate has no count: "n=30"."""
    if found is None or isinstance(found, float):
        return percent(found)
    if found.rate is None:
        return ABSENT
    count = f"n={found.n}" if found.successes is None else f"{found.successes}/{found.n}"
    return f"{100 * found.rate:.1f} {interval(found.low, found.high)} {count}"


def number(value: float | None, digits: int = 1, unit: str = "") -> str:
    """A figure with a unit."""
    return ABSENT if value is None else f"{value:.{digits}f}{unit and ' ' + unit}"


def _share(value: Rate | float) -> str:
    return percent(value.rate if isinstance(value, Rate) else value)


def _with_interval(value: Rate) -> str:
    return f"{percent(value.rate)} {interval(value.low, value.high)}"


def _points(value: Rate) -> str:
    return f"{100 * (value.rate or 0.0):+.1f} {interval(value.low, value.high)}"


def _per_hour(value: EventRate) -> str:
    return ABSENT if value.per_hour is None else f"{value.per_hour:.1f} [{value.low:.1f}, {value.high:.1f}]"


def _small_percents(values: Mapping[str, float]) -> str:
    return " / ".join(map(small_percent, values.values()))


FORMS: dict[str, Callable[[Any], str]] = {
    RATE: rate, PERCENT: _share, "percent 2": lambda share: percent(share, 2), SIGNED: signed_percent,
    SMALL: small_percent, "small percents": _small_percents, "percent with interval": _with_interval,
    POINTS: _points, PER_HOUR: _per_hour, "number .1f kJ": lambda joule: number(joule / 1000, 1, "kJ"),
}  # fmt: skip
"""How a cell of a form is written; other forms are "number", digits as of Python's formats, unit."""


def cell(value: Cell, form: str) -> str:
    """One cell as text; words stand for themselves.

    Args:
        value: As a measure gave it.
        form: Of its column.
    """
    if value is None:
        return ABSENT
    if isinstance(value, str):
        return value
    if form in FORMS:
        return FORMS[form](value)
    kind, _, rest = form.partition(" ")
    digits, _, unit = rest.partition(" ")
    return f"{value:{digits}}{unit and ' ' + unit}" if kind == "number" and digits else str(value)


def shown(table: Table) -> tuple[list[Column], list[list[str]]]:
    """Columns and cells of a table for people."""
    places = [place for place, column in enumerate(table.columns) if not column.hidden]
    columns = [table.columns[place] for place in places]
    return columns, [[cell(row[place], table.columns[place].form) for place in places] for row in table.rows]
