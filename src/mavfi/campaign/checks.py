"""Checks that models of a campaign share."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping

from mavfi.faults.strata import STRATA

NULL_RUNS = 3  # default number of null runs per environment, except for instruction faults


def check_known(key: str, names: Iterable[str], allowed: Collection[str]) -> None:
    """Raise a ValueError for a name that is not allowed."""
    for name in names:
        if name not in allowed:
            raise ValueError(f"{key}: {name!r}: not known; allowed: {', '.join(allowed)}")


def check_distinct(key: str, names: Iterable[str]) -> None:
    """Raise a ValueError for a name that occurs twice."""
    for name, count in Counter(names).items():
        if count > 1:
            raise ValueError(f"{key}: {name!r}: named {count} times; allowed: once")


def check_strata(strata: Mapping[str, float]) -> None:
    """Raise a ValueError for unknown strata, or shares that are not above 0."""
    check_known("sampling.strata", sorted(strata), STRATA)
    if not strata or not all(0 < share < float("inf") for share in strata.values()):
        raise ValueError(f"sampling.strata: {strata}: need at least one name, and shares above 0")
