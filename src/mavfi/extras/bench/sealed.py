"""Bounds of detectors: those that compare a value with the one sent or a step with its repetition, and random alarms.

For a checksum and for the oracle, the upper bound of any detector, the host calls `seal` with each value as its
producer sends it, and then `check` with the value that arrives.  They detect corruption in transit but no earlier
errors: a wrong result has a valid checksum.  Random alarms are the lower bound, and the cost of false alarms.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mavfi.detectors.detector import DIFFERENT, Alarm, Detector
from mavfi.errors import BadInputError
from mavfi.numerics.crc import crc32c
from mavfi.numerics.elementary import log
from mavfi.states import KERNELS, PPC_STAGES, STATES, State, states_with

ALL = frozenset(name for name, spec in STATES.items() if spec.stage in PPC_STAGES)
"""States published by kernels."""


SMALL = frozenset(name for name in ALL if not (STATES[name].elements and STATES[name].stage == "perception"))
"""Those of some 100 bytes (a trajectory: 10 kB); the others carry camera data of some 10 to 100 kB."""


class Sealed(Detector):
    """Base of detectors that compare a value with the one sent; they have no memory between publications.

    Args:
        states: Names of the sealed states.
    """

    seals = True

    def __init__(self, states: frozenset[str]) -> None:
        self._sealed_states = states
        self.start()

    @abstractmethod
    def intact(self, state: State) -> bool:
        """Whether a value equals the one sealed last."""

    @abstractmethod
    def close(self, state: State) -> None:
        """Seal a value."""

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        self._sealed = ""

    def seal(self, state: State, time_us: int) -> None:
        """Seal a value as its producer sends it."""
        if state.spec.name in self._sealed_states:
            self._sealed = state.spec.name
        else:
            self._sealed = ""
        if self._sealed:
            self.close(state)

    def score(self, state: State, time_us: int) -> float | None:
        """2 for a value that differs from the one sent, else 0; None if it was not sealed."""
        if state.spec.name != self._sealed:
            return None
        if self.intact(state):
            return 0.0
        return DIFFERENT

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Check a publication."""
        score = self.score(state, time_us)
        if not score:
            return None
        return Alarm(self.source, state.spec.stage.value, score=score, fields=(state.spec.name,), hard=True)

    def memory(self) -> tuple[()]:
        """Memory between publications, see `Detector`."""
        return ()

    def restore(self, memory: tuple[()]) -> None:
        """Inverse of `memory`."""
        self.start()


class Checksum(Sealed):
    """CRC-32C of header and elements.

    Args:
        large: Whether to include clouds and map updates.
    """

    source = "checksum"

    def __init__(self, *, large: bool = False) -> None:
        if large:
            super().__init__(ALL)
        else:
            super().__init__(SMALL)
        self._sum = 0
        self.instrument({})

    @property
    def compiled(self) -> Mapping[str, Callable[..., Any]]:
        """See `Detector`."""
        return {"crc32c": crc32c}

    def instrument(self, made: Mapping[str, Callable[..., Any]]) -> None:
        """See `Detector`."""
        self._crc32c: Callable[..., int] = made.get("crc32c", crc32c)

    def close(self, state: State) -> None:
        """Store the checksum."""
        self._sum = self.checksum(state)

    def intact(self, state: State) -> bool:
        """Whether a value has the stored checksum."""
        return self.checksum(state) == self._sum

    def checksum(self, state: State) -> int:
        """CRC-32C of the bytes of a state: header, then elements."""
        value = self._crc32c(state.header.view(np.uint8), 0)
        if len(state.elements):
            value = self._crc32c(np.ascontiguousarray(state.elements).view(np.uint8), value)
        return int(value)


class Oracle(Sealed):
    """An alarm for exactly the values corrupted in transit: upper bound for detectors of faults in states."""

    source = "oracle"

    def __init__(self) -> None:
        super().__init__(ALL)
        self._sent: State | None = None

    def close(self, state: State) -> None:
        """Store the value; published values never change."""
        self._sent = state

    def intact(self, state: State) -> bool:
        """Whether a value equals the stored one, bit for bit."""
        return self._sent is not None and (state is self._sent or state.same_bits(self._sent))


class Duplicate(Detector):
    """Requests that kernel steps are computed twice and compared, see `flight.recovery`; checks nothing itself.

    Args:
        kernels: The kernels.

    Raises:
        BadInputError: Unknown kernel.
    """

    states = frozenset[str]()

    def __init__(self, kernels: Sequence[str] = ("collision_check", "trajectory", "waypoint")) -> None:
        unknown = [name for name in kernels if name not in KERNELS]
        if unknown:
            raise BadInputError(f"kernels: {', '.join(unknown)}: not known; allowed: {', '.join(KERNELS)}")
        self.duplicates = tuple(kernels)


# ---- random alarms --------------------------------------------------------------------------------------------------

_STREAM = 7
"""Number of the random streams of these alarms among those of a mission."""
_SCORE = 2.0
_HOUR_US = 3.6e9
"""An hour (us)."""


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
        self._instants = {name: self._process(number) for name, number in self._order.items()}
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
        if self.check(state, time_us) is None:
            return 0.0
        return _SCORE

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

    def _process(self, state_number: int) -> Iterator[float]:
        """Instants of the alarms of a state (us), ascending; each state has its own random stream."""
        sequence = np.random.SeedSequence(self._seed, spawn_key=(_STREAM, state_number))
        generator = np.random.Generator(np.random.PCG64(sequence))
        now = 0.0
        while True:
            now += -self._gap_us * log(1.0 - generator.random())
            yield now
