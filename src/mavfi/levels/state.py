"""Faults in inter-kernel states: one bit of one field of one publication, or of several.

As text: `null`, `state:planning.waypoint.x`, `state:planning.trajectory.x[3]:bit=62@5.0`,
`state:control.command.vx:set=nan@10..12` (see `faults.operations`).

In campaigns: `stage_balanced`, the paper's equal number per stage, groups of fields, or messages.  The shares of the
bit strata are exact, their order is drawn from the seed; each fault has a separate random stream.
"""

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field as Key
from pydantic import model_validator

from mavfi.config import Config
from mavfi.errors import BadInputError
from mavfi.faults.changes import Change, is_change, parse_text
from mavfi.faults.fault import LIFETIME, Fault, FaultSite, StateFault
from mavfi.faults.injector import Injector
from mavfi.faults.levels.state_injector import injector_of
from mavfi.faults.operations import VALUE_OPERATIONS, Operation, check_number_operation
from mavfi.faults.sampling import (
    Target,
    When,
    draw,
    draw_in_message,
    draw_publication,
    group_target,
    live_fields,
    message_target,
    published_target,
    stage_target,
    stream,
)
from mavfi.faults.strata import EACH_CLASS, HEADLINE, WHOLE_WORD, WORD_BITS, WORDS, bits_of
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import (
    DECIMAL,
    SECONDS,
    WHOLE,
    Draw,
    Golden,
    Level,
    Sampler,
    Sampling,
    check_distinct,
    check_known,
    check_strata,
    operation_of,
    parse_value_change,
)
from mavfi.record import Injection, Profile
from mavfi.states import PPC_STAGES, STATES, Field, StateSpec, states_with, unknown

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, Flight

