"""Injection of faults in states: one field of publications is changed, once or several times.

By default a bit is flipped, and stuck in further publications; a fault with a `change` does something else to the
value, in publications that a trigger selects.  A field may also be the length of a list in the serialized state: a
message with a wrong length can be lost.
"""

from copy import copy
from dataclasses import replace
from typing import Any, Self

from mavfi.faults.acted_on import ActedOn, CounterWatch
from mavfi.faults.changes import MessageSchedule, ValueChange
from mavfi.faults.fault import FaultSite
from mavfi.faults.fields import number_in
from mavfi.faults.injector import RewindableInjector
from mavfi.faults.operations import Operation
from mavfi.faults.sampling import stream
from mavfi.levels.state.carriers import ListLength, StateField
from mavfi.levels.state.fault import StateFault
from mavfi.record import Injection, plain
from mavfi.states import State, find_state


class LifetimeSchedule:
    """The publications in which the bits of a fault are stuck: as the `LIFETIME` of a `StateFault` says.

    The fault begins with a publication that consumers act on, and then changes any; those without an element are not
    counted.
    """

    def __init__(self, fault: StateFault, acted_on: ActedOn) -> None:
        self.changed = 0
        self.is_over = not fault.has_site
        self._fault = fault
        self._acted_on = acted_on
        self._since_us = 0  # instant of the first change
        self._publications = 0  # since the fault began

    def __copy__(self) -> "LifetimeSchedule":
        other = LifetimeSchedule(self._fault, copy(self._acted_on))
        other.changed = self.changed
        other.is_over = self.is_over
        other._since_us = self._since_us
        other._publications = self._publications
        return other

    def due(self, state: State, time_us: int, *, has_value: bool) -> bool:
        """Whether this publication is changed; to be called for each one in order, until it is over."""
        fault = self._fault
        acted_on = self._acted_on(state)  # it follows the counter, also in publications without the value
        if not has_value:
            return False
        if self._publications == 0:
            if not acted_on or time_us < fault.time_us:
                return False
            self._since_us = time_us
        elif self._publications >= fault.times and time_us - self._since_us > 1e6 * fault.lasts_s:
            self.is_over = True
            return False
        self._publications += 1
        self.is_over = self._publications >= fault.times and fault.lasts_s == 0.0
        if not self._hits():
            return False
        self.changed += 1
        return True

    def _hits(self) -> bool:
        """Whether an intermittent fault changes this publication.

        The draw of a `Change` would do as well (`faults.changes.happens`); published results have this one.
        """
        fault = self._fault
        if self._publications == 1 or fault.share == 1.0:
            return True
        return stream(fault.seed, "share", self._publications).random() < fault.share


