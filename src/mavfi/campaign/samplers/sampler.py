"""Protocol of samplers, which draw the faults of a campaign, one sampler per level; draws and their numbering."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from mavfi.campaign.config import Campaign
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault
from mavfi.faults.sampling import share_out

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, MissionFlights, Recorded

NULL = "null"  # target of null runs: the complete path through the injector, with an empty mask


@dataclass(frozen=True, slots=True)
class Draw:
    """A fault to be drawn."""

    target: str  # stage, group, kernel, kind of registers or side of calls: a row of a table
    index: int  # number of the fault within target and environment
    seed: int  # seed of its mission
    variant: str = ""  # arm in whose golden run it is drawn; "" = the campaign's own mission
    stratum: str = ""  # stratum of its bit; "" = none


@dataclass(frozen=True, slots=True)
class Block:
    """Faults of an environment with a common numbering; fault i belongs to mission i modulo the number of missions.

    Draws are created on demand: those of a million missions would not fit in memory.
    """

    count: int
    draw: Callable[[int], Draw]  # draw of fault i
    first: int  # position of fault 0 in the environment's plan
    step: int = 1  # distance between the positions of faults i and i + 1


def watched_in(campaign: Campaign, target: str) -> str:
    """The arm in which a detector, also as a named configuration (`recommended`), is injected.

    Raises:
        BadInputError: It is in no arm, or in several.
    """
    from mavfi.detectors.registry import contains

    arms = [name for name, arm in campaign.arms.items() if arm.detector and contains(arm.detector, arm.profile, target)]
    if len(arms) != 1:
        raise BadInputError(f"sampling.kernels: {target!r}: is in {len(arms)} arms; allowed: what is in one arm")
    return arms[0]


def alternating(campaign: Campaign, targets: Sequence[str]) -> list[Block]:
    """One block per target; the faults of the targets alternate."""

    def draw_one(target: str, index: int) -> Draw:
        return Draw(target, index, campaign.first_seed + index % campaign.missions)

    return [
        Block(campaign.faults, partial(draw_one, target), place, len(targets)) for place, target in enumerate(targets)
    ]


class TargetBlocks:
    """Blocks of a sampling scheme, one per target, with exact shares of the bit strata in each.

    Args:
        campaign: Campaign with `faults` per target.
        shares: Shares of the strata, by target.
        orders: Name that seeds the order of a target's strata, by target; default: the target's own name.
        variants: Arm in whose golden runs the faults of a target are drawn, by target; default: the campaign's mission.
    """

    def __init__(
        self, campaign: Campaign, shares: Mapping[str, Mapping[str, float]], orders: Mapping[str, str] | None = None,
        variants: Mapping[str, str] | None = None,
    ) -> None:  # fmt: skip
        self._campaign, self._shares, self._orders = campaign, shares, orders or {}
        self._variants = variants or {}
        self._known: dict[str, Sequence[Block]] = {}

    def of(self, environment: str) -> Sequence[Block]:
        """The blocks of an environment, one per target."""
        if environment not in self._known:
            self._known[environment] = [self._block(environment, *target) for target in enumerate(self._shares)]
        return self._known[environment]

    def _block(self, environment: str, place: int, name: str) -> Block:
        campaign, order = self._campaign, self._orders.get(name, name)
        strata = share_out(self._shares[name], campaign.faults, campaign.first_seed, environment, order)

        def draw_one(index: int) -> Draw:
            seed, variant = campaign.first_seed + index % campaign.missions, self._variants.get(name, "")
            return Draw(name, index, seed, variant, strata[index])

        return Block(campaign.faults, draw_one, place * campaign.faults)


@dataclass(slots=True)
class Sampled:
    """A golden run, with the data from which faults are drawn."""

    flight: "Recorded"
    counts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # per kernel, see `FlightRecord`
    faults: Mapping[str, Sequence[Fault]] = field(default_factory=dict)  # drawn in flight, by target


class Sampler(Protocol):
    """Draws the faults of a campaign; a pure function of the campaign and of golden runs.

    Attributes:
        variants: Overrides of additional missions, for kernels that run only in these.
        versions: Versions on which draws depend, in addition to those of flights.
        instruments: Whether golden flights are flown with instrumented kernels.
    """

    variants: Mapping[str, Mapping[str, Any]]
    versions: Mapping[str, str]
    instruments: bool

    def blocks(self, environment: str) -> Sequence[Block]:
        """All faults of an environment."""

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: "MissionFlights", setup: "ArmSetup"
    ) -> Sampled:  # fmt: skip
        """Fly the golden run of the campaign's own mission, of a variant, or of an arm whose detector is injected.

        `draws`: the draws of this mission in it.
        """

    def draw(self, draws: Sequence[Draw], environment: str, golden: Mapping[str, Sampled]) -> list[Fault | None]:
        """The faults of one mission, in the order of its draws; None = no fault can be drawn, and no run is planned.

        `golden`: golden runs by variant, without failed ones.
        """

    def null(self, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]) -> Fault:
        """The fault of a null run."""


class OwnMissions:
    """Base of samplers that draw from golden runs of the campaign's own missions.

    Attributes:
        profile: Whether they need a profile of the publications.
    """

    variants: Mapping[str, Mapping[str, Any]] = {}
    versions: Mapping[str, str] = {}
    instruments = False
    profile = False

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: "MissionFlights", setup: "ArmSetup"
    ) -> Sampled:  # fmt: skip
        """See `Sampler.golden`."""
        del draws, environment, setup
        return Sampled(flights.golden(arm, profile=self.profile))


def draws_of(blocks: Sequence[Block], missions: range, of: int) -> list[tuple[int, Draw]]:
    """The draws of some missions of an environment, in plan order, each with its position.

    Args:
        blocks: Blocks of the environment.
        missions: Numbers of the missions, counted from 0.
        of: Total number of missions.
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
