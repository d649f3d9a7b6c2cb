"""Several faults in one mission, as text: `state:control.command.vx:bit=62@10 + memory:planner:bit=3@alarm`.

Each is a fault of any level.  All but the first may wait for an event instead of an instant: `@injection+2`, 2 s after
the first injection; `@alarm`, at the first alarm after it, and so in what is recomputed.

In campaigns the faults of a mission are drawn by the samplings of their levels, or given as text.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

from pydantic import Field, SerializeAsAny, ValidationInfo, field_validator, model_validator

from mavfi.config import parse_part
from mavfi.errors import BadInputError
from mavfi.faults.combined import AND, START_FORM, Start
from mavfi.faults.fault import Fault, FliesFrom, find_level, level_names
from mavfi.faults.injector import Injector
from mavfi.faults.sampling import share_out, stream
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.combined.fault import CombinedFault, is_in_calls
from mavfi.levels.level import COMBINED, Draw, Golden, Level, Request, Sampled, Sampler, Sampling, parse, text_of
from mavfi.record import Injection

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavfi.flight.host import ArmSetup, Flight, MissionFlights
    from mavfi.flight.instruction_cases import Published

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

    def _find_members(self) -> "Iterator[_Member]":
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


# ---- the level -------------------------------------------------------------------------------------------------------
def fewer_faults(fault: CombinedFault, _: Injection | None) -> "Iterator[Fault]":
    """One of the faults alone, then all but one."""
    if len(fault.faults) == 1:
        return
    for single, start in fault.members:
        if start is None:
            yield single
    if len(fault.faults) == 2:  # noqa: PLR2004 - all but one are one
        return
    for number in range(1, len(fault.faults)):
        faults = fault.faults[:number] + fault.faults[number + 1 :]
        yield CombinedFault(faults, fault.starts[:number] + fault.starts[number + 1 :])


class CombinedLevel(Level):
    """Several faults in one mission."""

    fault = CombinedFault
    sampling = CombinedSampling
    sampler = CombinedSampler
    local = True
    form = f"FAULT{AND}FAULT"
    reductions = {"faults": fewer_faults}

    def parse(self, text: str, localization: str) -> CombinedRequest:
        """See `Level.parse`; the text of several faults begins with no level."""
        texts = tuple(MemberText.of(member) for member in text.split(AND))
        requests = tuple(parse(member.text, localization) for member in texts)
        if texts[0].start is not None:
            raise BadInputError(f"@{texts[0].start}: no fault precedes it; allowed: an instant, or a fault before it")
        return CombinedRequest(texts, requests)

    def text_of(self, fault: CombinedFault) -> str | None:
        """See `Level.text_of`."""
        texts = []
        for member, start in fault.members:
            text = text_of(member)
            if text is None:
                return None
            if start is not None:
                text = f"{text.rpartition('@')[0]}@{start}"
            texts.append(text)
        return AND.join(texts)

    def seed_of(self, fault: CombinedFault) -> int | None:
        """See `Level.seed_of`: that of the first fault that needs one."""
        seeds = [find_level(member.level).seed_of(member) for member in fault.faults]
        return next((seed for seed in seeds if seed is not None), None)

    def flies_from(self, fault: CombinedFault) -> FliesFrom:
        """See `Level.flies_from`."""
        if any(is_in_calls(member) for member in fault.faults):
            return FliesFrom.CALLS
        return FliesFrom.TAKE_OFF

    def fly_forked(
        self, setup: "ArmSetup", fault: CombinedFault, detector: Any, *, records: bool = False
    ) -> "tuple[Flight, list[Published]]":
        """See `Level.fly_forked`."""
        from mavfi.levels.combined.forks import fly_serially

        return fly_serially(setup, fault.members, detector, records=records)

    def inject(self, loop: Any, fault: CombinedFault, detector: Any) -> Injector:
        """See `Level.inject`."""
        from mavfi.levels.combined.injector import CombinedInjector

        return CombinedInjector(loop, fault.members, detector)

    def columns(self, fault: CombinedFault) -> dict[str, Any]:
        """See `Level.columns`: those of the first fault."""
        first = fault.faults[0]
        columns: dict[str, Any] = find_level(first.level).columns(first)
        columns.pop("population", None)
        return columns

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`."""
        sampling = campaign.sampling
        sources = []
        unit = "row"
        for number, member in enumerate(sampling.of):
            if isinstance(member, str):
                sources.append(member)
                continue
            alone = campaign.with_sampling(member)
            about = find_level(member.level).about(alone)
            sources.append(f"{member.level} ({about['how']})")
            if number == 0:
                unit = about["each"]
        how = f"{sampling.number} faults in each mission: {'; '.join(sources)}"
        if sampling.later:
            how += f"; those behind the first one at {sampling.later}"
        per_mission = "one fault"
        if sampling.number > 1:
            per_mission = f"{sampling.number} faults"
        return {"each": unit, "how": how, "per_mission": per_mission}
