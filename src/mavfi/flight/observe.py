"""Observation of a running flight: publications, control periods, and events, alarms and injections."""

import time
from typing import Any, Protocol

import numpy as np

from mavfi.flight.loop import Loop
from mavfi.mission import MissionStatus
from mavfi.record import AlarmRecord, Event, Injection
from mavfi.states import State

Item = Event | AlarmRecord | Injection


class Observer(Protocol):
    """Receives a running flight; it must not change what it receives."""

    def begin(self, loop: Loop) -> None:
        """The flight is about to start."""

    def published(self, state: State, time_us: int) -> None:
        """A publication, as consumers receive it, and its instant (us)."""

    def tick(self, row: np.ndarray, items: list[Item], status: MissionStatus | None) -> None:
        """A control period has elapsed.

        Args:
            row: Its row in the flight log, see `flight_log.COLUMNS`. Shape (21,).
            items: Events, alarms and injections since the last one.
            status: Status at the end of the mission; None = it has not ended.
        """


class Attached:
    """Attaches an observer to a flight that has not started, when called with its loop.

    Args:
        observer: The observer.
        pace: Flight time per wall time; 0 = as fast as possible.
    """

    def __init__(self, observer: Observer, pace: float = 0.0) -> None:
        self._observer, self._pace = observer, pace

    def __call__(self, loop: Loop) -> None:
        """Attach it; alarms are reported with the outcome known at the end of their control period."""
        seen = [0, 0, 0]
        began = time.monotonic()

        def tick(now: int) -> None:
            self._observer.tick(loop.record.rows[-1], _new_items(loop, seen), loop.status)
            if self._pace > 0 and loop.status is None:
                time.sleep(max(0.0, began + 1e-6 * now / self._pace - time.monotonic()))

        loop.taps.recorders.append(self._observer.published)
        loop.after_tick.append(tick)
        self._observer.begin(loop)


def _new_items(loop: Loop, seen: list[int]) -> list[Item]:
    """Items since the last call; `seen` counts the earlier ones."""
    injections: Any = getattr(loop.taps.injector, "injections", ())
    tables = (injections, loop.record.events, loop.record.alarms)
    counts = [len(table) for table in tables]
    if counts == seen:
        return []
    found = [item for table, count in zip(tables, seen, strict=True) for item in table[count:]]
    seen[:] = counts
    return found
