"""Several detectors in one."""

from collections.abc import Callable, Sequence
from typing import Any

from mavfi.detectors.detector import Alarm, AtOnce, admission
from mavfi.states import State


class Chain:
    """Several detectors in sequence: the first alarm counts.

    All but the last need a method `retract` for `at_once`: if a later one raises an alarm, the publication that they
    accepted at once is not recorded.
    """

    def __init__(self, *detectors: Any) -> None:  # noqa: ANN401 - `Detector`s; those of ours have memory and score
        self.parts = detectors
        asked = [getattr(detector, "states", None) for detector in detectors]
        every = None in asked
        self.states = None if every else frozenset(name for states in asked for name in states or ())
        self._readers = {
            name: tuple(part for part, own in zip(detectors, asked, strict=True) if own is None or name in own)
            for name in self.states or ()
        }
        self._look_up()
        if not all(hasattr(detector, "restore") for detector in detectors):
            self.memory = self.restore = None  # type: ignore[assignment, method-assign] # a host copies the whole

    def _look_up(self) -> None:
        self.at_once = AtOnce({name: _in_turn(name, readers) for name, readers in self._readers.items()})

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without what is looked up."""
        return {name: value for name, value in self.__dict__.items() if name != "at_once"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Inverse of `__getstate__`."""
        self.__dict__.update(state)
        self._look_up()

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        for detector in self.parts:
            detector.start()

    def score(self, state: State, time_us: int) -> float | None:
        """The largest score of all detectors."""
        scores = [detector.score(state, time_us) for detector in self.parts if hasattr(detector, "score")]
        return max((score for score in scores if score is not None), default=None)

    def check(self, state: State, time_us: int) -> Alarm | None:
        """The first alarm of any detector."""
        for detector in self._readers.get(state.spec.name, self.parts):
            alarm: Alarm | None = detector.check(state, time_us)
            if alarm is not None:
                return alarm
        return None

    def accept(self, state: State, time_us: int) -> None:
        """Pass a published value to all detectors that read its state."""
        for detector in self._readers.get(state.spec.name, self.parts):
            detector.accept(state, time_us)

    def memory(self) -> tuple[Any, ...]:
        """Memories of all detectors."""
        return tuple(detector.memory() for detector in self.parts)

    def restore(self, memory: tuple[Any, ...]) -> None:
        """Inverse of `memory`."""
        for detector, kept in zip(self.parts, memory, strict=True):
            detector.restore(kept)


def _in_turn(name: str, detectors: Sequence[Any]) -> Callable[[Any], object]:
    """A function for `AtOnce` that passes a publication of a state through the tables of several detectors."""
    *before, last = detectors
    table = admission(last).at_once
    for detector in reversed(before):
        able = hasattr(detector, "retract")
        first = admission(detector).at_once if able else AtOnce()
        table = AtOnce({name: _both(name, first, table, detector.retract if able else None)})
    return table[name] if before else lambda header: table[name](header)  # tables change: looked up at each call


def _both(name: str, first: AtOnce, following: AtOnce, retract: Any) -> Callable[[Any], object]:  # noqa: ANN401
    def admit(header: Any) -> bool:  # noqa: ANN401 - an array
        if first[name](header):
            return True
        if following[name](header):
            retract()  # what `first` has accepted
            return True
        return False

    return admit