_SITE = re.compile(r"(?P<path>[^\[\]]+)(\[(?P<element>\d+)\])?")
"""A site in the text of a fault: path of the state or field, and index of a list element."""
_SHORTER_PARTS = (0.125, 0.25, 0.5)
"""Parts of a fault's duration that `shorter_faults` tries."""
_SHORTER_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Numbers of corrupted publications that `shorter_faults` tries."""


class ParsedSite(NamedTuple):
    """A state, the name of a field, and the index of an element, as given in a text; None = not dated_change."""

    state: StateSpec
    field: str | None
    element: int | None


@dataclass(frozen=True, slots=True)
class StateRequest:
    """A fault in a state as requested by the user: field, list element, bit, earliest instant; None is drawn.

    A null fault flips nothing; `lifetime` has the given keys of `fault.LIFETIME`; `also` and `change` as in
    `StateFault`.
    """

    state: StateSpec
    field: str | None = None
    element: int | None = None
    bit: int | None = None
    time_us: int | None = None
    null: bool = False
    lifetime: Mapping[str, Any] = dataclasses.field(default_factory=dict, hash=False)
    also: tuple[tuple[str, int], ...] = ()
    change: Change | None = None

    @property
    def needs_profile(self) -> bool:
        """Whether the golden run is needed first, to draw from its publications."""
        some_element = bool(self.state.elements) and self.element is None
        return self.time_us is None or some_element

    def draw(self, setup: "ArmSetup", seed: int) -> "tuple[StateFault, Flight | None]":
        """See `Request.draw`."""
        from mavfi.flight.fly import fly

        autopilot = setup.scenario.autopilot.name
        if not self.needs_profile:
            return self.resolve(seed, autopilot), None
        golden = fly(setup.scenario, profile=True)
        return self.resolve(seed, autopilot, golden.profile), golden

    def resolve(self, seed: int, autopilot: str, profile: Profile | None = None) -> StateFault:
        """Draw what was not given; bits uniformly from the whole word.

        Args:
            seed: Seed of the fault.
            autopilot: Name of the autopilot profile; a field without consumers is injected only if requested.
            profile: Publications of the golden run, if `needs_profile`.
        """
        random = stream(seed, "spec", self.state.name)
        field = self._field(random, autopilot)
        width = self.lifetime.get("width", 1)
        # Publication and element.
        site = FaultSite(self.state.name, field.name, self.element)
        time_us = self.time_us or 0
        if self.needs_profile:
            drawn_us, element = draw_publication(random, self._publications_for_element(profile or Profile()), site)
            site = FaultSite(self.state.name, field.name, element)
            if self.time_us is None:
                time_us = drawn_us
        # Bit; a null fault draws one, too, and flips none.
        bit = self.bit
        if bit is None:
            bit = int(random.integers(WORD_BITS[field.dtype] - width + 1))
        if self.null or (self.change is not None and self.change.operation.name != "flip"):
            bit = None
        return StateFault(site, time_us, bit, seed=seed, also=self.also, change=self.change, **self.lifetime)

    def _field(self, random: np.random.Generator, autopilot: str) -> Field:
        """The requested field, or one that has the requested element and bits."""
        if self.field is not None:
            return self.state.find(self.field)
        fields = [self.state.find(name) for name in live_fields(self.state, autopilot)]
        if self.element is not None:
            fields = [field for field in fields if self.state.in_elements(field.name)]
        bits = (self.bit or 0) + self.lifetime.get("width", 1)
        fields = [field for field in fields if bits <= WORD_BITS[field.dtype]]
        if self.change is not None:
            fields = [field for field in fields if accepts(field, self.change.operation)]
            if not fields:
                raise BadInputError(f"{self.change.operation}: no field of {self.state.name} can be changed so")
        return fields[int(random.integers(len(fields)))]

    def _publications_for_element(self, profile: Profile) -> Profile:
        """The publications from which the element is drawn: with a requested time, the first one from then on only."""
        name = self.state.name
        if self.time_us is None or name not in profile.times_us:
            return profile
        times_us = profile.times_us[name]
        counts = profile.counts[name]
        first = np.flatnonzero((times_us >= self.time_us) & (counts > 0))[:1]
        return Profile({name: times_us[first]}, {name: counts[first]})


def accepts(field: Field, operation: Operation) -> bool:
    """Whether a number of this type can be changed in this way."""
    if operation.name == "freeze":
        return True
    try:
        check_number_operation(operation, field.dtype)
    except BadInputError:
        return False
    return True


class Lifetime(Config):
    """Duration and width of state faults; by default one bit of one publication."""

    lasts_s: Annotated[float, Key(ge=0)] | Literal["inf"] = Key(
        0.0, description="stuck in every publication for this time (s, from 0 on); inf = for ever"
    )
    share: float = Key(1.0, gt=0, le=1, description="probability that a publication after the first one is changed")
    width: int = Key(1, ge=1, le=64, description="adjacent bits")
    times: int = Key(1, ge=1, description="publications, recomputed ones included, in which it is stuck at least")


class SiteGroup(Config):
    """Fields that share a row of a table; each fault is in one of them, drawn uniformly."""

    name: str
    sites: tuple[str, ...] = Key(min_length=1, description="state.field; of memories kernel.field")
    strata: dict[str, float] | None = Key(None, description="instead of the campaign's")
    lifetime: Lifetime | None = Key(
        None, description="instead of the campaign's; groups of the same sites then have the same draws"
    )


def group_json(data: dict[str, Any]) -> dict[str, Any]:
    """Plain data of a sampling with groups, without lifetimes that are not set."""
    for group in data["groups"]:
        if group["lifetime"] is None:
            del group["lifetime"]
    return data


class StateSampling(Sampling):
    """Faults in inter-kernel states: one bit of one field of one publication."""

    level: Literal["state"] = "state"
    scheme: Literal["stage_balanced", "groups", "messages"] = Key(
        "stage_balanced",
        description="`faults` for each stage (the paper's scheme), each group, or each message, uniform over its bits",
    )
    sites: Literal["all", "monitored", "published"] = Key(
        "all",
        description="fields that stage_balanced draws from: all that are read; those of the monitored set; or those "
        "that the authors' injector of states can change, read or not",
    )
    groups: tuple[SiteGroup, ...] = ()
    messages: tuple[str, ...] = Key((), description="names of states, for scheme messages")
    strata: dict[str, float] = Key(
        default_factory=lambda: {"sign_exponent": 2.0, "mantissa": 1.0}, description="shares of the faults by bit class"
    )
    lifetime: Lifetime = Lifetime()
    when: When = Key(
        "uniform",
        description="publication that is hit: each with the same probability; `published`: as by the authors' injector "
        "of states (the first from the first collision status on, a coin per finished plan, 1 in 100 commands); "
        "`second_plan`: the first from the second plan on; no site if the golden flight has none",
    )
    together: bool = Key(
        False,
        description="a drawn component of a vector (x y z, vx vy vz or ax ay az) is hit with the two others, each in a "
        "bit of its own of the same stratum",
    )

    operations: tuple[str, ...] = Key(
        (),
        description="what happens to the drawn field from the drawn publication on, each with the same probability: "
        "flip, set=VALUE, bias=, scale=, freeze, with times=, every=, share=, e.g. set=nan:times=3; by default flips",
    )

    @model_validator(mode="after")
    def _consistent(self) -> "StateSampling":
        """Check that the keys belong to the scheme, and that names are known and distinct."""
        for key, value in (("groups", self.groups), ("messages", self.messages)):
            if value and self.scheme != key:
                raise ValueError(f"sampling.scheme: {self.scheme!r}: allowed with the key {key}: {key}")
            if not value and self.scheme == key:
                raise ValueError(f"sampling.{key}: is required with scheme {key!r}; allowed: a list of 1 or more")
        if self.sites == "published" and self.scheme != "stage_balanced":
            raise ValueError("sampling.sites: 'published': allowed with scheme stage_balanced")
        check_known("sampling.messages", self.messages, STATES)
        check_distinct("sampling.messages", self.messages)
        check_distinct("sampling.groups", [group.name for group in self.groups])
        lifetimes = [self.lifetime, *(group.lifetime for group in self.groups if group.lifetime is not None)]
        if self.together and (self.scheme == "messages" or any(lifetime != Lifetime() for lifetime in lifetimes)):
            raise ValueError(
                "sampling.together: true: allowed with scheme stage_balanced or groups, and without a lifetime"
            )
        if self.operations and (
            self.together or self.scheme == "messages" or any(lifetime != Lifetime() for lifetime in lifetimes)
        ):
            raise ValueError(
                "sampling.operations: allowed with scheme stage_balanced or groups, without together and a lifetime"
            )
        for text in self.operations:
            _check_operation(text)
        for strata in (self.strata, *(group.strata for group in self.groups if group.strata is not None)):
            check_strata(strata, by_class=self.scheme != "messages")
        return self

    def to_json(self) -> dict[str, Any]:
        """See `Sampling.to_json`."""
        data = group_json(self.model_dump(mode="json"))
        if self.lifetime == Lifetime():
            del data["lifetime"]
        if not self.messages:
            del data["messages"]
        if self.when == "uniform":
            del data["when"]
        if not self.together:
            del data["together"]
        if not self.operations:
            del data["operations"]
        return data


class StateSampler(Sampler):
    """Draws one bit of one field of one publication.

    Raises:
        BadInputError: A target has no bits in one of its strata.
    """

    profile = True
    draws_together = False

    def __init__(self, campaign: SampledCampaign) -> None:
        super().__init__(campaign)
        spec = campaign.first_mission
        # What exists and is acted on depends on the mission.
        self._autopilot = spec.autopilot
        self._localization = spec.localization
        # Targets by name, and those whose draws each one uses.
        targets = self._find_targets()
        self._fields = {target.name: target for target, _ in targets}
        self._lifetimes = {group.name: group.lifetime for group in self.sampling.groups if group.lifetime}
        self.targets = {target.name: shares for target, shares in targets}
        self.orders = {name: self._draws_like(name) for name in self.targets}
        self._check_when()
        # A target without bits in one of its strata is an error now, not after the first flights.
        for target, shares in targets:
            for stratum in shares:
                target.within(stratum)

    def _find_targets(self) -> list[tuple[Target, Mapping[str, float]]]:
        """The targets in the order of the plan, each with the shares of its strata; fields allow all operations."""
        operations = [operation_of(text).operation for text in self.sampling.operations]
        return [(_accepting(target, operations), shares) for target, shares in self._find_scheme_targets()]

    def _find_scheme_targets(self) -> list[tuple[Target, Mapping[str, float]]]:
        """The targets of the scheme in the order of the plan, each with the shares of its strata."""
        sampling = self.sampling
        if sampling.scheme == "groups":
            return [(self._group(i), group.strata or sampling.strata) for i, group in enumerate(sampling.groups)]
        if sampling.scheme == "messages":
            return [self._message(state) for state in sampling.messages]
        if sampling.sites == "published":
            return [(published_target(stage), sampling.strata) for stage in PPC_STAGES]
        monitored = None
        if sampling.sites == "monitored":
            monitored = self.campaign.monitored_set
        return [
            (stage_target(stage, self._autopilot, monitored, self._localization), sampling.strata)
            for stage in PPC_STAGES
        ]

    def _check_when(self) -> None:
        """Refuse `published` for states of other stages than those in which the authors inject."""
        states = [state for target in self._fields.values() for state in target.fields]
        for state in states:
            if self.sampling.when == "published" and STATES[state].stage not in PPC_STAGES:
                raise BadInputError(
                    f"sampling.when: 'published': {state}: the authors inject no such state; allowed: states of "
                    f"{', '.join(PPC_STAGES)}"
                )

    def _group(self, index: int) -> Target:
        """The fields of a group; an error names the group by its index."""
        group = self.sampling.groups[index]
        try:
            return group_target(group.name, group.sites, self._localization)
        except BadInputError as error:
            raise BadInputError(f"sampling.groups.{index}.sites: {error}") from None

    def _message(self, state: str) -> tuple[Target, Mapping[str, float]]:
        """A message, with the shares of those strata that it has."""
        if not STATES[state].exists_with(self._localization):
            raise BadInputError(
                f"sampling.messages: {state}: only flights with localization {STATES[state].only_with} publish it"
            )
        target = message_target(state)
        fields = [STATES[state].find(name) for name in target.fields[state]]
        shares = {}
        for stratum, share in self.sampling.strata.items():
            if any(bits_of(field, stratum) for field in fields):
                shares[stratum] = share
        return target, shares or self.sampling.strata

    def _draws_like(self, name: str) -> str:
        """Name of the target whose random draws a target uses: its own, or those of the first one with the same fields.

        So groups that differ in their lifetime only are compared on the same fields, bits and instants.
        """
        if name not in self._lifetimes:
            return name
        fields = self._fields[name].fields
        return next(other for other, target in self._fields.items() if target.fields == fields)

    def blocks(self, environment: str) -> Sequence[Any]:
        """See `Sampler.blocks`; parts of a campaign in the same environment have the same draws."""
        return super().blocks(self.campaign.environment_of(environment))

    def draw(self, draws: Sequence[Draw], environment: str, golden: Golden) -> list[Fault | None]:
        """Draw from the profile of the golden run; without one, faults have no site."""
        profile = _profile(golden)
        return [self._fault(requested, profile, environment) for requested in draws]

    def _fault(self, requested: Draw, profile: Profile, environment: str) -> StateFault:
        """The fault of a draw, with the lifetime of its target."""
        # Faults of the same seed differ by environment, and by how often the target's missions have been used before.
        seed_environment = self.campaign.environment_of(environment)
        repetition = self.repetition(requested.index)
        stratum = requested.stratum
        seed = requested.seed
        when = self.sampling.when
        if self.sampling.scheme == "messages":
            fault = draw_in_message(requested.target, stratum, profile, seed, seed_environment, repetition, when=when)
        else:
            target = self._fields[self.orders[requested.target]]
            together = self.sampling.together
            fault = draw(target, stratum, profile, seed, seed_environment, repetition, when=when, together=together)
        if self.sampling.operations:
            random = stream(seed, "operation", requested.target, seed_environment, repetition)
            operations = self.sampling.operations
            return _with_operation(fault, operation_of(operations[int(random.integers(len(operations)))]))
        return self._with_lifetime(requested.target, fault)

    def _with_lifetime(self, target: str, fault: StateFault) -> StateFault:
        """A fault with the lifetime of its target; a burst that exceeds its word starts at a lower bit."""
        lifetime = (self._lifetimes.get(target) or self.sampling.lifetime).model_dump()
        bits = WORD_BITS[_dtype(fault)]
        width = min(lifetime["width"], bits)
        bit = fault.bit
        if bit is not None:
            bit = min(bit, bits - width)
        return replace(fault, **{**lifetime, "lasts_s": float(lifetime["lasts_s"]), "width": width, "bit": bit})

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """A fault with an empty mask; stages alternate."""
        environment = self.campaign.environment_of(environment)
        return null_fault(index, seed, environment, golden, self._autopilot, self._localization)


def null_fault(
    index: int, seed: int, environment: str, golden: Golden, autopilot: str, localization: str
) -> StateFault:
    """A fault in a state with an empty mask; stages alternate by `index`."""
    stage = PPC_STAGES[index % len(PPC_STAGES)]
    target = stage_target(stage, autopilot, localization=localization)
    fault = draw(target, HEADLINE, _profile(golden), seed, environment, index)
    return replace(fault, bit=None, stratum="", weight=1.0)


def _check_operation(text: str) -> None:
    """Raise a ValueError for an operation that changes no value, or names a bit: bits are drawn."""
    try:
        change = operation_of(text)
    except BadInputError as error:
        raise ValueError(f"sampling.operations: {error}") from None
    if change.operation.name not in VALUE_OPERATIONS or change.operation.bit is not None:
        allowed = ", ".join(VALUE_OPERATIONS)
        raise ValueError(f"sampling.operations: {text!r}: changes no drawn value; allowed: {allowed}")


def _accepting(target: Target, operations: Sequence[Operation]) -> Target:
    """The fields of a target that allow all operations; raises a BadInputError if there are none."""
    fields = {}
    for state, names in target.fields.items():
        spec = STATES[state]
        allowed = tuple(name for name in names if all(accepts(spec.find(name), operation) for operation in operations))
        if allowed:
            fields[state] = allowed
    if not fields:
        raise BadInputError(f"sampling.operations: {target.name}: has no field that allows all of them")
    return Target(target.name, fields)


def _with_operation(fault: StateFault, change: Change) -> StateFault:
    """A drawn fault with another change than the flip of its bit in one publication."""
    if change == parse_text("flip"):
        return fault
    if change.operation.name == "flip":
        return replace(fault, change=change)
    return replace(fault, bit=None, stratum="", weight=1.0, change=change)


def _profile(golden: Golden) -> Profile:
    """Publications of the golden run; none without it."""
    if "" not in golden or golden[""].flight.profile is None:
        return Profile()
    return golden[""].flight.profile


def _dtype(fault: StateFault) -> str:
    """Type of the field."""
    return STATES[fault.where.state].find(fault.where.field).dtype


def fewer_fields(fault: StateFault, _: Injection | None) -> Iterator[Fault]:
    """Faults in fewer fields for one in several: in each field alone, then in two of them, and so on."""
    if fault.bit is None:
        return
    flips = [(fault.where.field, fault.bit), *fault.also]
    for count in range(1, len(flips)):
        for (name, bit), *others in combinations(flips, count):
            where = replace(fault.where, field=name)
            yield replace(fault, where=where, bit=bit, also=tuple(others), stratum="", weight=1.0)


def shorter_faults(fault: StateFault, _: Injection | None) -> Iterator[Fault]:
    """Shorter faults for a lasting one: by increasing number of publications, then fractions of its duration."""
    if not fault.lasting:
        return
    if fault.change is not None:
        yield from fewer_changes(fault, fault.change)
        return
    once = replace(fault, lasts_s=0.0, share=1.0, times=1)
    for times in _SHORTER_COUNTS:
        if fault.lasts_s > 0 or times < fault.times:
            yield replace(once, times=times)
    if 0 < fault.lasts_s < float("inf"):
        for part in _SHORTER_PARTS:
            yield replace(fault, lasts_s=round(fault.lasts_s * part, 3))


def fewer_changes(fault: Any, change: Change) -> Iterator[Fault]:
    """Faults of levels state and message that change fewer publications than one that lasts, by increasing number."""
    for times in _SHORTER_COUNTS:
        if change.when.times == 0 or times < change.when.times:
            yield replace(fault, change=change._replace(when=replace(change.when, times=times)))


def single_bit_faults(fault: StateFault, _: Injection | None) -> Iterator[Fault]:
    """Single-bit faults for a multi-bit one."""
    if fault.bit is not None and fault.width > 1:
        for offset in range(fault.width):
            yield replace(fault, bit=fault.bit + offset, width=1)


def smaller_changes(fault: Any, injection: Injection | None) -> Iterator[Fault]:
    """Faults in other bits of the word, of a state or a memory, that change its value less."""
    if fault.bit is None:
        return
    if isinstance(fault, StateFault):
        dtype = _dtype(fault)
    else:
        dtype = fault.dtype
    before = None
    if injection is not None:
        before = injection.before
    sizes = {bit: change_of(before, dtype, bit) for bit in range(WORD_BITS[dtype])}
    smaller = [bit for bit, size in sizes.items() if size < sizes[fault.bit]]
    for bit in sorted(smaller, key=lambda bit: sizes[bit]):
        yield replace(fault, bit=bit, stratum="", weight=1.0)


def change_of(before: object, dtype: str, bit: int) -> float:
    """Absolute change of a value by a bit flip; infinite if not finite, the bit's index if the value is unknown."""
    if not isinstance(before, (int, float)):
        return float(bit)
    if dtype == "?":
        dtype = "u1"  # flags have no arithmetic
    size = np.dtype(dtype).itemsize
    word = np.array([before]).astype(dtype)
    flipped = (word.view(f"u{size}") ^ np.array(1 << bit, f"u{size}")).view(word.dtype)
    change = abs(float(flipped[0]) - float(word[0]))
    if np.isfinite(change):
        return change
    return float("inf")


