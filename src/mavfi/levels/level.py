"""Interface of a fault level, and the drawing of a campaign's faults.

A level says how its faults are written as text, drawn from golden flights, injected, described and made smaller.  It is
a class without arguments, an entry point of the group `mavfi.levels`; nothing else in mavfi names it, except the list
of levels in the core, `faults.fault.SHIPPED`.
"""

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple, NoReturn, Protocol

from pydantic import Field

from mavfi.config import Config
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, hint, not_known
from mavfi.faults.changes import LATEST_S, Change, parse_change, parse_text
from mavfi.faults.combined import AND, Start
from mavfi.faults.fault import Fault, FliesFrom, find_level, level_names
from mavfi.faults.injector import Injector
from mavfi.faults.operations import OPERATIONS, SYNONYMS
from mavfi.faults.sampling import share_out
from mavfi.faults.strata import EACH_CLASS, STRATA
from mavfi.levels.campaign import SampledCampaign
from mavfi.record import Injection, Profile
from mavfi.states import STATES

if TYPE_CHECKING:
    from mavfi.detectors.detector import Detector
    from mavfi.flight.host import ArmSetup, Flight, MissionFlights, Recorded
    from mavfi.flight.instruction_cases import Published
    from mavfi.flight.loop import Loop

Begin = Callable[["Loop", int], Injector]
"""Injects a fault that has waited into a flight, from an instant on (us); returns its injector."""
NULL = "null"
"""Target of null runs: the complete path through the injector, with an empty mask; and the text of such a fault."""
COMBINED = "combined"
"""Level of several faults."""
DECIMAL = r"\d+(\.\d*)?"
"""Pattern of a number that is not negative, without exponent."""
# Values of options in the text of a fault: pattern, description, type.
WHOLE = (r"\d+", "a whole number", int)
"""An option whose value is a whole number, see `Level.options`: pattern, description, type."""
SECONDS = (rf"inf|{DECIMAL}", "a number of seconds, or inf", float)
"""An option whose value is a duration (s), see `Level.options`."""
_INSTANT = rf"{DECIMAL}([eE][+-]?\d+)?"
"""Pattern of an instant (s)."""


# ---- one fault, as text ----------------------------------------------------------------------------------------------
class Request(Protocol):
    """A fault as requested by the user; what is not given is drawn."""

    def draw(self, setup: "ArmSetup", seed: int) -> "tuple[Fault, Flight | None]":
        """The fault in a mission, and the golden flight without a detector if one was flown for the draw.

        The detector of the setup is flown only if the fault is in its own instructions or memory.

        Raises:
            BadInputError: The mission has no such site.
        """


@dataclass(frozen=True, slots=True)
class FaultText:
    """The parts of a fault's text.

    Attributes:
        site: What stands before the options.
        options: Given options by name.
        time_us: Instant (us); None = not given.
    """

    site: str
    options: dict[str, Any]
    time_us: int | None


def parse(text: str, localization: str = "truth", levels: Collection[str] = ()) -> Request:
    """Parse a fault from the command line.

    Args:
        text: `null` (the empty mask on the way-point in force), or a level and what it needs, e.g. `state:` and a site.
        localization: "truth" or "estimator", which determines the existing states.
        levels: Levels that a host can inject; empty = all.

    Raises:
        BadInputError: Another level, or not in its form; the message says what is allowed.
    """
    if is_combined(text) and (not levels or COMBINED in levels):
        combined: Request = find_level(COMBINED).parse(text, localization)
        return combined
    if is_combined(text):
        reason = "several faults, or one that waits for an event: allowed in flights of mavfi itself; here: one"
        raise BadInputError(f"fault {text!r}: {reason}")
    name, _, rest = text.partition(":")
    if levels and name not in {NULL, *levels}:
        raise BadInputError(
            f"fault {text!r}: allowed here: null, {', '.join(f'{name}:...' for name in sorted(levels))}"
        )
    try:
        if text == NULL:
            request: Request = find_level("state").null()
        elif name in level_names():
            request = find_level(name).parse(rest, localization)
        elif rest:
            raise BadInputError(_not_a_level(text, localization))
        else:
            raise BadInputError(f"not understood{_likely_texts(text, localization)}; allowed: {_forms()}")
    except BadInputError as error:
        raise BadInputError(f"fault {text!r}: {error}") from None
    return request


