"""Checks that models of a campaign share."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from pathlib import Path

from mavfi.config import names
from mavfi.dropped import dropped_name
from mavfi.faults.strata import STRATA
from mavfi.sim.environments import SCAN_ENDINGS

_ENVIRONMENT_FILES = (".yaml", ".yml", *SCAN_ENDINGS)
NULL_RUNS = 3  # default number of null runs per environment, except for instruction faults


def check_known(key: str, given: Iterable[str], allowed: Collection[str]) -> None:
    """Raise a ValueError for a name that is not allowed."""
    for name in given:
        if key.endswith("kernels") and dropped_name("kernels", name):
            raise ValueError(f"{key}: {dropped_name('kernels', name)}")
        if name not in allowed:
            raise ValueError(f"{key}: {name!r}: not known; allowed: {', '.join(allowed)}")


def check_distinct(key: str, given: Iterable[str]) -> None:
    """Raise a ValueError for a name that occurs twice."""
    for name, count in Counter(given).items():
        if count > 1:
            raise ValueError(f"{key}: {name!r}: named {count} times; allowed: once")


def check_strata(strata: Mapping[str, float]) -> None:
    """Raise a ValueError for unknown strata, or shares that are not above 0."""
    check_known("sampling.strata", sorted(strata), STRATA)
    if not strata or not all(0 < share < float("inf") for share in strata.values()):
        raise ValueError(f"sampling.strata: {strata}: need at least one name, and shares above 0")


@cache
def label_of(environment: str) -> str:
    """An environment's name in run ids and tables: of a file, its name without folder and ending.

    A file named like a shipped environment keeps its path: the paper's figures are not those of its world.
    """
    path = Path(environment)
    own = path.suffix.lower() in _ENVIRONMENT_FILES and path.stem not in names("environments")
    return path.stem if own else environment
