"""Rates of sites from few injections: shrunk to those of the source line and class, and these to those of the opcode.

A ledger has about one injection per site.  The rate of a group with k successes of n injections is (k + 4 p) / (n + 4),
where p is the rate of the next larger group: four imaginary injections.
"""

from collections import Counter
from collections.abc import Hashable, Iterable, Sequence

STRENGTH = 4.0
"""Number of imaginary injections."""
Groups = tuple[Hashable, ...]
"""Groups of a site, from the largest (e.g. opcode and type) to the smallest (the site itself)."""


class Rates:
    """Rates by group.

    Args:
        injections: Groups of each injected site, and whether the injection succeeded.
    """

    def __init__(self, injections: Iterable[tuple[Groups, bool]]) -> None:
        self._n: Counter[Hashable] = Counter()
        self._k: Counter[Hashable] = Counter()
        for groups, success in injections:
            for group in (None, *groups):
                self._n[group] += 1
                self._k[group] += success

    def of(self, groups: Sequence[Hashable]) -> float:
        """Rate of a site, whether injected or not; 0 without any injection."""
        rate = self._k[None] / max(self._n[None], 1)
        for group in groups:
            rate = (self._k[group] + STRENGTH * rate) / (self._n[group] + STRENGTH)
        return rate