def is_combined(text: str) -> bool:
    """Whether a text has several faults, or one that waits for an event of the flight."""
    return AND in text or Start.parse(text.rpartition("@")[2]) is not None


def text_of(fault: Fault) -> str | None:
    """The text that names a fault in full, for `mavfi fly --fault`; None = it is in no mission of this process."""
    text: str | None = find_level(fault.level).text_of(fault)
    return text


def _forms() -> str:
    """How the text of a fault begins, and where all forms are described, in one line."""
    levels = [name for name in level_names() if find_level(name).form and name != COMBINED]
    return f"{NULL}, {', '.join(f'{name}:...' for name in levels)}; forms: `mavfi docs fault-specs`"


def _not_a_level(text: str, localization: str) -> str:
    """The message on a text that begins with no level: the level was forgotten, or its name is misspelled."""
    likely = _likely_texts(text, localization)
    if likely:
        return f"not understood{likely}; allowed: {_forms()}"
    levels = [name for name in level_names() if name != COMBINED]
    return f"level {not_known(text.partition(':')[0], levels)}; forms: `mavfi docs fault-specs`"


def _likely_texts(text: str, localization: str) -> str:
    """A question after a text without a level: whether the text that a level understands is meant; "" = none does."""
    misspelled = hint(text.partition("@")[0], [NULL])
    if misspelled:
        return misspelled
    likely = []
    for name in level_names():
        if name == COMBINED:  # it would parse its members, and so this text again
            continue
        with suppress(Exception):  # a level of another package may raise anything for a text that is not its own
            if find_level(name).shipped_site(find_level(name).parse(text, localization)):
                likely.append(f"'{name}:{text}'")
    if not likely:
        sites = [f"{name}.{value.name}" for name, spec in STATES.items() for value in (*spec.header, *spec.elements)]
        return hint(f"state:{text.partition('@')[0].partition(':')[0]}", [f"state:{site}" for site in sites])
    return f" (did you mean {' or '.join(likely)}?)"


# ---- the faults of a campaign ----------------------------------------------------------------------------------------
class Sampling(Config):
    """How faults are drawn; the further keys are those of the level."""

    null_runs: ClassVar[int] = 3
    """Default number of null runs per environment."""
    level: str = Field(description="name of the level")

    @property
    def instrumented(self) -> tuple[str, ...]:
        """Kernels and detectors whose code is instrumented, and so compiled before a campaign."""
        return ()

    def to_json(self) -> dict[str, Any]:
        """Plain data; unset keys of later versions are omitted, so that older campaigns keep their identity."""
        return self.model_dump(mode="json")

    def identity(self) -> dict[str, Any]:
        """Plain data in the identity of a ledger."""
        return self.to_json()


@dataclass(frozen=True, slots=True)
class Draw:
    """A fault to be drawn.

    Attributes:
        target: Stage, group, kernel, kind of registers or side of calls: a row of a table.
        index: Number of the fault within target and environment.
        seed: Seed of its mission.
        variant: Arm in whose golden run it is drawn; "" = the campaign's own mission.
        stratum: Stratum of its bit; "" = none.
    """

    target: str
    index: int
    seed: int
    variant: str = ""
    stratum: str = ""


@dataclass(frozen=True, slots=True)
class FaultBlock:
    """Faults of a target in an environment; its missions take them in turn.

    Draws are created on demand: those of a million missions would not fit in memory.

    Attributes:
        count: Number of faults.
        draw: The draw of fault i of the block.
        first: Position of fault 0 in the environment's plan.
        missions: Number of missions.
        mission: Number of the mission of fault 0.
        step: Distance between the positions of faults i and i + 1.
    """

    count: int
    draw: Callable[[int], Draw]
    first: int
    missions: int
    mission: int = 0
    step: int = 1

    def of_mission(self, mission: int) -> range:
        """Numbers of the faults of a mission."""
        if mission >= self.missions:
            return range(0)
        return range((mission - self.mission) % self.missions, self.count, self.missions)


