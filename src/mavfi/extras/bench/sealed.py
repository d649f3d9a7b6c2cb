"""Detectors that compare: the arriving value with the one sent, or a step with its repetition.

For a checksum and for the oracle, the upper bound of any detector, the host calls `seal` with each value as its
producer sends it, and then `check` with the value that arrives.  They detect corruption in transit but no earlier
errors: a wrong result has a valid checksum.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mavfi.detectors.detector import DIFFERENT, Alarm, Detector
from mavfi.errors import BadInputError
from mavfi.numerics.crc import crc32c
from mavfi.states import KERNELS, PPC_STAGES, STATES, State, StateSpec

ALL = frozenset(name for name, spec in STATES.items() if spec.stage in PPC_STAGES)
"""States published by kernels."""


def _is_large(spec: StateSpec) -> bool:
    """Whether it carries camera data: some 10 to 100 kB, others some 100 bytes (a trajectory: 10 kB)."""
    return bool(spec.elements) and spec.stage == "perception"


SMALL = frozenset(name for name in ALL if not _is_large(STATES[name]))


class Sealed(Detector):
    """Base of both, without memory between publications.

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
        self._sealed = state.spec.name if state.spec.name in self._sealed_states else ""
        if self._sealed:
            self.close(state)

    def score(self, state: State, time_us: int) -> float | None:
        """2 for a value that differs from the one sent, else 0; None if it was not sealed."""
        if state.spec.name != self._sealed:
            return None
        return 0.0 if self.intact(state) else DIFFERENT

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

    def __init__(self, large: bool = False) -> None:
        super().__init__(ALL if large else SMALL)
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
    """Requests that kernel steps are computed twice and compared, see `flight.duplicate`; checks nothing itself.

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
