"""Ways to choose what to duplicate, at equal cost: the minimum cut, and simpler rules to compare it with.

Each way is judged as the steps of a curve are: by injections that its choice has not seen.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from mavfi.campaign.analysis.pairs import Paired, mcnemar
from mavfi.campaign.hardening.target import Judged, Target
from mavfi.hardening.choose import Choice, Chooser

CUT = "cut"
OTHERS = ("line", "opcode", "random")
WAYS = (CUT, *OTHERS)
SHARES = (0.1, 0.25, 0.5, 0.75)
"""Costs at which ways are compared: shares of the cost of duplicating everything."""
FEWEST = 20
"""Silent corruptions needed to compare ways: with 20, Wilson's interval of a share of one half is 30 to 70 %; with
fewer, most differences between ways are noise."""
_SEED = 7
_Choose = Callable[[Chooser, float], Choice]
"""A choice that adds at most a number of dynamic instructions."""


@dataclass(frozen=True, slots=True)
class Compared:
    """Ways to choose for one function at one cost.

    Attributes:
        share: Most that is added, as a share of the cost of full duplication.
        judged: The same silent corruptions for each of `WAYS`, and whether it removes them.
    """

    share: float
    judged: Mapping[str, Judged]

    @property
    def hits(self) -> dict[str, list[bool]]:
        """Whether each way removes each of the silent corruptions."""
        return {way: [hit for _, hit in own] for way, own in self.judged.items()}

    @property
    def tests(self) -> dict[str, Paired]:
        """McNemar's tests of the minimum cut (first) against each other way."""
        hits = self.hits
        return {way: mcnemar(hits[CUT], hits[way]) for way in OTHERS}


def compare_ways(target: Target) -> tuple[Compared, ...]:
    """Compare the ways to choose for a function at each of `SHARES`; () if it has few silent corruptions."""
    if sum(one.sdc for one in target.injections) < FEWEST:
        return ()
    ways = _ways_of(target)
    return tuple(
        Compared(share, {way: target.judged(partial(_at, choose, share)) for way, choose in ways.items()})
        for share in SHARES
    )


def _ways_of(target: Target) -> dict[str, _Choose]:
    """Each of `WAYS`; random values come in the same order at each cost."""
    lines, opcodes = [(row.file, row.line) for row in target.rows], [row.opcode for row in target.rows]
    return {
        CUT: Chooser.within,
        "line": lambda chooser, budget: chooser.by_group(lines, budget),
        "opcode": lambda chooser, budget: chooser.by_group(opcodes, budget),
        "random": lambda chooser, budget: chooser.at_random(np.random.default_rng(_SEED), budget),
    }


def _at(choose: _Choose, share: float, chooser: Chooser) -> Choice:
    """A choice that adds at most a share of the instructions of full duplication."""
    return choose(chooser, share * chooser.full.cost)
