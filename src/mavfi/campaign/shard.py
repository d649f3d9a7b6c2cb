"""A part of a campaign: every n-th mission, starting with the i-th.  Merging all parts gives the campaign's ledger."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

from mavfi.campaign.config import Campaign
from mavfi.errors import BadInputError


@dataclass(frozen=True, slots=True)
class Shard:
    """Shard `number` (counted from 1) of `of`."""

    number: int = 1
    of: int = 1

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    @staticmethod
    def parse(text: str, source: str) -> "Shard":
        """Parse "i/n"; `source` names option or file in messages.

        Raises:
            BadInputError: The text is not a shard.
        """
        number, _, of = text.partition("/")
        if not (number.isdecimal() and of.isdecimal() and 1 <= int(number) <= int(of)):
            raise BadInputError(f"{source}: {text}: allowed: I/N with 1 <= I <= N, e.g. 3/16")
        return Shard(int(number), int(of))

    def missions(self, campaign: Campaign) -> int:
        """Number of missions in this shard."""
        return len(range(self.number - 1, campaign.total_missions, self.of))

    def worlds(self, campaign: Campaign) -> Iterator[tuple[str, int]]:
        """Environment and seed of the missions in this shard."""
        every = itertools.product(campaign.environments, campaign.seeds)
        return itertools.islice(every, self.number - 1, None, self.of)


WHOLE = Shard()
"""All missions."""
