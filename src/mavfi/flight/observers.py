"""Observers: what shows or exports a flight while it is flown."""

import time
from typing import Any, Protocol

import numpy as np

from mavfi.flight.loop import Listener, Loop
from mavfi.mission import MissionStatus
from mavfi.record import AlarmRecord, Event, Injection
from mavfi.states import State

FlightItem = Event | AlarmRecord | Injection


class Observer(Protocol):
    """Receives a running flight; it must not change what it receives."""

    def begin(self, loop: Loop) -> None:
        """The flight is about to start."""

    def published(self, state: State, time_us: int) -> None:
        """A publication, as consumers receive it, and its instant (us)."""

    def tick(self, row: np.ndarray, items: list[FlightItem], status: MissionStatus | None) -> None:
        """A control period has elapsed.

        Args:
            row: Its row in the flight log, see `record.COLUMNS`. Shape (21,).
            items: Events, alarms and injections since the last one.
            status: Status at the end of the mission; None = it has not ended.
        """


class ObserverListener(Listener):
    """Shows a flight to an observer; alarms are reported with the outcome known at the end of their control period.

    Args:
        observer: The observer.
        pace: Flight time per wall time; 0 = as fast as possible.
    """

    def __init__(self, observer: Observer, pace: float = 0.0) -> None:
        self._observer = observer
        self._pace = pace

    def begin(self, loop: Loop) -> None:
        """See `Listener`."""
        self._loop = loop
        self._shown_counts = [0, 0, 0]  # of injections, events and alarms
        self._began = time.monotonic()
        self._observer.begin(loop)

    def published(self, state: State, now: int) -> None:
        """See `Listener`."""
        self._observer.published(state, now)

    def after_tick(self, now: int) -> None:
        """See `Listener`."""
        loop = self._loop
        self._observer.tick(loop.record.rows[-1], self._new_items(), loop.status)
        if self._pace > 0 and loop.status is None:
            time.sleep(max(0.0, self._began + 1e-6 * now / self._pace - time.monotonic()))

    def _new_items(self) -> list[FlightItem]:
        """Items since the last call."""
        injections: Any = getattr(self._loop.taps.injector, "injections", ())
        tables = (injections, self._loop.record.events, self._loop.record.alarms)
        items = [item for table, count in zip(tables, self._shown_counts, strict=True) for item in table[count:]]
        self._shown_counts = [len(table) for table in tables]
        return items
