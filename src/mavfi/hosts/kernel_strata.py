"""Draws faults in instructions of a mission by value class and source line, so that rare lines are struck too.

A mission has few faults of a kernel and many strata, so not every stratum of a mission has one: each fault falls into a
stratum with a known probability, and carries share / probability as its weight.  Over all missions the weighted mean is
that of the uniform draw (Hansen and Hurwitz, Annals of Mathematical Statistics 14, 1943).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavfi.faults.instruction import Profiling, Site
from mavfi.faults.instruction.selection import Selection
from mavfi.faults.instruction.stratified import StratumKey, densities, key_of


@dataclass(frozen=True, slots=True)
class Pick:
    """A dynamic instruction of a mission.

    Attributes:
        function: Which of the kernel's functions.
        digest: Of its IR.
        site: The static instruction.
        number: Which execution of its block in the mission, from 0.
        weight: Share of its stratum / probability of the stratum.
    """

    function: str
    digest: str
    site: Site
    number: int
    weight: float


@dataclass(frozen=True, slots=True)
class _Member:
    function: str
    digest: str
    site: Site
    times: int


def pick(
    random: np.random.Generator, counted: Mapping[str, Profiling], selection: Selection, number: int
) -> list[Pick]:  # fmt: skip
    """Draw dynamic instructions of one kernel in one mission.

    Strata are drawn systematically, which keeps the faults of one mission apart; within a stratum dynamic instructions
    are uniform.

    Args:
        random: Stream.
        counted: The golden flight's counts, by function.
        selection: Class of instructions; shares are those within it.
        number: How many.

    Returns:
        None where the mission executes no such instruction.
    """
    strata = _members(counted, selection)
    sizes = {key: sum(member.times for member in own) for key, own in strata.items()}
    if not sizes:
        return []
    probability, whole = densities(sizes), sum(sizes.values())
    keys = sorted(sizes)
    ends = np.cumsum([probability[key] for key in keys])
    positions = random.permutation((np.arange(number) + random.random()) / number) * ends[-1]
    places = np.minimum(np.searchsorted(ends, positions, side="right"), len(keys) - 1)
    chosen = [keys[place] for place in places.tolist()]
    return [_within(random, strata[key], sizes[key] / whole / probability[key]) for key in chosen]


def _within(random: np.random.Generator, members: Sequence[_Member], weight: float) -> Pick:
    """A dynamic instruction of a stratum, uniform."""
    ends = np.cumsum([member.times for member in members])
    position = int(random.integers(int(ends[-1])))
    place = int(np.searchsorted(ends, position, side="right"))
    member = members[place]
    return Pick(
        member.function, member.digest, member.site, position - int(ends[place]) + member.times, weight
    )  # fmt: skip


def _members(counted: Mapping[str, Profiling], selection: Selection) -> dict[StratumKey, list[_Member]]:
    """Executed static instructions of a class, by stratum."""
    found: dict[StratumKey, list[_Member]] = {}
    for function, twin in counted.items():
        for digest, (table, times) in twin.blocks().items():
            for block, number in zip(table.blocks, times.tolist(), strict=True):
                for site in block if number else ():
                    if site in selection:
                        found.setdefault(key_of(site), []).append(_Member(function, digest, site, number))
    return found
