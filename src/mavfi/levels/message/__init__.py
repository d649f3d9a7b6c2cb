"""Faults in whole publications of inter-kernel states: lost, late, repeated, frozen, out of order.

As text: `message:planning.trajectory:drop@10..12`, `message:control.command:delay=0.2:times=20@10`.

In campaigns: `faults` for each state; the publication is drawn from those of the golden run, the operation from those
of the sampling.  Hosts of other programs draw faults in the messages of these (see `Host.samplings`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field, model_validator

from mavfi.errors import BadInputError
from mavfi.faults.changes import Change, split_site
from mavfi.faults.fault import NO_SITE, Fault, FaultSite, FliesFrom, find_level
from mavfi.faults.fields import find_field, find_published
from mavfi.faults.operations import MESSAGE_OPERATIONS
from mavfi.faults.sampling import draw_publication, stream
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import (
    Draw,
    Golden,
    Level,
    Sampler,
    Sampling,
    check_distinct,
    check_known,
    operation_of,
    parse_fields,
    profile_of,
)
from mavfi.levels.message.fault import MessageFault
from mavfi.levels.message.injector import PublicationInjector
from mavfi.levels.smaller import fewer_changes
from mavfi.record import Injection, Profile
from mavfi.states import PPC_STAGES, STATES, states_with

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, Flight

_FORM = "message:STATE:OPERATION[:times=N][:every=N][:share=P][@INSTANT]"


@dataclass(frozen=True, slots=True)
class MessageRequest:
    """A fault in publications as requested by the user: state, change, earliest instant (us); None is drawn."""

    state: str
    change: Change
    time_us: int | None

    def draw(self, setup: "ArmSetup", seed: int) -> "tuple[MessageFault, Flight | None]":
        """See `Request.draw`."""
        from mavfi.flight.fly import fly

        if self.time_us is not None:
            return self.resolve(seed), None
        golden = fly(setup.scenario, profile=True)
        return self.resolve(seed, golden.profile), golden

    def resolve(self, seed: int, profile: Profile | None = None, *address: int | str) -> MessageFault:
        """The fault; an instant that was not given is that of a publication of the golden run."""
        time_us = self.time_us
        if time_us is None:
            random = stream(seed, "publication", self.state, *address)
            site = FaultSite(self.state, STATES[self.state].header[0].name)
            time_us, _ = draw_publication(random, profile or Profile(), site)
        return MessageFault(self.state, seed=seed, time_us=time_us, change=self.change)


class MessageSampling(Sampling):
    """Faults in whole publications of inter-kernel states."""

    level: Literal["message"]
    states: tuple[str, ...] = Field(
        (), description="`faults` for each; by default all of perception, planning and control"
    )
    operations: tuple[str, ...] = Field(
        ("drop",),
        min_length=1,
        description=f"each with the same probability, as behind the site of a fault: {', '.join(MESSAGE_OPERATIONS)}, "
        "e.g. delay=0.2:times=10",
    )

    @model_validator(mode="after")
    def _consistent(self) -> "MessageSampling":
        """Check names and operations."""
        check_known("sampling.states", self.states, STATES)
        check_distinct("sampling.states", self.states)
        for text in self.operations:
            try:
                MessageFault(next(iter(STATES)), change=operation_of(text))
            except BadInputError as error:
                raise ValueError(f"sampling.operations: {text!r}: {error}") from None
        return self


class MessageSampler(Sampler):
    """Draws a publication of a state, and what happens to it.

    Raises:
        BadInputError: The mission publishes no such state.
    """

    profile = True
    draws_together = False

    def __init__(self, campaign: SampledCampaign) -> None:
        super().__init__(campaign)
        self._spec = campaign.first_mission
        published = states_with(self._spec.localization)
        names = self.sampling.states
        if not names:
            names = tuple(spec.name for spec in published.values() if spec.stage in PPC_STAGES)
        for name in names:
            find_published(name, self._spec.localization)
        self.targets = dict.fromkeys(names, {"": 1.0})

    def draw(self, draws: Sequence[Draw], environment: str, golden: Golden) -> list[Fault | None]:
        """Draw from the profile of the golden run; without one, faults have no site."""
        return [self._fault(requested, environment, golden) for requested in draws]

    def _fault(self, requested: Draw, environment: str, golden: Golden) -> MessageFault:
        """The fault of a draw; those of one mission differ by environment and by how often it was used before."""
        address = self.campaign.environment_of(environment), self.repetition(requested.index)
        operations = self.sampling.operations
        random = stream(requested.seed, "operation", requested.target, *address)
        change = operation_of(operations[int(random.integers(len(operations)))])
        return MessageRequest(requested.target, change, None).resolve(requested.seed, profile_of(golden), *address)

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """A fault with an empty mask in a state; stages alternate."""
        environment = self.campaign.environment_of(environment)
        spec = self._spec
        null: Fault = find_level("state").null_fault(
            index, seed, environment, golden, spec.autopilot, spec.localization
        )
        return null


def fewer_messages(fault: MessageFault, _: Injection | None) -> Iterator[Fault]:
    """Faults that change fewer messages of a flight."""
    if fault.change is not None and fault.change.when.times != 1:
        yield from fewer_changes(fault, fault.change)


class MessageLevel(Level):
    """Faults in messages: of states in flights; hosts inject them into the messages of other programs."""

    fault = MessageFault
    sampling: ClassVar[type[Sampling] | None] = MessageSampling
    sampler: ClassVar[type[Sampler]] = MessageSampler
    local = True
    can_wait = True
    form = _FORM
    reductions = {"publications": fewer_messages}
    absent = ("published", "no such publication came")
    corrupts_data = False  # a lost, late or repeated message of a flight holds the data that were published

    def parse(self, text: str, localization: str) -> MessageRequest:
        """See `Level.parse`."""
        state, what = split_site(text)
        if not state or not what.partition("@")[0]:
            self.not_understood()
        spec = find_published(state, localization)
        change, _, time_us, lasts_s = parse_fields(what)
        change = change._replace(lasts_s=lasts_s)
        MessageFault(spec.name, change=change)  # checks it
        if change.when.condition is not None:
            find_field(spec, change.when.condition.field)
        return MessageRequest(spec.name, change, time_us)

    def text_of(self, fault: MessageFault) -> str | None:
        """See `Level.text_of`; None for a number in a message of another program."""
        if fault.topic not in STATES or not fault.is_of_flight or fault.time_us == NO_SITE:
            return None
        return f"message:{fault.topic}:{fault.planned.with_fields(None, fault.time_us)}"

    def seed_of(self, fault: MessageFault) -> int | None:
        """See `Level.seed_of`: an intermittent fault draws its publications."""
        if fault.planned.when.share < 1.0:
            return fault.seed
        return None

    def flies_from(self, fault: MessageFault) -> FliesFrom:
        """See `Level.flies_from`."""
        if not fault.is_of_flight or fault.planned.when.counts_messages:
            return FliesFrom.TAKE_OFF
        return FliesFrom.CHECKPOINT

    def inject(self, loop: Any, fault: MessageFault, detector: Any) -> PublicationInjector:
        """See `Level.inject`."""
        if not fault.is_of_flight:
            raise BadInputError(f"fault in {fault.site}: allowed in a flight: whole messages, {self.form}")
        injector = loop.taps.injector = PublicationInjector(fault, loop)
        loop.watch_transit()
        return injector

    def columns(self, fault: MessageFault) -> dict[str, Any]:
        """See `Level.columns`."""
        columns: dict[str, Any] = {"state": fault.topic, "field": fault.field}
        if fault.topic in STATES:
            spec = STATES[fault.topic]
            columns |= {"stage": str(spec.stage), "kernel": spec.writer}
        if fault.change is not None:
            columns["operation"] = fault.change.name
        return columns

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`."""
        operations = ", ".join(campaign.sampling.operations)
        return {"each": "state", "how": f"publications uniform, operations {operations}"}
