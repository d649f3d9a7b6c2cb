"""State-level faults: one field of a published inter-kernel state, once or for a limited time.

A bit is flipped, and stuck in further publications (`StateInjector`); or the value is changed by another operation, in
publications that a trigger selects (`ValueInjector`).

A field may also be the length of a list in the serialized state: a message with a wrong length can be lost.
"""

from copy import copy
from dataclasses import replace
from typing import Any, Self

import numpy as np

from mavfi.errors import BadInputError
from mavfi.faults.changes import MessageSchedule, When
from mavfi.faults.fault import FaultSite, StateFault, find_field
from mavfi.faults.injector import RewindableInjector
from mavfi.faults.levels.transit import ChangedPublication, changed_bits, is_length, with_length
from mavfi.faults.operations import changed_number
from mavfi.faults.sampling import stream
from mavfi.faults.strata import WORD_BITS
from mavfi.record import Injection, plain
from mavfi.states import STATES, State, StateSpec, find_state

Number = float | int | bool
"""Value of a field."""


def flip(state: State, site: FaultSite, bit: int | None, width: int = 1) -> tuple[State, Number, Number]:
    """Flip one bit of one field in a copy of a state; returns the copy, and the field's value before and after.

    Args:
        state: A publication.
        site: Field, and element if the field belongs to the elements (clamped to the existing ones).
        bit: 0 = least significant bit of the field (IEEE 754 binary32 or binary64, two's complement); a flag has
            bit 0 only; None = flip nothing.
        width: Number of adjacent bits, starting at `bit`.

    Raises:
        BadInputError: The field has no such bit, or the state has no element.
    """
    bits = WORD_BITS[state.spec.find(site.field).dtype]
    if bit is not None and bit < 0:
        raise BadInputError(f"{site}: no bit {bit}; allowed: 0 to {bits - 1}")
    if bit is not None and bit + width > bits:
        raise BadInputError(f"{site}: no bit {bit + width - 1}; allowed: 0 to {bits - 1}")
    change = _with_bits(state, site, mask_of(bit, width))
    assert change.state is not None  # only a wrong length loses a message
    return change.state, change.before, change.after


def mask_of(bit: int | None, width: int) -> int:
    """Mask of adjacent bits, starting at `bit`; None = no bit."""
    if bit is None:
        return 0
    return ((1 << width) - 1) << bit


def _with_bits(state: State, site: FaultSite, mask: int, stuck: int | None = None) -> ChangedPublication:
    """A copy with masked bits of a field flipped, or set as in `stuck`."""
    if is_length(state.spec, site.field):
        raise BadInputError(f"{site}: is the length of a list; allowed: a field of the state")
    changed = state.copy()
    # Where the field is: in the header, or in a row of the elements.
    container = changed.header
    row = 0
    if state.spec.in_elements(site.field):
        container = changed.elements
        row = min(site.element or 0, len(container) - 1)
    if len(container) == 0:
        raise BadInputError(f"{site}: the state carries no {state.spec.element} to change")
    before = container[site.field][row].item()
    # Change its bytes.
    names = container.dtype.fields
    assert names is not None  # states are structured arrays
    start = row * container.dtype.itemsize + names[site.field][1]
    size = names[site.field][0].itemsize
    raw = container.view(np.uint8)[start : start + size]
    word = int.from_bytes(raw.tobytes(), "little")
    word = changed_bits(word, mask, stuck)
    raw[:] = np.frombuffer(word.to_bytes(size, "little"), np.uint8)
    return ChangedPublication(changed, before, container[site.field][row].item(), word)


class ActedOn:
    """Selects the publications of one state that consumers act on: the same rule for drawing and injecting.

    If `StateSpec.acted_on` names a counter, these are the publications in which it exceeds `last`, its value in the
    previous publication; otherwise all.
    """

    def __init__(self, spec: StateSpec) -> None:
        self._counter = spec.acted_on
        self.last = 0

    def __call__(self, state: State) -> bool:
        """Whether consumers act on this publication, given the previous calls."""
        if not self._counter:
            return True
        value = int(state.header[self._counter][0])
        grew = value > self.last
        self.last = value
        return grew


class CounterWatch:
    """A tap without effect, in place of the injector, that tracks the counters needed by a later injector.

    They are in `acted_on`, for the states of which consumers do not act on every publication.
    """

    spent = True

    def __init__(self) -> None:
        self.acted_on = {spec.name: ActedOn(spec) for spec in STATES.values() if spec.acted_on}

    def copy(self) -> "CounterWatch":
        """An independent copy with the same counters."""
        other = CounterWatch()
        other.acted_on = {name: copy(acted_on) for name, acted_on in self.acted_on.items()}
        return other

    def same(self, other: object) -> bool:
        """Whether both have the same latest counters."""
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
        """No injection."""
        return []


