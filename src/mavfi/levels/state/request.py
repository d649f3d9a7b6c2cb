"""A fault in a state as requested by a user, or as a campaign draws it: what is not given is drawn."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.faults.changes import Change
from mavfi.faults.fault import FaultSite
from mavfi.faults.operations import Operation, check_number_operation
from mavfi.faults.sampling import draw_publication, stream
from mavfi.faults.strata import WORD_BITS
from mavfi.levels.state.drawing import live_fields
from mavfi.levels.state.fault import StateFault
from mavfi.record import Profile
from mavfi.states import Field, StateSpec

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, Flight


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