class StateInjector(RewindableInjector):
    """A tap that changes a field of a state as a fault says; all other publications pass unchanged.

    Args:
        fault: The fault.
        watch: Has tracked all earlier publications; None = there were none.
    """

    def __init__(self, fault: StateFault, watch: CounterWatch | None = None) -> None:
        self.injections: list[Injection] = []
        self._fault = fault
        self._spec = find_state(fault.where.state)
        self._spec.find(fault.where.field)  # refuses an unknown field
        self._in_elements = self._spec.in_elements(fault.where.field)
        self._lifetime: LifetimeSchedule | None = None
        self._schedule: LifetimeSchedule | MessageSchedule
        if fault.change is None:
            acted_on = ActedOn(self._spec)
            if watch is not None and self._spec.name in watch.acted_on:
                acted_on = copy(watch.acted_on[self._spec.name])
            self._schedule = self._lifetime = LifetimeSchedule(fault, acted_on)
            self._value = ValueChange(Operation("flip", bit=fault.bit), width=fault.width, is_stuck=True)
        else:
            change = fault.change.with_fields(fault.bit, fault.time_us, fault.lasts_s)
            self._schedule = MessageSchedule(change.when, fault.seed, change.lasts_s)
            self._value = ValueChange(change.operation)

    def copy(self) -> Self:
        """An independent copy in the same state."""
        other = super().copy()
        other._schedule = copy(self._schedule)
        if isinstance(other._schedule, LifetimeSchedule):
            other._lifetime = other._schedule
        other._value = copy(self._value)
        return other

    @property
    def spent(self) -> bool:  # type: ignore[override] # known at any time
        """See `Injector.spent`."""
        return not self._fault.has_site or self._schedule.is_over

    def __call__(self, state: State, time_us: int) -> State | None:
        """The publication itself, or a copy with another value, at the current time (us); None = lost."""
        if state.spec is not self._spec or self.spent or not self._is_due(state, time_us):
            return state
        if self._fault.of_length:
            return self._change_length(state, time_us)
        return self._change_field(state, time_us)

    def _is_due(self, state: State, time_us: int) -> bool:
        """Whether this publication is changed: one whose list is empty has no such number."""
        has_value = not self._in_elements or len(state.elements) > 0
        if self._lifetime is not None:
            return self._lifetime.due(state, time_us, has_value=has_value)
        assert isinstance(self._schedule, MessageSchedule)  # that of a change
        due = self._schedule.due(time_us / 1e6, lambda path: number_in(state, path))
        if due and not has_value:
            self._schedule.take_back()
            return False
        return due

    def _change_length(self, state: State, time_us: int) -> State | None:
        """The publication with another length of a list."""
        carrier = ListLength(state, self._fault.where.field)
        before, after = self._value.apply(carrier)
        details: dict[str, Any] = {}
        if carrier.state is None:
            details["lost"] = True
        self._note(self._fault.where, time_us, before, after, state, carrier.state, details)
        return carrier.state

    def _change_field(self, state: State, time_us: int) -> State:
        """The publication with another value of the field, and of further ones in the first changed publication."""
        # The list may be shorter than in the golden run; the record names the injected element.
        site = self._fault.where
        row = 0
        if self._in_elements:
            row = min(site.element or 0, len(state.elements) - 1)
            site = replace(site, element=row)
        changed = state.copy()
        before, after = self._value.apply(StateField(changed, site.field, row))
        if self.injections:
            return changed

        # Further fields, and the record.
        further = []
        for name, bit in self._fault.also:
            values = ValueChange(Operation("flip", bit=bit)).apply(StateField(changed, name, row))
            further.append({"field": name, "bit": bit, "before": plain(values.before), "after": plain(values.after)})
        details: dict[str, Any] = {}
        if further:
            details["also"] = further
        self._note(site, time_us, before, after, state, changed, details)
        return changed

    def _note(
        self,
        site: FaultSite,
        time_us: int,
        before: Any,
        after: Any,
        state: State,
        changed: State | None,
        details: dict[str, Any],
    ) -> None:
        """Record the first changed publication, of which `changed` arrived (None = it was lost)."""
        if self.injections:
            return
        fault = self._fault
        is_activated = True
        if fault.change is None:
            is_same = changed is not None and changed.same_bits(state)
            is_activated = is_same == fault.is_null
        self.injections.append(
            Injection(
                fault.level,
                str(site),
                time_us / 1e6,
                fault.bit,
                before,
                after,
                activated=is_activated,
                details=self._operation() | details,
            )
        )

    def _operation(self) -> dict[str, Any]:
        """What is done, for the record; nothing if bits are flipped."""
        if self._fault.change is None:
            return {}
        return {"operation": str(replace(self._fault.change.operation, bit=self._fault.bit))}

    def finish(self) -> list[Injection]:
        """The injection; a lasting one with its number of publications; not activated if none was changed."""
        fault = self._fault
        if not self.injections:
            details = self._operation()
            never = Injection(
                fault.level, fault.site, fault.start_s, fault.bit, None, None, activated=False, details=details
            )
            return [never]
        (first,) = self.injections
        if fault.lasting:
            return [replace(first, details={**first.details, "publications": self._schedule.changed})]
        return [first]