class StateLevel(Level):
    """Faults in inter-kernel states."""

    fault = StateFault
    sampling = StateSampling
    sampler = StateSampler
    local = True
    form = (
        "state:STATE[.FIELD][[ELEMENT]][:bit=N][:also=FIELD.N[+...]][:width=N][:times=N][:lasts=S][:share=P][@SECONDS]"
        " or state:STATE[.FIELD][[ELEMENT]]:OPERATION[:times=N][:every=N][:share=P][:lasts=S][@INSTANT]"
    )
    options = {
        "bit": WHOLE,
        "also": (r"\w+\.\d{1,4}(\+\w+\.\d{1,4})*", "further fields and their bits, e.g. y.60+z.3", str),
        "width": WHOLE,
        "times": WHOLE,
        "lasts": SECONDS,
        "share": (DECIMAL, "a number above 0, to 1", float),
    }
    operations = VALUE_OPERATIONS
    reductions = {
        "fields": fewer_fields,
        "publications": shorter_faults,
        "width": single_bit_faults,
        "bit": smaller_changes,
    }
    absent = ("published", "no such publication came")

    def null(self) -> StateRequest:
        """The null fault: the empty mask on the way-point in force."""
        return StateRequest(STATES["planning.waypoint"], "x", null=True)

    def parse(self, text: str, localization: str) -> StateRequest:
        """See `Level.parse`."""
        if is_change(text):
            return self._parse_operation(text, localization)
        parts = self.parts_of(text)
        spec, field, element = self._parse_site(parts.site, localization)
        site_name = spec.name
        fields = spec.fields
        if field is not None:
            site_name = f"{spec.name}.{field}"
            fields = (spec.find(field),)
        # Bits and duration.
        bits = max(WORD_BITS[candidate.dtype] for candidate in fields)
        lifetime = dict(parts.options)
        bit = lifetime.pop("bit", None)
        also = _further_fields(lifetime.pop("also", ""))
        if also and (field is None or bit is None):
            raise BadInputError("also: goes with a field and its bit; allowed: FIELD:bit=N:also=...")
        last = (bit or 0) + lifetime.get("width", 1) - 1
        if last >= bits:
            raise BadInputError(f"no bit {last} in {site_name}; allowed: 0 to {bits - 1}")
        if "lasts" in lifetime:
            lifetime["lasts_s"] = lifetime.pop("lasts")
        StateFault(FaultSite(spec.name, field or spec.fields[0].name), bit=bit, also=also, **lifetime)  # checks them
        return StateRequest(spec, field, element, bit, parts.time_us, lifetime=lifetime, also=also)

    def _parse_site(self, text: str, localization: str) -> ParsedSite:
        """A state or a field of it, and an element."""
        match = _SITE.fullmatch(text)
        if match is None:
            self.not_understood()
        spec, field = _find_state(match["path"], localization)
        if match["element"] is None:
            return ParsedSite(spec, field, None)
        site_name = spec.name
        has_elements = bool(spec.elements)
        if field is not None:
            site_name = f"{spec.name}.{field}"
            has_elements = spec.in_elements(field)
        element = int(match["element"])
        if not has_elements:
            raise BadInputError(f"element [{element}]: {site_name} is no list; allowed: no element")
        return ParsedSite(spec, field, element)

    def _parse_operation(self, text: str, localization: str) -> StateRequest:
        """A fault that changes a value by an operation, or in publications that a trigger selects."""
        body, at, instant = text.partition("@")
        site, *parts = body.split(":")
        spec, field, element = self._parse_site(site, localization)

        dated_change = parse_value_change(parts, instant)
        bit = dated_change.operation.bit
        change = dated_change.without_fields()
        time_us = None
        if at:
            time_us = round(1e6 * dated_change.when.start_s)
        lifetime: dict[str, Any] = {}
        if dated_change.lasts_s > 0.0:
            lifetime["lasts_s"] = dated_change.lasts_s

        # A bit that is not given is drawn.
        checked_bit = bit
        if change.operation.name == "flip" and bit is None:
            checked_bit = 0
        # Without a field, one that allows the operation is drawn.
        checked_field = field
        if field is None:
            checked_field = next((each.name for each in spec.fields if accepts(each, change.operation)), None)
        checked_site = FaultSite(spec.name, checked_field or spec.fields[0].name)
        StateFault(checked_site, bit=checked_bit, change=change, **lifetime)  # checks all of it
        return StateRequest(spec, field, element, bit, time_us, lifetime=lifetime, change=change)

    def text_of(self, fault: StateFault) -> str:
        """See `Level.text_of`."""
        if fault.change is not None:
            return f"state:{fault.where}:{fault.change.with_fields(fault.bit, fault.time_us, fault.lasts_s)}"
        options = ""
        if fault.bit is not None:
            options = f":bit={fault.bit}"
        if fault.also:
            options += f":also={'+'.join(f'{name}.{bit}' for name, bit in fault.also)}"
        for name in ("width", "times", "lasts_s", "share"):
            value = getattr(fault, name)
            if value != LIFETIME[name]:
                options += f":{name.removesuffix('_s')}={value}"
        return f"state:{fault.where}{options}@{fault.time_us / 1e6}"

    def seed_of(self, fault: StateFault) -> int | None:
        """See `Level.seed_of`: an intermittent fault draws its publications."""
        if fault.share < 1.0 or (fault.change is not None and fault.change.when.share < 1.0):
            return fault.seed
        return None

    def inject(self, loop: Any, fault: StateFault, detector: Any) -> Injector:
        """See `Level.inject`."""
        injector = loop.taps.injector = injector_of(fault)
        loop.watch_losses()
        return injector

    def columns(self, fault: StateFault) -> dict[str, Any]:
        """See `Level.columns`."""
        site = fault.where
        spec = STATES[fault.where.state]
        columns: dict[str, Any] = {
            "stage": str(spec.stage),
            "kernel": spec.writer,
            "state": site.state,
            "field": site.field,
            "element": site.element,
        }
        if fault.change is not None:
            columns["operation"] = fault.change.name
        elif fault.bit is not None:
            columns["operation"] = "flip"
        # what is drawn from all bits is the population of faults without strata
        if fault.stratum not in (WHOLE_WORD, EACH_CLASS):
            columns["population"] = fault.stratum
        return columns

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`."""
        sampling = campaign.sampling
        unit = {"stage_balanced": "stage", "groups": "group", "messages": "message"}[sampling.scheme]
        shares = sorted(sampling.strata.items(), reverse=True)
        strata = " : ".join(f"{WORDS.get(name, name)} {share:g}" for name, share in shares)
        how = f"drawn {strata}, fields: {sampling.sites}"
        if sampling.groups and all(group.strata is not None for group in sampling.groups):
            how = "drawn from the bits that each group names"
        if sampling.when != "uniform":
            how += f", publications: {sampling.when}"
        about: dict[str, Any] = {"each": unit, "how": how}
        if sampling.scheme == "stage_balanced":
            about["stages"] = list(PPC_STAGES)
        return about


def _further_fields(text: str) -> tuple[tuple[str, int], ...]:
    """Further fields and their bits, from the option `also`; "" = none."""
    if not text:
        return ()
    flips = []
    for part in text.split("+"):
        name, _, bit = part.partition(".")
        flips.append((name, int(bit)))
    return tuple(flips)


def find_published(name: str, localization: str) -> StateSpec:
    """A state that is published with this localization, or a BadInputError."""
    published = states_with(localization)
    if name not in STATES:
        raise BadInputError(unknown("state", name, published))
    if name not in published:
        only = STATES[name].only_with
        raise BadInputError(f"{name} is published with localization {only} only, not {localization}")
    return published[name]


def _find_state(path: str, localization: str) -> tuple[StateSpec, str | None]:
    """State and field of a path "STATE.FIELD", or "STATE" alone; names contain dots."""
    state = path
    field = ""
    if path not in STATES:
        state, _, field = path.rpartition(".")
    if state not in STATES:
        raise BadInputError(unknown("state", path, states_with(localization)))
    spec = find_published(state, localization)
    if not field:
        return spec, None
    return spec, spec.find(field).name
