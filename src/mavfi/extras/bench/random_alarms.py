"""Random alarms: a baseline without any information.  Lower bound of detection, and the cost of false alarms."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from mavfi.detectors.detector import Alarm, Detector
from mavfi.errors import BadInputError
from mavfi.extras.bench.sealed import SMALL
from mavfi.numerics.elementary import log
from mavfi.states import STATES, State, states_with

_STREAM = 7
_SCORE = 2.0
_HOUR_US = 3.6e9


class RandomAlarms(Detector):
    """A Poisson process of alarms for each small state, with the given total rate.

    An alarm concerns the first publication of its state at or after its instant.

    Args:
        seed: Seed of the mission: the same mission has the same alarms.
        per_hour: Alarms per hour of flight.

    Raises:
        BadInputError: The rate is not in (0, 1e6].
    """

    def __init__(self, seed: int, per_hour: float = 60.0) -> None:
        if not 0.0 < per_hour <= 1e6:
            raise BadInputError(f"per_hour: {per_hour}; allowed: above 0, up to 1e6")
        self._seed = seed
        watched = [name for name in states_with("truth") if name in SMALL]
        self._gap_us = _HOUR_US * len(watched) / per_hour
        self._order = {name: list(STATES).index(name) for name in watched}
        self.start()

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        self._passed = dict.fromkeys(self._order, 0)
        self._instants = {name: self._process(place) for name, place in self._order.items()}
        self._next = {name: next(instants) for name, instants in self._instants.items()}

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Raise an alarm that is due."""
        name = state.spec.name
        if time_us < self._next.get(name, np.inf):
            return None
        return Alarm("random", state.spec.stage.value, score=_SCORE, fields=(name,))

    def score(self, state: State, time_us: int) -> float | None:
        """2 if an alarm is due, else 0; None for states without alarms."""
        if state.spec.name not in self._order:
            return None
        return 0.0 if self.check(state, time_us) is None else _SCORE

    def accept(self, state: State, time_us: int) -> None:
        """Consume all alarms of the state up to this instant."""
        name = state.spec.name
        while time_us >= self._next.get(name, np.inf):
            self._advance(name)

    def memory(self) -> dict[str, int]:
        """Number of consumed alarms, by state."""
        return dict(self._passed)

    def restore(self, memory: dict[str, Any]) -> None:
        """Inverse of `memory`."""
        self.start()
        for name, count in memory.items():
            for _ in range(count):
                self._advance(name)

    def _advance(self, name: str) -> None:
        self._passed[name] += 1
        self._next[name] = next(self._instants[name])

    def _process(self, place: int) -> Iterator[float]:
        """Instants of the alarms of a state (us), ascending."""
        sequence = np.random.SeedSequence(self._seed, spawn_key=(_STREAM, place))
        generator = np.random.Generator(np.random.PCG64(sequence))
        now = 0.0
        while True:
            now += -self._gap_us * log(1.0 - generator.random())
            yield now
