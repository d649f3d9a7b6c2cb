"""Faults in the numbers of a program's calls (host airsim_program): `faults` for each side of the boundary.

A call is drawn uniformly from those of the golden run with a number on this side, then one of its numbers, then one of
64 bits (modulo the width of the number).  A call that returns an image is as likely as any other one.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mavfi.campaign.config import Campaign
from mavfi.campaign.samplers.sampler import Block, Draw, OwnMissions, Sampled, alternating
from mavfi.campaign.sampling import MessageSampling
from mavfi.faults.fault import Fault, MessageFault

_BITS = 64
_PURPOSE = 11
NO_CALL = "none"
"""Call of a draw for which the golden run has none."""


class MessageSampler(OwnMissions):
    """Draws one bit of one number of one call."""

    def __init__(self, campaign: Campaign) -> None:
        assert isinstance(campaign.sampling, MessageSampling)  # as `sampler_for` chooses
        self._campaign, self._sampling = campaign, campaign.sampling

    def blocks(self, environment: str) -> Sequence[Block]:
        """One block per side."""
        del environment
        return alternating(self._campaign, self._sampling.sides)

    def draw(self, draws: Sequence[Draw], environment: str, golden: Mapping[str, Sampled]) -> list[Fault | None]:
        """One fault per draw; None without a golden run, or without a call that has a number on that side."""
        return [self._fault(draw.target, draw.index, draw.seed, golden) for draw in draws]

    def null(self, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]) -> Fault:
        """A fault with every step except the flip; sides alternate."""
        sides = self._sampling.sides
        found = self._fault(sides[index % len(sides)], index, seed, golden, null=True)
        return found or MessageFault(NO_CALL, f"{sides[0]}#0")

    def _fault(
        self, side: str, index: int, seed: int, golden: Mapping[str, Sampled], *, null: bool = False
    ) -> MessageFault | None:  # fmt: skip
        passed: Sequence[Any] = getattr(golden[""].flight, "passed", ()) if "" in golden else ()
        seen: Counter[str] = Counter()
        calls: list[tuple[str, int, int]] = []  # name, number among those of this name, numbers on this side
        for one in passed:
            seen[one.name] += 1
            numbers = one.arguments if side == "arguments" else one.returned
            if numbers and (not self._sampling.calls or one.name in self._sampling.calls):
                calls.append((one.name, seen[one.name], numbers))
        if not calls:
            return None
        key = (_PURPOSE, index, ("arguments", "return").index(side), int(null))
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
        name, at, numbers = calls[int(random.integers(len(calls)))]
        number, bit = int(random.integers(numbers)), int(random.integers(_BITS))
        return MessageFault(name, f"{side}#{number}", None if null else bit, at, seed=seed)
