"""What a sampler is: how the faults of a campaign are drawn, one sampler for each level."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from mavfi.campaign.config import Campaign
from mavfi.faults.fault import Fault
from mavfi.faults.sampling import share_out
from mavfi.hosts.host import ArmSetup, MissionFlights, Recorded

NULL = "null"  # target of null runs: the whole path through the injector, with an empty mask


@dataclass(frozen=True, slots=True)
class Draw:
    """A fault that is to be drawn."""

    target: str  # stage, group, kernel or kind of registers: a row of a table
    index: int  # number of the fault within target and environment
    seed: int  # of its mission
    variant: str = ""  # arm in whose golden run it is drawn; "" = the campaign's own mission
    stratum: str = ""  # of its bit; "" = none


@dataclass(frozen=True, slots=True)
class Block:
    """Faults of an environment that are numbered together; fault i is that of mission i modulo their number.

    A block makes its draws when they are asked for: all those of a million missions would fill the memory.
    """

    count: int
    draw: Callable[[int], Draw]  # of fault i
    first: int  # place of fault 0 in the environment's plan
    step: int = 1  # between the places of faults i and i + 1


class TargetBlocks:
    """Blocks of a sampling scheme, one for each target, with exact shares of the bit strata in each.

    Args:
        campaign: Its `faults` are drawn for each target.
        shares: Shares of the strata, by target.
        orders: Name from which the order of a target's strata is drawn, where it is not the target's own.
    """

    def __init__(
        self, campaign: Campaign, shares: Mapping[str, Mapping[str, float]], orders: Mapping[str, str] | None = None
    ) -> None:
        self._campaign, self._shares, self._orders = campaign, shares, orders or {}
        self._known: dict[str, Sequence[Block]] = {}

    def of(self, environment: str) -> Sequence[Block]:
        """Target by target."""
        if environment not in self._known:
            self._known[environment] = [self._block(environment, *target) for target in enumerate(self._shares)]
        return self._known[environment]

    def _block(self, environment: str, place: int, name: str) -> Block:
        campaign, order = self._campaign, self._orders.get(name, name)
        strata = share_out(self._shares[name], campaign.faults, campaign.first_seed, environment, order)

        def draw_one(index: int) -> Draw:
            return Draw(name, index, campaign.first_seed + index % campaign.missions, stratum=strata[index])

        return Block(campaign.faults, draw_one, place * campaign.faults)


@dataclass(slots=True)
class Sampled:
    """A golden run, and what faults are drawn from."""

    flight: Recorded
    counts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # executed by its kernels, see `FlightRecord`
    faults: Mapping[str, Sequence[Fault]] = field(default_factory=dict)  # drawn in flight, by target


class Sampler(Protocol):
    """Draws the faults of a campaign; a pure function of the campaign and of golden runs.

    Attributes:
        variants: Missions that are flown besides its own because a kernel runs in them only: overrides.
        versions: What its draws depend on besides the versions that decide the bits of a flight.
    """

    variants: Mapping[str, Mapping[str, Any]]
    versions: Mapping[str, str]

    def blocks(self, environment: str) -> Sequence[Block]:
        """All faults of an environment."""

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: MissionFlights, setup: ArmSetup
    ) -> Sampled:  # fmt: skip
        """Fly the golden run of the campaign's own mission, of a variant, or of an arm whose detector is injected.

        `draws` are those of this mission in it.
        """

    def draw(self, draws: Sequence[Draw], environment: str, golden: Mapping[str, Sampled]) -> list[Fault | None]:
        """The faults of one mission, in the order of its draws; None = nothing can be drawn, and no run is planned.

        Golden runs are by variant; one that left nothing is absent.
        """

    def null(self, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]) -> Fault:
        """The fault of a null run."""


def draws_of(blocks: Sequence[Block], missions: range, of: int) -> list[tuple[int, Draw]]:
    """The faults of some missions of an environment, by number, in the order of the plan, each with its place.

    Args:
        blocks: Of the environment.
        missions: Numbers of missions, from 0 on.
        of: Number of all missions.
    """
    return sorted(
        (
            (block.first + index * block.step, block.draw(index))
            for block in blocks
            for mission in missions
            for index in range(mission, block.count, of)
        ),
        key=lambda found: found[0],
    )
