"""The functions that every published state passes, in a fixed order: injector, detector, recorders."""

from collections.abc import Callable, Set
from dataclasses import dataclass, field
from typing import Protocol

from mavfi.flight_log import Injection
from mavfi.states import State

Tap = Callable[[State, int], State | None]
"""Takes a publication and the instant (us); gives what is published instead, or None = held back."""
Recorder = Callable[[State, int], None]
"""Sees what consumers will see, and the instant (us)."""


class Injector(Protocol):
    """The first tap."""

    @property
    def spent(self) -> bool:
        """Whether it leaves everything from now on untouched."""

    def __call__(self, state: State, time_us: int) -> State | None:
        """The published value; None = it is lost."""

    def finish(self) -> list[Injection]:
        """All of its injections."""


@dataclass(slots=True)
class Taps:
    """The taps of one flight, in their order.

    Attributes:
        injector: None = nothing is injected.
        detector: None = nothing is watched.
        recorders: In their order.
        watched: Names of the states that the detector is shown; None = all.
        seal: Sees each value as its producer hands it over; None = nothing does.
    """

    injector: Injector | None = None
    detector: Tap | None = None
    recorders: list[Recorder] = field(default_factory=list)
    watched: Set[str] | None = None
    seal: Recorder | None = None

    def __call__(self, state: State, time_us: int) -> State | None:
        """What consumers see of a publication; None = nothing."""
        seen: State | None = state
        if self.seal is not None:
            self.seal(state, time_us)
        if self.injector is not None:
            seen = self.injector(state, time_us)
        if self.detector is not None and seen is not None and (self.watched is None or seen.spec.name in self.watched):
            seen = self.detector(seen, time_us)
        if seen is not None:
            for record in self.recorders:
                record(seen, time_us)
        return seen