class Batch(NamedTuple):
    """The faults of each target by which a campaign has grown at once, or with which it was begun.

    Attributes:
        number: Number of the batch, which is in the address of the order of its strata.
        first: Number of the first fault.
        faults: Number of faults.
        missions: Number of missions, which take them in turn.
        mission: Number of the mission of the first fault: the next in turn, or the first new one.
        repetition: Faults that a mission has before it, at most.
    """

    number: int
    first: int
    faults: int
    missions: int
    mission: int
    repetition: int


def _batches(campaign: SampledCampaign) -> list[Batch]:
    """The batches of a campaign, from the sizes that it has had."""
    begun = campaign.sizes[0]
    batches = [Batch(0, 0, begun.faults, begun.missions, 0, 0)]
    for number, size in enumerate(campaign.sizes[1:], 1):
        last = batches[-1]
        first = last.first + last.faults
        mission = (last.mission + last.faults) % last.missions
        if size.missions > last.missions:
            mission = last.missions
        rounds = -(-last.faults // last.missions)
        batches.append(Batch(number, first, size.faults - first, size.missions, mission, last.repetition + rounds))
    return batches


@dataclass(slots=True)
class Sampled:
    """A golden run, with the data from which faults are drawn.

    Attributes:
        flight: The golden run.
        counts: Executed instructions by kernel, see `FlightRecord`.
        faults: Faults that were drawn during the flight, by target and stratum; None = it could not be drawn.
    """

    flight: "Recorded"
    counts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    faults: Mapping[tuple[str, str], Sequence[Fault | None]] = field(default_factory=dict)


Golden = Mapping[str, Sampled]
"""Golden runs of a mission by variant, without failed ones."""


def profile_of(golden: Golden) -> Profile:
    """Publications of the golden run; none without it."""
    if "" not in golden or golden[""].flight.profile is None:
        return Profile()
    return golden[""].flight.profile


class Sampler:
    """Draws the faults of a campaign; a pure function of the campaign and of golden runs.

    Raises:
        BadInputError: The sampling names unknown sites, or conflicts with the rest of the campaign.

    Args:
        campaign: The campaign, with `faults` per target.

    Attributes:
        targets: Shares of the strata in each target, in the order of the plan.
        arms: Arm in whose golden runs the faults of a target are drawn; default: the campaign's own mission.
        orders: Name that seeds the order of a target's strata; default: that of the target.
        alternates: Whether the faults of the targets alternate in the plan.
        variants: Overrides of additional missions, for kernels that run only in these.
        versions: Versions on which draws depend, in addition to those of flights.
        profile: Whether draws need the publication times of golden runs.
        instruments: Whether golden flights are flown with instrumented kernels.
        draws_together: Whether the faults of a mission in one target are drawn together, and so depend on their number;
            not if each has a random stream of its own, whose campaigns can have more faults in a mission.
    """

    alternates = False
    profile = False
    instruments = False
    draws_together = True

    def __init__(self, campaign: SampledCampaign) -> None:
        self.campaign = campaign
        self.sampling = campaign.sampling
        self.targets: Mapping[str, Mapping[str, float]] = {}
        self.arms: Mapping[str, str] = {}
        self.orders: Mapping[str, str] = {}
        self.variants: Mapping[str, Mapping[str, Any]] = {}
        self.versions: Mapping[str, str] = {}
        self._batches = _batches(campaign)
        self._blocks: dict[str, Sequence[FaultBlock]] = {}
        self._companions: dict[str, Counter[tuple[int, str]]] = {}
        """By environment: number of faults that are drawn together, by seed of their mission and target."""

    def blocks(self, environment: str) -> Sequence[FaultBlock]:
        """All faults of an environment, one block per batch and target, with exact shares of the strata in each."""
        if environment not in self._blocks:
            self._blocks[environment] = [
                self._block(environment, batch, position, target)
                for batch in self._batches
                for position, target in enumerate(self.targets)
            ]
        return self._blocks[environment]

    def _block(self, environment: str, batch: Batch, position: int, target: str) -> FaultBlock:
        """The faults of a target in a batch, given its position among the targets."""
        first_seed = self.campaign.first_seed
        address: list[int | str] = [environment, self.orders.get(target, target)]
        if batch.number > 0:  # the first batch has the order of a campaign that has not grown
            address.append(batch.number)
        strata = share_out(self.targets[target], batch.faults, first_seed, *address)

        def draw_one(index: int) -> Draw:
            mission = (batch.mission + index) % batch.missions
            return self.numbered(target, batch.first + index, first_seed + mission, strata[index])

        step = 1
        first = batch.first * len(self.targets) + position * batch.faults
        if self.alternates:
            step = len(self.targets)
            first = batch.first * step + position
        return FaultBlock(batch.faults, draw_one, first, batch.missions, batch.mission, step)

    def numbered(self, target: str, index: int, seed: int, stratum: str) -> Draw:
        """The draw with this number in a target."""
        return Draw(target, index, seed, self.arms.get(target, ""), stratum)

    def repetition(self, index: int) -> int:
        """Which fault of its target and mission this one is: the address of its random stream has this number."""
        batch = next(batch for batch in reversed(self._batches) if batch.first <= index)
        return batch.repetition + (index - batch.first) // batch.missions

    def basis(self, environment: str, draw: Draw) -> tuple[Any, ...]:
        """What a fault depends on besides its golden run; campaigns in which it is equal draw the same fault."""
        repetition = self.repetition(draw.index)
        if not self.draws_together:
            return draw, repetition
        if environment not in self._companions:
            all_draws = draws_of(self.blocks(environment), range(self.campaign.missions))
            self._companions[environment] = Counter((other.seed, other.target) for _, other in all_draws)
        return draw, repetition, self._companions[environment][draw.seed, draw.target]

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: "MissionFlights", setup: "ArmSetup"
    ) -> Sampled:
        """Fly the golden run of the campaign's own mission, of a variant, or of an arm whose detector is injected.

        `draws`: the draws of this mission in it.
        """
        del draws, environment, setup
        return Sampled(flights.golden(arm, profile=self.profile))

    def draw(self, draws: Sequence[Draw], environment: str, golden: Golden) -> list[Fault | None]:
        """The faults of one mission, in the order of its draws; None = no fault can be drawn, and no run is planned.

        By default those that `golden` has drawn.
        """
        del environment
        # Each golden run has drawn its faults by target and stratum, in the order of the draws: take the next of each.
        undealt: dict[tuple[str, str, str], Iterator[Fault | None]] = {}
        for variant, sampled in golden.items():
            for (target, stratum), faults in sampled.faults.items():
                undealt[variant, target, stratum] = iter(faults)
        dealt: list[Fault | None] = []
        for draw in draws:
            faults_of_draw = undealt.get((draw.variant, draw.target, draw.stratum), iter(()))
            dealt.append(next(faults_of_draw, None))
        return dealt

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """The fault of a null run."""
        raise NotImplementedError


