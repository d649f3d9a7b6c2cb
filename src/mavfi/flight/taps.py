"""Taps of every published state: injector and detector, then recorders.

The injector is on the way from producer to consumer.  A detector at the consumer follows it; one at the producer
precedes it, and never sees the fault.  Which of them depends on the stage of a value and on the mission's key
`detector_place`; in the authors' code, perception and planning are checked by the consumer, commands by the producer.
"""

from collections.abc import Callable, Set
from dataclasses import dataclass, field
from typing import Protocol

from mavfi.mission import DetectorPlace
from mavfi.record import Injection
from mavfi.states import PPC_STAGES, Stage, State

Tap = Callable[[State, int], State | None]
"""Maps a publication and the instant (us) to the value to publish; None = withheld."""
Recorder = Callable[[State, int], None]
"""Receives each value as consumers will, and the instant (us)."""


CHECKED_AT_PRODUCER: dict[DetectorPlace, frozenset[Stage]] = {
    "consumer": frozenset(),
    "producer": frozenset(PPC_STAGES),
    "published": frozenset([Stage.CONTROL]),
}
"""Stages whose values the detector checks before the injector changes them, by the mission's `detector_place`.

A sensor that fails is a producer of wrong values: what it publishes is checked by the consumer.
"""


class InjectorTap(Protocol):
    """The injector tap, applied first unless the detector is at the producer."""

    @property
    def spent(self) -> bool:
        """Whether all injections are complete, so that further values pass unchanged."""

    def __call__(self, state: State, time_us: int) -> State | None:
        """The value to publish; None = lost."""

    def finish(self) -> list[Injection]:
        """All injections of the flight."""


@dataclass(slots=True)
class Taps:
    """The taps of one flight.

    Attributes:
        injector: None = no injection.
        detector: None = no detector.
        recorders: Called in list order.
        watched: Names of the states that the detector receives; None = all.
        checked_at_producer: Stages whose values the detector receives before the injector.
        seal: Receives each value before injection, as sent by the producer; None = unused.
        answer_loss: Receives each value that the injector loses, and returns whether there is a response; it belongs to
            the detector's tap, is down with it, and is where that is.  None = unused.
        note_loss: Receives each such value without a response; None = unused.
        loses_unnoticed: Whether nothing arrives of a value that the injector loses, so that there is no response.
    """

    injector: InjectorTap | None = None
    detector: Tap | None = None
    recorders: list[Recorder] = field(default_factory=list)
    watched: Set[str] | None = None
    checked_at_producer: Set[Stage] = frozenset()
    seal: Recorder | None = None
    answer_loss: Callable[[State, int], bool] | None = None
    note_loss: Recorder | None = None
    loses_unnoticed: bool = False

    def __call__(self, state: State, time_us: int) -> State | None:
        """The value that consumers receive; None = none."""
        seen: State | None
        if self.seal is not None:
            self.seal(state, time_us)
        if state.spec.stage in self.checked_at_producer:
            seen = self._check(state, time_us)
            if seen is not None:
                seen = self._inject(seen, time_us)
        else:
            seen = self._inject(state, time_us)
            if seen is not None:
                seen = self._check(seen, time_us)
        return self._record(seen, time_us)

    def arrive(self, state: State, time_us: int) -> State | None:
        """The value that consumers receive of one that the injector has sent late, or once more; None = none."""
        seen: State | None = state
        if state.spec.stage not in self.checked_at_producer:
            seen = self._check(state, time_us)
        return self._record(seen, time_us)

    def _record(self, seen: State | None, time_us: int) -> State | None:
        """Pass what consumers receive to the recorders, and return it."""
        if seen is not None:
            for record in self.recorders:
                record(seen, time_us)
        return seen

    def _check(self, state: State, time_us: int) -> State | None:
        """The value that the detector lets pass; None = it is withheld."""
        if self.detector is None:
            return state
        if self.watched is not None and state.spec.name not in self.watched:
            return state
        return self.detector(state, time_us)

    def _inject(self, state: State, time_us: int) -> State | None:
        """The value as changed on the way; None = it is lost."""
        if self.injector is None:
            return state
        changed = self.injector(state, time_us)
        if changed is None and not self._answers_loss(state, time_us) and self.note_loss is not None:
            self.note_loss(state, time_us)
        return changed

    def _answers_loss(self, state: State, time_us: int) -> bool:
        """Whether there is a response to a lost value.

        A detector at the producer does not know of the loss, nor does any if nothing arrives.
        """
        if self.detector is None or self.answer_loss is None or self.loses_unnoticed:
            return False
        if state.spec.stage in self.checked_at_producer:
            return False
        return self.answer_loss(state, time_us)
