"""Numbers as text for people: the same everywhere in a report."""

from collections.abc import Mapping
from typing import Any

ABSENT = "—"
POPULATIONS = {
    "all": "all", "sign_exponent": "sign + exponent", "mantissa": "mantissa", "whole_word": "whole word",
    "sign": "sign", "exponent": "exponent", "all_bits": "all bits",
}  # fmt: skip


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


def rate(entry: Mapping[str, Any] | None) -> str:
    """A rate in per cent with its interval and n: "93.3 [78.7, 98.2] 28/30"; a weighted rate has no count: "n=30"."""
    if entry is None or entry["rate"] is None:
        return ABSENT
    count = f"n={entry['n']}" if entry.get("successes") is None else f"{entry['successes']}/{entry['n']}"
    return f"{100 * entry['rate']:.1f} {interval(entry['low'], entry['high'])} {count}"


def number(value: float | None, digits: int = 1, unit: str = "") -> str:
    """A figure with a unit."""
    return ABSENT if value is None else f"{value:.{digits}f}{unit and ' ' + unit}"


def population(name: str) -> str:
    """A bit stratum for people."""
    return POPULATIONS.get(name, name)