class StateInjector(RewindableInjector):
    """A tap that injects one fault, once or while it lasts; all other publications pass unchanged."""

    def __init__(self, fault: StateFault, watch: CounterWatch | None = None) -> None:
        """Arm the fault; `watch` has tracked all earlier publications, None = there were none."""
        self.injections: list[Injection] = []
        self._fault = fault
        self._spec = find_state(fault.where.state)
        self._spec.find(fault.where.field)  # refuses an unknown field
        self._acted_on = ActedOn(self._spec)
        if watch is not None and self._spec.name in watch.acted_on:
            self._acted_on = copy(watch.acted_on[self._spec.name])
        self._in_elements = self._spec.in_elements(fault.where.field)
        self._in_length = fault.of_length
        self._armed = fault.has_site
        self._since_us = 0  # instant of the first change
        self._stuck = 0  # word to whose bits the field is stuck after it
        self._seen = 0  # number of publications since the fault began
        self._changed = 0  # number of changed ones

    def copy(self) -> Self:
        """An independent copy in the same state."""
        other = super().copy()
        other._acted_on = copy(self._acted_on)
        return other

    @property
    def spent(self) -> bool:  # type: ignore[override] # known at any time
        """See `Injector.spent`."""
        return not self._armed

    def __call__(self, state: State, time_us: int) -> State | None:
        """The publication itself, or a copy with a bit flipped or stuck, at the current time; None = lost."""
        if state.spec is not self._spec or not self._armed:
            return state
        acted_on = self._acted_on(state)
        if self._in_elements and len(state.elements) == 0:
            return state
        # The fault begins with a publication that consumers act on, and then changes any.
        has_begun = self._seen > 0
        if not has_begun and (not acted_on or time_us < self._fault.time_us):
            return state
        if has_begun and not self._lasts(time_us):
            return state
        self._seen += 1
        self._armed = self._seen < self._fault.times or self._fault.lasts_s > 0.0
        if self._seen == 1 or self._hits():
            return self._inject(state, time_us)
        return state

    def _lasts(self, time_us: int) -> bool:
        """Whether a fault that has begun still lasts; disarms it if not."""
        fault = self._fault
        self._armed = self._seen < fault.times or time_us - self._since_us <= 1e6 * fault.lasts_s
        return self._armed

    def _hits(self) -> bool:
        """Whether an intermittent fault changes this publication: a function of the seed and its number."""
        fault = self._fault
        return fault.share == 1.0 or stream(fault.seed, "share", self._seen).random() < fault.share

    def _inject(self, state: State, time_us: int) -> State | None:
        """Change a publication; the first change is recorded."""
        fault = self._fault
        site = fault.where
        if self._in_elements:
            # the list may be shorter than in the golden run; the record names the injected element
            site = replace(site, element=min(site.element or 0, len(state.elements) - 1))
        is_first = self._changed == 0
        stuck = None
        if not is_first:
            stuck = self._stuck
        mask = mask_of(fault.bit, fault.width)
        if self._in_length:
            change = with_length(state, site.field, mask, stuck)
        else:
            change = _with_bits(state, site, mask, stuck)
        self._changed += 1
        if is_first:
            self._since_us = time_us
            self._stuck = change.word
            change, further = self._change_further(change, site)
            self.injections.append(self._record(state, time_us, site, change, further))
        return change.state

    def _change_further(
        self, change: ChangedPublication, site: FaultSite
    ) -> tuple[ChangedPublication, list[dict[str, Any]]]:
        """Flip the bits of further fields as well; returns the change, and their values before and after as data."""
        values = []
        for name, bit in self._fault.also:
            assert change.state is not None  # only a wrong length loses a message
            further = _with_bits(change.state, replace(site, field=name), mask_of(bit, 1))
            change = change._replace(state=further.state)
            values.append({"field": name, "bit": bit, "before": plain(further.before), "after": plain(further.after)})
        return change, values

    def _record(
        self,
        state: State,
        time_us: int,
        site: FaultSite,
        change: ChangedPublication,
        further: list[dict[str, Any]],
    ) -> Injection:
        """The record of the first change, and of the further fields."""
        fault = self._fault
        details: dict[str, Any] = {}
        if further:
            details["also"] = further
        is_same = False
        if change.state is None:
            details["lost"] = True
        else:
            is_same = change.state.same_bits(state)
        is_null_fault = fault.bit is None
        return Injection(
            fault.level,
            str(site),
            time_us / 1e6,
            fault.bit,
            change.before,
            change.after,
            activated=is_same == is_null_fault,
            details=details,
        )

    def finish(self) -> list[Injection]:
        """The injection; a lasting one with its number of publications; not activated if none was changed."""
        if self.injections and self._fault.lasting:
            first = self.injections[0]
            return [replace(first, details={**first.details, "publications": self._changed})]
        if not self.injections:
            fault = self._fault
            time_s = 0.0
            if fault.has_site:
                time_s = fault.time_us / 1e6
            self.injections.append(Injection(fault.level, fault.site, time_s, fault.bit, None, None, activated=False))
        return self.injections