def draws_of(blocks: Sequence[FaultBlock], missions: range) -> list[tuple[int, Draw]]:
    """The draws of some missions of an environment, in plan order, each with its position.

    Args:
        blocks: Blocks of the environment.
        missions: Numbers of the missions, counted from 0.
    """
    draws = []
    for block in blocks:
        for mission in missions:
            for index in block.of_mission(mission):
                position = block.first + index * block.step
                draws.append((position, block.draw(index)))
    return sorted(draws, key=lambda pair: pair[0])


# ---- the level -------------------------------------------------------------------------------------------------------
class Level:
    """A fault level.  Only what a level can do is overridden; it needs `fault`, the type of its faults.

    Attributes:
        fault: Type of its planned faults; its `level` is the name of the entry point.
        sampling: Model of the key `sampling` in campaigns; None = no campaigns.
        sampler: Draws the faults of a campaign.
        local: Whether flights in this process have its faults: whether `inject` can attach one to the loop.
        can_wait: Whether its faults can wait for an event of the flight: they have a `time_us`, and an injector.
        form: Form of its text, for messages; "" = it has none.
        options: Options of the text in their order, by name: pattern, description and type of their values.
        operations: What its text may have instead of options, for messages: operations that it parses itself.
        reductions: How a fault is made smaller, in steps: by name of what is reduced, a function of a fault and its
            injection (None = not known) that yields candidates from the smallest on.
        absent: Words for an injection that did not happen: X in "the golden run never X it", and why nothing changed.
        corrupts_data: Whether its faults change data of a computation; a failing part changes what is measured or
            done, a failing link which messages arrive.
    """

    fault: ClassVar[type[Fault]]
    sampling: ClassVar[type[Sampling] | None] = None
    sampler: ClassVar[type[Sampler]]
    local: ClassVar[bool] = False
    can_wait: ClassVar[bool] = False
    form: ClassVar[str] = ""
    options: ClassVar[Mapping[str, tuple[str, str, type]]] = {}
    operations: ClassVar[tuple[str, ...]] = ()
    reductions: ClassVar[Mapping[str, Callable[[Any, Injection | None], Iterator[Fault]]]] = {}
    absent: ClassVar[tuple[str, str]] = ("reached", "the site was not reached")
    corrupts_data: ClassVar[bool] = True

    def parse(self, text: str, localization: str) -> Request:
        """The request in a text, given without the level; a BadInputError says what is wrong in it."""
        raise BadInputError(f"not understood; allowed: {_forms()}")

    def shipped_site(self, request: Any) -> bool:
        """Whether a request is for a site that mavfi brings, not for one of a user's own plug-in."""
        return True

    def text_of(self, fault: Any) -> str | None:
        """The text that names a fault in full; None = no mission of this process has it."""
        return None

    def seed_of(self, fault: Any) -> int | None:
        """The seed that a fault needs in addition to its text, for random choices during the flight; None = none."""
        return None

    def flies_from(self, fault: Any) -> FliesFrom:
        """Where flights with a fault are flown from: from take-off, unless nothing happens before it."""
        return FliesFrom.TAKE_OFF

    def inject(self, loop: "Loop", fault: Any, detector: "Detector | None") -> Injector:
        """Attach the fault to a flight, in the place of the tap `loop.taps.injector`; returns its injector.

        The flight has not started; or its tap has watched all earlier publications (`faults.acted_on.CounterWatch`).
        """
        raise NotImplementedError

    def wait(self, loop: "Loop", fault: Any, detector: "Detector | None") -> "Begin":
        """Prepare a flight for a fault that waits for an event; see `can_wait`."""
        loop.watch_losses()

        def begin(loop: "Loop", time_us: int) -> Injector:
            return self.inject(loop, replace(fault, time_us=time_us), detector)

        return begin

    def fly_forked(
        self, setup: "ArmSetup", fault: Any, detector: "Detector | None", *, records: bool = False
    ) -> "tuple[Flight, list[Published]]":
        """The flight with a fault that `flies_from` several calls; and its publications, if `records`."""
        raise NotImplementedError

    def columns(self, fault: Any) -> dict[str, Any]:
        """Columns of the table of runs for the site of a fault, see `analysis.rows`."""
        return {}

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """How a campaign draws, for the notes of tables: `each` (what `faults` counts), `how`, and further keys.

        `per_mission` is the number of faults in a mission in words, unless it is one; `stages` are those with faults,
        where a fault is in one of them.

        With `title` and `lines`, the level describes what is under test itself.
        """
        return {"each": "target", "how": ""}

    def not_understood(self) -> NoReturn:
        """Raise a BadInputError for a text that is not in the level's form."""
        raise BadInputError(f"not understood; allowed: {self.form}")

    def parts_of(self, text: str) -> FaultText:
        """The parts of a text, given without the level; a BadInputError names the one that is wrong."""
        # Split it: SITE:name=value:name=value@INSTANT.
        body, _, instant = text.partition("@")
        site, *rest = body.split(":")
        options: dict[str, Any] = {}
        for part in rest:
            name, equals, value = part.partition("=")
            if not equals and options:  # no name: this part belongs to the last value, which contains a colon
                name = next(reversed(options))
                value = f"{options[name]}:{part}"
            elif name in options:
                self.not_understood()
            options[name] = value
        if not site:
            self.not_understood()
        # Check names and values, then the order.
        for name, value in options.items():
            if name not in self.options:
                known = [*(f"{option}=" for option in self.options), *self.operations]
                raise BadInputError(not_known(name, known))
            pattern, description, kind = self.options[name]
            if not re.fullmatch(pattern, value):
                raise BadInputError(f"{name}: {value!r}: allowed: {description}")
            options[name] = kind(value)
        if list(options) != [name for name in self.options if name in options]:
            self.not_understood()
        return FaultText(site, options, instant_us(instant))


