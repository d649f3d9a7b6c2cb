"""State-level faults: one bit of one field of one published inter-kernel state, once."""

from copy import copy
from dataclasses import replace

import numpy as np

from mavfi.errors import BadInputError
from mavfi.faults.fault import FaultSite, StateFault
from mavfi.faults.strata import WORD_BITS
from mavfi.flight_log import Injection
from mavfi.states import STATES, State, StateSpec, find_state


def flip(state: State, site: FaultSite, bit: int | None) -> tuple[State, float | int | bool, float | int | bool]:
    """Flip one bit of one field in a copy of a state; gives the copy, and the field's value before and after.

    Args:
        state: A publication.
        site: Field, and element where the field belongs to the elements (clamped to those that are there).
        bit: 0 = least significant bit of the field (IEEE 754 binary32 or binary64, two's complement); a flag has
            bit 0 only; None = flip nothing.

    Raises:
        BadInputError: The field has no such bit, or the state has no element.
    """
    described = state.spec.find(site.field)
    if bit is not None and not 0 <= bit < WORD_BITS[described.dtype]:
        raise BadInputError(f"{site}: no bit {bit}; allowed: 0 to {WORD_BITS[described.dtype] - 1}")
    changed = state.copy()
    in_elements = state.spec.in_elements(site.field)
    container = changed.elements if in_elements else changed.header
    if len(container) == 0:
        raise BadInputError(f"{site}: the state carries no {state.spec.element} to change")
    row = min(site.element or 0, len(container) - 1) if in_elements else 0
    before = container[site.field][row].item()
    if bit is not None:
        names = container.dtype.fields
        assert names is not None  # states are structured arrays
        offset = row * container.dtype.itemsize + names[site.field][1] + bit // 8
        container.view(np.uint8)[offset] ^= np.uint8(1 << bit % 8)
    return changed, before, container[site.field][row].item()


class ActedOn:
    """Tells which publications of one state consumers act upon: the same rule for drawing and for injecting.

    Where `StateSpec.acted_on` names a counter, these are the publications in which it grew beyond `last`, its value in
    the publication before; elsewhere all.
    """

    def __init__(self, spec: StateSpec) -> None:
        self._counter = spec.acted_on
        self.last = 0

    def __call__(self, state: State) -> bool:
        """Whether consumers act on this publication, given those that were asked about before."""
        if not self._counter:
            return True
        value = int(state.header[self._counter][0])
        grew = value > self.last
        self.last = value
        return grew


class CounterWatch:
    """A tap in the injector's place that changes nothing, and keeps the counters that an injector has to know.

    They are in `acted_on`, for the states of which consumers do not act on every publication.
    """

    spent = True

    def __init__(self) -> None:
        self.acted_on = {spec.name: ActedOn(spec) for spec in STATES.values() if spec.acted_on}

    def copy(self) -> "CounterWatch":
        """One that has seen the same, and then sees other things."""
        other = CounterWatch()
        other.acted_on = {name: copy(acted_on) for name, acted_on in self.acted_on.items()}
        return other

    def same(self, other: object) -> bool:
        """Whether both have seen the same counters last."""
        return isinstance(other, CounterWatch) and all(
            acted_on.last == other.acted_on[name].last for name, acted_on in self.acted_on.items()
        )

    def __call__(self, state: State, time_us: int) -> State:
        """The publication itself."""
        del time_us
        acted_on = self.acted_on.get(state.spec.name)
        if acted_on is not None:
            acted_on(state)
        return state

    def finish(self) -> list[Injection]:
        """Nothing was done."""
        return []


class StateInjector:
    """A tap that injects one fault, once; every other publication passes untouched."""

    def __init__(self, fault: StateFault, watch: CounterWatch | None = None) -> None:
        """Arm the fault; `watch` has seen the publications before this injector is put in, None = there were none."""
        self.injections: list[Injection] = []
        self._fault = fault
        self._spec = find_state(fault.where.state)
        known = None if watch is None else watch.acted_on.get(self._spec.name)
        self._acted_on = ActedOn(self._spec) if known is None else copy(known)
        self._in_elements = self._spec.in_elements(fault.where.field)
        self._spec.find(fault.where.field)
        self._armed = fault.has_site

    def copy(self) -> "StateInjector":
        """One that has done the same, and then does other things."""
        other = copy(self)
        other.injections, other._acted_on = list(self.injections), copy(self._acted_on)
        return other

    @property
    def spent(self) -> bool:
        """Whether it will leave everything that comes untouched."""
        return not self._armed

    def __call__(self, state: State, time_us: int) -> State:
        """The publication itself, or, once, a copy with a bit flipped; `time_us` is now."""
        if state.spec is not self._spec or not self._armed:
            return state
        acted_on = self._acted_on(state)
        if not acted_on or time_us < self._fault.time_us or (self._in_elements and len(state.elements) == 0):
            return state
        self._armed = False
        return self._inject(state, time_us)

    def _inject(self, state: State, time_us: int) -> State:
        fault, site = self._fault, self._fault.where
        if self._in_elements:
            # the list may be shorter than in the golden flight; the record names what was injected
            site = replace(site, element=min(site.element or 0, len(state.elements) - 1))
        injected, before, after = flip(state, site, fault.bit)
        activated = injected.same_bits(state) == (fault.bit is None)
        self.injections.append(Injection(fault.level, str(site), time_us / 1e6, fault.bit, before, after, activated))
        return injected

    def finish(self) -> list[Injection]:
        """The injections; if the publication never came, one record that says so."""
        if not self.injections:
            fault = self._fault
            time_s = fault.time_us / 1e6 if fault.has_site else 0.0
            self.injections.append(Injection(fault.level, fault.site, time_s, fault.bit, None, None, activated=False))
        return self.injections
