"""Message-level faults: whole publications of a state are lost, late, repeated, frozen or out of order.

What arrives later than it was sent goes through the flight's event queue, so that a flight stays a function of its
mission and fault.  Perception, which takes an image when it has finished the last one, does not wait for a scan that is
lost or late.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, Self
from weakref import proxy

from mavfi.faults.fault import MessageFault
from mavfi.faults.injector import RewindableInjector
from mavfi.faults.levels.state_injector import number_in, schedule_of
from mavfi.record import Injection
from mavfi.states import State, find_state


class EventQueue(Protocol):
    """Where publications that arrive later are put; a `flight.loop.Loop`."""

    def transmit(self, state: State, time_us: int) -> None:
        """Let a publication arrive at an instant (us)."""


@dataclass(frozen=True, slots=True)
class HeldMessage:
    """A publication that waits until others of its state have passed: `remaining` of them."""

    state: State
    remaining: int


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
        self._operation = fault.planned.operation
        self._schedule = schedule_of(fault.planned.when, fault.time_us, fault.seed)
        self._queue: EventQueue = proxy(queue)  # no cycle, so that maps are freed at once
        self._frozen: State | None = None  # what a frozen topic repeats
        self._held: tuple[HeldMessage, ...] = ()  # publications to be overtaken
        self._has_site = fault.has_site

    def copy(self) -> Self:
        """See `RewindableInjector`."""
        other = super().copy()
        other._schedule = self._schedule.copy()
        return other

    @property
    def spent(self) -> bool:  # type: ignore[override] # known at any time
        """See `Injector.spent`; what is late is in the event queue."""
        return not self._has_site or (self._schedule.is_over and not self._held)

    def __call__(self, state: State, time_us: int) -> State | None:
        """The publication that arrives now; None = none does."""
        if state.spec is not self._spec or self.spent:
            return state
        is_changed = self._schedule.due(time_us / 1e6, lambda path: number_in(state, path))
        if not is_changed:
            self._release(time_us)
            return state
        if not self.injections:
            self.injections.append(self._record(time_us, is_activated=True))
        actions: dict[str, Callable[[State, int], State | None]] = {
            "drop": self._drop,
            "delay": self._delay,
            "duplicate": self._duplicate,
            "freeze": self._freeze,
            "reorder": self._reorder,
        }
        return actions[self._operation.name](state, time_us)

    # ---- the operations ---------------------------------------------------------------------------------------------
    def _drop(self, state: State, time_us: int) -> None:
        """The publication is lost."""

    def _delay(self, state: State, time_us: int) -> None:
        """The publication arrives later; others may overtake it."""
        assert self._operation.value is not None  # a delay has one
        self._queue.transmit(state, time_us + round(1e6 * self._operation.value))

    def _duplicate(self, state: State, time_us: int) -> State:
        """The publication arrives, and again at the same instant."""
        for _ in range(self._operation.count):
            self._queue.transmit(state, time_us)
        return state

    def _freeze(self, state: State, time_us: int) -> State:
        """The first frozen publication arrives again."""
        if self._frozen is None:
            self._frozen = state
        return self._frozen

    def _reorder(self, state: State, time_us: int) -> None:
        """The publication waits until others have passed."""
        self._release(time_us)
        self._held = (*self._held, HeldMessage(state, self._operation.count))

    def _release(self, time_us: int) -> None:
        """Count a further publication, and send those that enough of them have overtaken, right behind it."""
        if not self._held:
            return
        waiting = []
        for held in self._held:
            if held.remaining > 1:
                waiting.append(replace(held, remaining=held.remaining - 1))
            else:
                self._queue.transmit(held.state, time_us)
        self._held = tuple(waiting)

    # ---- the record -------------------------------------------------------------------------------------------------
    def _record(self, time_us: int, *, is_activated: bool) -> Injection:
        """The record of the first changed publication."""
        details = {"operation": str(self._operation)}
        return Injection(
            self._fault.level, self._fault.site, time_us / 1e6, None, None, None, is_activated, details=details
        )

    def finish(self) -> list[Injection]:
        """The injection with its number of publications; not activated if none was changed."""
        if not self.injections:
            time_us = 0
            if self._has_site:
                time_us = self._fault.time_us
            return [self._record(time_us, is_activated=False)]
        (first,) = self.injections
        return [replace(first, details={**first.details, "publications": self._schedule.changed})]