def instant_us(seconds: str) -> int | None:
    """An instant in text form (s), in us; "" = none is given."""
    if not seconds:
        return None
    if not re.fullmatch(_INSTANT, seconds):
        raise BadInputError(f"instant {seconds!r}: allowed: a number of seconds from 0 on, e.g. @12.5")
    if not float(seconds) <= LATEST_S:
        raise BadInputError(f"instant {seconds} s; allowed: 0 to {LATEST_S:g}")
    return round(float(seconds) * 1e6)


class ChangeFields(NamedTuple):
    """A change in the text of a fault, as faults hold it.

    Attributes:
        change: What is done, and when; without the following.
        bit: Bit of a flip; None = drawn.
        time_us: Earliest instant (us); None = drawn.
        lasts_s: Duration (s); 0 = as long as the change says.
    """

    change: Change
    bit: int | None
    time_us: int | None
    lasts_s: float


def parse_fields(text: str, default: str = "") -> ChangeFields:
    """The change that stands behind the site of a fault, see `faults.changes.parse_text`.

    Args:
        text: What is done, how often, and when.
        default: The operation if the text names none; "" = that is refused.
    """
    body, at, instant = text.partition("@")
    parts = body.split(":")
    if default and not body:
        parts = []
    names = {part.partition("=")[0] for part in parts}
    if default and not names & {*OPERATIONS, *SYNONYMS, "bit"}:
        parts = [default, *parts]
    change = parse_change(parts, instant)
    time_us = None
    if at:
        time_us = round(1e6 * change.when.start_s)
    return ChangeFields(change.without_fields(), change.operation.bit, time_us, change.lasts_s)


