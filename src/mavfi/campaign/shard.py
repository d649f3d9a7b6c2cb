"""A part of a campaign: every n-th mission, from the i-th on.  The ledgers of all parts merge into the campaign's."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

from mavfi.campaign.config import Campaign
from mavfi.errors import BadInputError


@dataclass(frozen=True, slots=True)
class Shard:
    """Shard `number` (from 1 on) of `of`."""

    number: int = 1
    of: int = 1

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    @staticmethod
    def parse(text: str, source: str) -> "Shard":
        """The shard of "i/n"; `source` names option or file in messages.

        Raises:
            BadInputError: The text is none.
        """
        number, _, of = text.partition("/")
        if not (number.isdecimal() and of.isdecimal() and 1 <= int(number) <= int(of)):
            raise BadInputError(f"{source}: {text}: allowed: I/N with 1 <= I <= N, e.g. 3/16")
        return Shard(int(number), int(of))

    def missions(self, campaign: Campaign) -> int:
        """Number of its missions."""
        return len(range(self.number - 1, campaign.total_missions, self.of))

    def worlds(self, campaign: Campaign) -> Iterator[tuple[str, int]]:
        """Environment and seed of its missions."""
        every = itertools.product(campaign.environments, campaign.seeds)
        return itertools.islice(every, self.number - 1, None, self.of)


WHOLE = Shard()
"""All missions."""
