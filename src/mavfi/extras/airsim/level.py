"""Faults in the numbers of a program's calls (host airsim_program): `faults` for each side of the boundary.

A call is drawn uniformly from those of the golden run with a number on this side, then one of its numbers, then one of
64 bits (modulo the width of the number).  A call that returns an image is as likely as any other one.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from mavfi.campaign.config import label_of
from mavfi.faults.fault import Fault
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import Draw, Golden, Sampler, Sampling, check_distinct
from mavfi.levels.message import MessageLevel
from mavfi.levels.message.fault import MessageFault

_BITS = 64
_PURPOSE = 11
NO_CALL = "none"
"""Call of a draw for which the golden run has none."""


class CallSampling(Sampling):
    """Faults in the calls of a program (host airsim_program): one bit of one number of one call."""

    level: Literal["message"]
    sides: tuple[Literal["arguments", "return"], ...] = Field(
        ("arguments", "return"), min_length=1, description="of the calls; `faults` for each"
    )
    calls: tuple[str, ...] = Field((), description="names of the calls; all that the golden run makes by default")

    @model_validator(mode="after")
    def _consistent(self) -> "CallSampling":
        check_distinct("sampling.sides", self.sides)
        return self


class CallSampler(Sampler):
    """Draws one bit of one number of one call."""

    alternates = True
    draws_together = False

    def __init__(self, campaign: SampledCampaign) -> None:
        super().__init__(campaign)
        self.targets = dict.fromkeys(self.sampling.sides, {"": 1.0})

    def draw(self, draws: Sequence[Draw], environment: str, golden: Golden) -> list[Fault | None]:
        """One fault per draw; None without a golden run, or without a call that has a number on that side."""
        return [self._fault(draw.target, draw.index, draw.seed, golden) for draw in draws]

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """A fault with every step except the flip; sides alternate."""
        sides = self.sampling.sides
        fault = self._fault(sides[index % len(sides)], index, seed, golden, null=True)
        return fault or MessageFault(NO_CALL, f"{sides[0]}#0")

    def _fault(self, side: str, index: int, seed: int, golden: Golden, *, null: bool = False) -> MessageFault | None:
        """Draw a fault on one side of the calls; None if the golden run has no number there."""
        # all calls of the golden run with a number on this side
        recorded_calls: Sequence[Any] = ()
        if "" in golden:
            recorded_calls = getattr(golden[""].flight, "calls", ())
        counts: Counter[str] = Counter()
        calls: list[tuple[str, int, int]] = []  # name, number among those of this name, numbers on this side
        for call in recorded_calls:
            counts[call.name] += 1
            numbers = call.returned
            if side == "arguments":
                numbers = call.arguments
            if numbers and (not self.sampling.calls or call.name in self.sampling.calls):
                calls.append((call.name, counts[call.name], numbers))
        if not calls:
            return None

        # one of them, one of its numbers, one of 64 bits
        key = (_PURPOSE, index, ("arguments", "return").index(side), int(null))
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
        name, at, numbers = calls[int(random.integers(len(calls)))]
        number = int(random.integers(numbers))
        bit: int | None = int(random.integers(_BITS))
        if null:
            bit = None
        return MessageFault(name, f"{side}#{number}", bit, at, seed=seed)


class CallLevel(MessageLevel):
    """Faults in the numbers of calls, as the host draws them."""

    sampling = CallSampling
    sampler = CallSampler

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`: the program under test."""
        calls = campaign.sampling.calls
        what = ""
        if campaign.under_test is not None:
            what = campaign.under_test.script
        of_calls = ""
        if calls:
            of_calls = f" of {', '.join(calls)}"
        line = f"{what} · one bit per run, in a number of a call{of_calls}, uniform over calls"
        title = f"campaign {campaign.name} · AirSim program in {', '.join(map(label_of, campaign.environments))}"
        return {"each": "side of the calls", "profile": "", "title": title, "lines": [line]}