def operation_of(text: str) -> Change:
    """A change in the sampling of a campaign, which draws its instant.

    Raises:
        BadInputError: It has an instant, or is no operation.
    """
    if "@" in text:
        raise BadInputError(f"{text!r}: the instant is drawn; allowed: without @")
    return parse_text(text)


# ---- what the models of `sampling` share ----------------------------------------------------------------------
def check_known(key: str, names: Iterable[str], allowed: Collection[str]) -> None:
    """Raise a ValueError for a name that is not allowed."""
    for name in names:
        if key.endswith("kernels") and dropped_name("kernels", name):
            raise ValueError(f"{key}: {dropped_name('kernels', name)}")
        if name not in allowed:
            raise ValueError(f"{key}: {not_known(name, allowed)}")


def check_distinct(key: str, names: Iterable[str]) -> None:
    """Raise a ValueError for a name that occurs twice."""
    for name, count in Counter(names).items():
        if count > 1:
            raise ValueError(f"{key}: {name!r}: named {count} times; allowed: once")


def check_strata(strata: Mapping[str, float], *, by_class: bool = False) -> None:
    """Raise a ValueError for unknown strata, or shares that are not above 0.

    `by_class`: whether the level can draw a class of bits first, for the stratum `EACH_CLASS`.
    """
    check_known("sampling.strata", sorted(strata), [name for name in STRATA if by_class or name != EACH_CLASS])
    if not strata or not all(0 < share < float("inf") for share in strata.values()):
        raise ValueError(f"sampling.strata: {strata}: need at least one name, and shares above 0")


class Lifetime(Config):
    """Duration and width of state faults; by default one bit of one publication."""

    lasts_s: Annotated[float, Field(ge=0)] | Literal["inf"] = Field(
        0.0, description="stuck in every publication for this time (s, from 0 on); inf = for ever"
    )
    share: float = Field(1.0, gt=0, le=1, description="probability that a publication after the first one is changed")
    width: int = Field(1, ge=1, le=64, description="adjacent bits")
    times: int = Field(1, ge=1, description="publications, recomputed ones included, in which it is stuck at least")


class SiteGroup(Config):
    """Fields that share a row of a table; each fault is in one of them, drawn uniformly."""

    name: str
    sites: tuple[str, ...] = Field(min_length=1, description="state.field; of memories kernel.field")
    strata: dict[str, float] | None = Field(None, description="instead of the campaign's")
    lifetime: Lifetime | None = Field(
        None, description="instead of the campaign's; groups of the same sites then have the same draws"
    )


def group_json(data: dict[str, Any]) -> dict[str, Any]:
    """Plain data of a sampling with groups, without lifetimes that are not set."""
    for group in data["groups"]:
        if group["lifetime"] is None:
            del group["lifetime"]
    return data