# ---- other changes of a value ----------------------------------------------------------------------------------------
def number_in(state: State, path: str) -> float:
    """The number at a path such as `vx` or `x[3]` (`x`: that of the first element); NaN if there is no such element."""
    name = find_field(state.spec, path)
    container = state.header
    row = 0
    if state.spec.in_elements(name):
        container = state.elements
        row = int(path[len(name) :].strip("[]") or 0)
    if row >= len(container):
        return float("nan")
    return float(container[name][row])


def schedule_of(when: When, time_us: int, seed: int) -> MessageSchedule:
    """The schedule of a change of publications from an instant on (us; a negative one is that of no site)."""
    return MessageSchedule(when.starting_at(time_us), seed)


class ValueInjector(RewindableInjector):
    """A tap that changes one number in the publications that a trigger selects; all others pass unchanged.

    Those whose list is empty have no such number, and pass unchanged as well.

    Args:
        fault: A fault with a change.
    """

    def __init__(self, fault: StateFault) -> None:
        assert fault.change is not None  # precondition
        self.injections: list[Injection] = []
        self._fault = fault
        self._spec = find_state(fault.where.state)
        self._in_elements = self._spec.in_elements(fault.where.field)
        self._dtype = self._spec.find(fault.where.field).dtype
        self._operation = replace(fault.change.operation, bit=fault.bit)
        self._schedule = schedule_of(fault.change.when, fault.time_us, fault.seed)
        self._latest_us = float("inf")  # a fault that lasts for some time ends then
        self._frozen: Number | None = None  # value at which a frozen field is stuck
        self._is_over = not fault.has_site

    def copy(self) -> Self:
        """See `RewindableInjector`."""
        other = super().copy()
        other._schedule = copy(self._schedule)
        return other

    @property
    def spent(self) -> bool:  # type: ignore[override] # known at any time
        """See `Injector.spent`."""
        return self._is_over or self._schedule.is_over

    def __call__(self, state: State, time_us: int) -> State:
        """The publication itself, or a copy with another value."""
        if state.spec is not self._spec or self.spent:
            return state
        self._is_over = time_us > self._latest_us
        if self._is_over or not self._schedule.due(time_us / 1e6, lambda path: number_in(state, path)):
            return state
        if self._in_elements and len(state.elements) == 0:
            self._schedule.take_back()
            return state
        return self._change(state, time_us)

    def _change(self, state: State, time_us: int) -> State:
        """Change a publication; the first change is recorded."""
        # Where the number is; the list may be shorter than in the golden run.
        site = self._fault.where
        changed = state.copy()
        container = changed.header
        row = 0
        if self._in_elements:
            row = min(site.element or 0, len(state.elements) - 1)
            site = replace(site, element=row)
            container = changed.elements
        before: Number = container[site.field][row].item()

        # Its new value.
        if self._operation.name == "freeze":
            if self._frozen is None:
                self._frozen = before
            after = self._frozen
        else:
            after = changed_number(self._operation, before, self._dtype)
        container[site.field][row] = after

        if not self.injections:
            fault = self._fault
            if fault.lasts_s > 0.0:
                self._latest_us = time_us + 1e6 * fault.lasts_s
            details = {"operation": str(self._operation)}
            self.injections.append(
                Injection(
                    fault.level, str(site), time_us / 1e6, fault.bit, before, after, activated=True, details=details
                )
            )
        return changed

    def finish(self) -> list[Injection]:
        """The injection; a lasting one with its number of publications; not activated if none was changed."""
        fault = self._fault
        if not self.injections:
            time_s = 0.0
            if fault.has_site:
                time_s = fault.time_us / 1e6
            details = {"operation": str(self._operation)}
            never = Injection(fault.level, fault.site, time_s, fault.bit, None, None, activated=False, details=details)
            return [never]
        (first,) = self.injections
        if fault.lasting:
            return [replace(first, details={**first.details, "publications": self._schedule.changed})]
        return [first]


def injector_of(fault: StateFault, watch: CounterWatch | None = None) -> "StateInjector | ValueInjector":
    """The injector of a fault; `watch` has tracked all earlier publications, None = there were none."""
    if fault.change is None:
        return StateInjector(fault, watch)
    return ValueInjector(fault)
