"""Faults in inter-kernel states of a campaign.

`stage_balanced`, the paper's equal number per stage, groups of fields, or messages.  The shares of the bit strata are
exact, their order is drawn from the seed; each fault has a separate random stream.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

from pydantic import Field as Key
from pydantic import model_validator

from mavfi.errors import BadInputError
from mavfi.faults.changes import Change, parse_text
from mavfi.faults.fault import Fault
from mavfi.faults.operations import VALUE_OPERATIONS, Operation
from mavfi.faults.sampling import When, stream
from mavfi.faults.strata import HEADLINE, WORD_BITS, bits_of
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import (
    Draw,
    Golden,
    Lifetime,
    Sampler,
    Sampling,
    SiteGroup,
    check_distinct,
    check_known,
    check_strata,
    group_json,
    operation_of,
    profile_of,
)
from mavfi.levels.state.drawing import (
    FieldTarget,
    draw,
    draw_in_message,
    group_target,
    message_target,
    published_target,
    stage_target,
)
from mavfi.levels.state.fault import StateFault
from mavfi.levels.state.request import accepts
from mavfi.record import Profile
from mavfi.states import PPC_STAGES, STATES


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

    def _find_targets(self) -> list[tuple[FieldTarget, Mapping[str, float]]]:
        """The targets in the order of the plan, each with the shares of its strata; fields allow all operations."""
        operations = [operation_of(text).operation for text in self.sampling.operations]
        return [(_accepting(target, operations), shares) for target, shares in self._find_scheme_targets()]

    def _find_scheme_targets(self) -> list[tuple[FieldTarget, Mapping[str, float]]]:
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

    def _group(self, index: int) -> FieldTarget:
        """The fields of a group; an error names the group by its index."""
        group = self.sampling.groups[index]
        try:
            return group_target(group.name, group.sites, self._localization)
        except BadInputError as error:
            raise BadInputError(f"sampling.groups.{index}.sites: {error}") from None

    def _message(self, state: str) -> tuple[FieldTarget, Mapping[str, float]]:
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
        profile = profile_of(golden)
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
        bits = WORD_BITS[fault.dtype]
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
    fault = draw(target, HEADLINE, profile_of(golden), seed, environment, index)
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


def _accepting(target: FieldTarget, operations: Sequence[Operation]) -> FieldTarget:
    """The fields of a target that allow all operations; raises a BadInputError if there are none."""
    fields = {}
    for state, names in target.fields.items():
        spec = STATES[state]
        allowed = tuple(name for name in names if all(accepts(spec.find(name), operation) for operation in operations))
        if allowed:
            fields[state] = allowed
    if not fields:
        raise BadInputError(f"sampling.operations: {target.name}: has no field that allows all of them")
    return FieldTarget(target.name, fields)


def _with_operation(fault: StateFault, change: Change) -> StateFault:
    """A drawn fault with another change than the flip of its bit in one publication."""
    if change == parse_text("flip"):
        return fault
    if change.operation.name == "flip":
        return replace(fault, change=change)
    return replace(fault, bit=None, stratum="", weight=1.0, change=change)
