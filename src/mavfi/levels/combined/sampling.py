"""Several faults in one mission: as requested by a user, and of a campaign.

In campaigns the faults of a mission are drawn by the samplings of their levels, or given as text.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

from pydantic import Field, SerializeAsAny, ValidationInfo, field_validator, model_validator

from mavfi.config import parse_part
from mavfi.errors import BadInputError
from mavfi.faults.combined import START_FORM, Start
from mavfi.faults.fault import Fault, find_level, level_names
from mavfi.faults.sampling import share_out, stream
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.combined.fault import CombinedFault
from mavfi.levels.level import COMBINED, Draw, Golden, Request, Sampled, Sampler, Sampling, parse

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, Flight, MissionFlights

_GIVEN = "given"
"""Row of a table for faults that are given as text."""
_LARGEST_SEED = 2**63


# ---- as text ---------------------------------------------------------------------------------------------------------
class MemberText(NamedTuple):
    """The text of one of the faults: without what it waits for, which follows the `@`; None = nothing."""

    text: str
    start: Start | None

    @classmethod
    def of(cls, text: str) -> "MemberText":
        """The parts of a text."""
        body, at, instant = text.strip().rpartition("@")
        start = Start.parse(instant)
        if not at or start is None:
            return cls(text.strip(), None)
        return cls(f"{body}@0", start)


@dataclass(frozen=True, slots=True)
class CombinedRequest:
    """Several faults as requested by the user.

    Attributes:
        texts: Their texts.
        requests: The requests in these.
    """

    texts: tuple[MemberText, ...]
    requests: tuple[Request, ...]

    def draw(self, setup: "ArmSetup", seed: int) -> "tuple[CombinedFault, Flight | None]":
        """See `Request.draw`; of equal texts, each has a seed of its own."""
        golden = None
        faults = []
        for number, request in enumerate(self.requests):
            repeated = self.texts[:number].count(self.texts[number])
            fault, flown = request.draw(setup, (seed + repeated) % _LARGEST_SEED)
            golden = golden or flown
            faults.append(fault)
        return CombinedFault(tuple(faults), tuple(text.start for text in self.texts)), golden


# ---- in campaigns ----------------------------------------------------------------------------------------------------
class CombinedSampling(Sampling):
    """Several faults in each mission, drawn jointly, or given as text."""

    null_runs: ClassVar[int] = 0
    level: Literal["combined"]
    of: tuple[SerializeAsAny[Sampling] | str, ...] = Field(
        min_length=1,
        description="where the faults of a mission come from, in order: a sampling of a level with its keys, or the "
        "text of a fault as behind --fault, whose missing parts are drawn; the first one has the rows of tables",
    )
    faults_per_mission: int = Field(
        0, ge=0, le=16, description="number of faults; those of `of` in turn; 0 = as many as there are in `of`"
    )
    later: str = Field(
        "", description=f"what the drawn faults behind the first one wait for instead of an instant: {START_FORM}"
    )

    @field_validator("of", mode="before")
    @classmethod
    def _of_levels(cls, values: Any, info: ValidationInfo) -> Any:
        """Validate each sampling by its level."""
        if not isinstance(values, list | tuple):
            return values
        return [_member(value, f"of.{number}", info) for number, value in enumerate(values)]

    @model_validator(mode="after")
    def _consistent(self) -> "CombinedSampling":
        """Check the texts, and what later faults wait for."""
        if self.later and Start.parse(self.later) is None:
            raise ValueError(f"sampling.later: {self.later!r}: allowed: {START_FORM}")
        for number, member in enumerate(self.of):
            if isinstance(member, str) and number == 0 and MemberText.of(member).start is not None:
                raise ValueError(f"sampling.of.0: {member!r}: no fault precedes it; allowed: an instant, or none")
        return self

    @property
    def number(self) -> int:
        """Number of faults in a mission."""
        return self.faults_per_mission or len(self.of)

    @property
    def instrumented(self) -> tuple[str, ...]:
        """See `Sampling.instrumented`."""
        kernels = [name for member in self.of if isinstance(member, Sampling) for name in member.instrumented]
        return tuple(dict.fromkeys(kernels))

    def to_json(self) -> dict[str, Any]:
        """See `Sampling.to_json`."""
        members: list[Any] = []
        for member in self.of:
            if isinstance(member, Sampling):
                members.append(member.to_json())
            else:
                members.append(member)
        return {**self.model_dump(mode="json"), "of": members}


def _member(value: Any, key: str, info: ValidationInfo) -> Any:
    """The sampling of a level, or a text."""
    if isinstance(value, str | Sampling):
        return value
    level = None
    if isinstance(value, Mapping):
        level = value.get("level", "state")
    allowed = [name for name in level_names() if name != COMBINED and find_level(name).sampling is not None]
    if level not in allowed:
        raise ValueError(f"sampling.{key}: level {level!r}: allowed: a text, or level {', '.join(allowed)}")
    return parse_part(find_level(level).sampling, value, f"sampling.{key}", info.context)


class _Member(NamedTuple):
    """One of the faults of a mission.

    Attributes:
        source: Its sampler, or its text.
        use: How many faults before it have the same source.
        start: What it waits for; None = nothing.
    """

    source: Sampler | MemberText
    use: int
    start: Start | None


class CombinedSampler(Sampler):
    """Draws several faults for each mission; the first one is that of a campaign with its sampling alone.

    Raises:
        BadInputError: A sampling draws in another mission than the campaign's own, or a text is not understood.
    """

    def __init__(self, campaign: SampledCampaign) -> None:
        super().__init__(campaign)
        spec = campaign.first_mission
        self._localization = spec.localization
        self._members = list(self._find_members())
        if campaign.nulls:
            raise BadInputError(f"null_runs: {campaign.nulls}; allowed: 0 with several faults")
        if len(campaign.sizes) > 1:  # numbers and strata of the further faults depend on the size of the campaign
            text = "with several faults in a mission, a campaign cannot be extended by them"
            raise BadInputError(f"missions, faults: {text}; allowed: more environments and arms")
        # The first source has the rows.
        first = self._members[0].source
        if isinstance(first, Sampler):
            self.targets = first.targets
            self.orders = first.orders
            self.alternates = first.alternates
        else:
            self.targets = {_GIVEN: {"": 1.0}}
        samplers = [member.source for member in self._members if isinstance(member.source, Sampler)]
        self.instruments = any(sampler.instruments for sampler in samplers)
        for sampler in samplers:
            self.versions = {**self.versions, **sampler.versions}

    def _find_members(self) -> Iterator[_Member]:
        """The faults of a mission."""
        sampling = self.sampling
        sources: list[Sampler | MemberText] = []
        for number, member in enumerate(sampling.of):
            if isinstance(member, str):
                sources.append(MemberText.of(member))
                parse(sources[-1].text, self._localization)  # type: ignore[union-attr] # refuses what is not understood
                continue
            alone = self.campaign.with_sampling(member)
            sampler = find_level(member.level).sampler(alone)
            if sampler.variants or any(sampler.arms.values()):
                text = "allowed with several faults: those of the campaign's own mission"
                raise BadInputError(f"sampling.of.{number}: level {member.level}: {text}")
            sources.append(sampler)
        later = Start.parse(sampling.later)
        for number in range(sampling.number):
            use, position = divmod(number, len(sources))
            source = sources[position]
            start = later
            if isinstance(source, MemberText):
                start = source.start
            if number == 0:
                start = None
            yield _Member(source, use, start)

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: "MissionFlights", setup: "ArmSetup"
    ) -> Sampled:
        """Fly the golden run, and draw the faults of all sources from it."""
        sampled = Sampled(flights.golden(arm, profile=True))
        if arm or not draws:
            return sampled

        # All faults of a source are drawn together: some are drawn during one flight.
        faults: dict[tuple[int, int], Fault | None] = {}  # by position of the draw, and number of the member
        for source in dict.fromkeys(member.source for member in self._members):
            numbers = [number for number, member in enumerate(self._members) if member.source is source]
            keys = [(position, number) for position in range(len(draws)) for number in numbers]
            if isinstance(source, MemberText):
                for position, number in keys:
                    seed = self._seed_of(draws[position], number, environment)
                    faults[position, number] = parse(source.text, self._localization).draw(setup, seed)[0]
                continue
            single_draws = [self._draw_of(source, draws[position], number, environment) for position, number in keys]
            of_source = source.golden(arm, single_draws, environment, flights, setup)
            faults.update(zip(keys, source.draw(single_draws, environment, {arm: of_source}), strict=True))
            sampled.counts = {**sampled.counts, **of_source.counts}

        # Combine them.
        combined: dict[tuple[str, str], list[Fault | None]] = {}
        for position, draw in enumerate(draws):
            of_draw = [faults[position, number] for number in range(len(self._members))]
            combined.setdefault((draw.target, draw.stratum), []).append(self._combine(of_draw))
        return replace(sampled, faults=combined)

    def _seed_of(self, draw: Draw, number: int, environment: str) -> int:
        """Seed of a fault that is given as text."""
        random = stream(draw.seed, "combined", self.campaign.environment_of(environment), draw.index, number)
        return int(random.integers(_LARGEST_SEED))

    def _draw_of(self, sampler: Sampler, draw: Draw, number: int, environment: str) -> Draw:
        """The draw of a member by its own sampler; further faults have numbers beyond those of a campaign."""
        member = self._members[number]
        campaign = self.campaign
        rounds = -(-campaign.faults // campaign.missions)
        index = draw.index + member.use * rounds * campaign.missions  # of the same mission
        if number == 0:
            return sampler.numbered(draw.target, index, draw.seed, draw.stratum)
        target = draw.target
        if target not in sampler.targets:
            target = list(sampler.targets)[draw.index % len(sampler.targets)]
        order = sampler.orders.get(target, target)
        strata = share_out(
            sampler.targets[target], campaign.faults, campaign.first_seed, environment, f"{order} {number}"
        )
        return sampler.numbered(target, index, draw.seed, strata[draw.index])

    def _combine(self, faults: Sequence[Fault | None]) -> CombinedFault | None:
        """The faults of a mission without those that could not be drawn; None = none could."""
        members: list[Fault] = []
        starts: list[Start | None] = []
        for fault, member in zip(faults, self._members, strict=True):
            if fault is None:
                continue
            start = member.start
            if not members:
                start = None
            members.append(fault)
            starts.append(start)
        if not members:
            return None
        return CombinedFault(tuple(members), tuple(starts))

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """Not supported with several faults."""
        raise BadInputError("null runs: allowed with one fault per mission")
