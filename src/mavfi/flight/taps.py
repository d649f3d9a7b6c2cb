"""Taps of every published state, in a fixed order: injector, detector, recorders."""

from collections.abc import Callable, Set
from dataclasses import dataclass, field
from typing import Protocol

from mavfi.record import Injection
from mavfi.states import State

Tap = Callable[[State, int], State | None]
"""Maps a publication and the instant (us) to the value to publish; None = withheld."""
Recorder = Callable[[State, int], None]
"""Receives each value as consumers will, and the instant (us)."""


class InjectorTap(Protocol):
    """The injector tap, applied first."""

    @property
    def spent(self) -> bool:
        """Whether all injections are complete, so that further values pass unchanged."""

    def __call__(self, state: State, time_us: int) -> State | None:
        """The value to publish; None = lost."""

    def finish(self) -> list[Injection]:
        """All injections of the flight."""


class InTurn:
    """Two injectors as one: the second receives what the first leaves.

    Args:
        first: Applied first.
        second: Applied to its result.
    """

    def __init__(self, first: InjectorTap, second: InjectorTap) -> None:
        self._first = first
        self._second = second

    @property
    def spent(self) -> bool:
        """See `InjectorTap.spent`."""
        return self._first.spent and self._second.spent

    @property
    def injections(self) -> list[Injection]:
        """Those so far."""
        injections: list[Injection] = []
        for injector in (self._first, self._second):
            injections += getattr(injector, "injections", ())
        return injections

    def __call__(self, state: State, time_us: int) -> State | None:
        """See `InjectorTap`."""
        seen = self._first(state, time_us)
        if seen is None:
            return None
        return self._second(seen, time_us)

    def finish(self) -> list[Injection]:
        """See `InjectorTap`."""
        return self._first.finish() + self._second.finish()


@dataclass(slots=True)
class Taps:
    """The taps of one flight, in order of application.

    Attributes:
        injector: None = no injection.
        detector: None = no detector.
        recorders: Called in list order.
        watched: Names of the states that the detector receives; None = all.
        seal: Receives each value before injection, as sent by the producer; None = unused.
        answer_loss: Receives each value that the injector loses, and returns whether there is a response; it belongs to
            the detector's tap, and is down with it.  None = unused.
        note_loss: Receives each such value without a response; None = unused.
    """

    injector: InjectorTap | None = None
    detector: Tap | None = None
    recorders: list[Recorder] = field(default_factory=list)
    watched: Set[str] | None = None
    seal: Recorder | None = None
    answer_loss: Callable[[State, int], bool] | None = None
    note_loss: Recorder | None = None

    def __call__(self, state: State, time_us: int) -> State | None:
        """The value that consumers receive; None = none."""
        seen: State | None = state
        if self.seal is not None:
            self.seal(state, time_us)
        if self.injector is not None:
            seen = self.injector(state, time_us)
            if seen is None:
                self._lose(state, time_us)
        if self.detector is not None and seen is not None and (self.watched is None or seen.spec.name in self.watched):
            seen = self.detector(seen, time_us)
        if seen is not None:
            for record in self.recorders:
                record(seen, time_us)
        return seen

    def _lose(self, state: State, time_us: int) -> None:
        answered = self.detector is not None and self.answer_loss is not None and self.answer_loss(state, time_us)
        if not answered and self.note_loss is not None:
            self.note_loss(state, time_us)
