"""Message-level faults: whole publications of a state are lost, late, repeated, frozen or out of order.

What arrives later than it was sent goes through the flight's event queue, so that a flight stays a function of its
mission and fault.  Perception, which takes an image when it has finished the last one, does not wait for a scan that is
lost or late.
"""

from dataclasses import replace
from typing import Protocol, Self
from weakref import proxy

from mavfi.faults.changes import MessageInjector
from mavfi.faults.fields import number_in
from mavfi.faults.injector import RewindableInjector
from mavfi.levels.message.fault import MessageFault
from mavfi.record import Injection
from mavfi.states import State, find_state


class EventQueue(Protocol):
    """Where publications that arrive later are put; a `flight.loop.Loop`."""

    def transmit(self, state: State, time_us: int) -> None:
        """Let a publication arrive at an instant (us)."""


class PublicationInjector(RewindableInjector):
    """A tap that loses, delays, repeats, freezes or reorders the publications that a trigger selects.

    Args:
        fault: A fault in whole messages.
        queue: The event queue of the flight; it also owns this object.
    """

    def __init__(self, fault: MessageFault, queue: EventQueue) -> None:
        self.injections: list[Injection] = []
        self._fault = fault
        self._spec = find_state(fault.topic)
        owner: EventQueue = proxy(queue)  # no cycle, so that maps are freed at once
        self._messages: MessageInjector[State] = MessageInjector(
            fault.planned.with_fields(None, fault.time_us), lambda *sent: owner.transmit(*sent), fault.seed
        )

    def copy(self) -> Self:
        """See `RewindableInjector`."""
        other = super().copy()
        other._messages = self._messages.copy()
        return other

    @property
    def spent(self) -> bool:  # type: ignore[override] # known at any time
        """See `Injector.spent`; what is late is in the event queue."""
        return not self._fault.has_site or self._messages.is_over

    def __call__(self, state: State, time_us: int) -> State | None:
        """The publication that arrives now; None = none does."""
        if state.spec is not self._spec or self.spent:
            return state
        if not self._messages.due(time_us, lambda path: number_in(state, path)):
            return state
        if not self.injections:
            self.injections.append(self._record(time_us, is_activated=True))
        return self._messages.change(state, time_us)

    def _record(self, time_us: int, *, is_activated: bool) -> Injection:
        """The record of the first changed publication."""
        fault = self._fault
        details = {"operation": str(fault.planned.operation)}
        return Injection(fault.level, fault.site, time_us / 1e6, None, None, None, is_activated, details=details)

    def finish(self) -> list[Injection]:
        """The injection with its number of publications; not activated if none was changed."""
        if not self.injections:
            return [self._record(round(1e6 * self._fault.start_s), is_activated=False)]
        (first,) = self.injections
        return [replace(first, details={**first.details, "publications": self._messages.changed})]
