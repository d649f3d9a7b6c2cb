"""Detectors that compare what arrives with what its producer sent: a checksum, and the bound that no detector exceeds.

The host calls `seal` with each value as its producer hands it over, and then `check` with what came of it.  So they see
what happens to a value on its way, and nothing that happens before: a wrong result has the right checksum.
"""

from abc import ABC, abstractmethod

import numpy as np

from mavfi.detectors.detector import Alarm
from mavfi.numerics.crc import crc32c
from mavfi.states import PPC_STAGES, STATES, State, StateSpec

DIFFERENT = 2.0
"""Score of a value that is not what was sent."""
ALL = frozenset(name for name, spec in STATES.items() if spec.stage in PPC_STAGES)
"""What kernels publish."""


def _is_large(spec: StateSpec) -> bool:
    """Whether it holds what a camera sees: some 10 to 100 kB, the others some 100 bytes (a trajectory: 10 kB)."""
    return bool(spec.elements) and spec.stage == "perception"


SMALL = frozenset(name for name in ALL if not _is_large(STATES[name]))


class Sealed(ABC):
    """Base of both.  From one publication to the next nothing is remembered.

    Args:
        states: Names of the states that are sealed.
    """

    source: str

    def __init__(self, states: frozenset[str]) -> None:
        self._states = states
        self.start()

    @abstractmethod
    def intact(self, state: State) -> bool:
        """Whether a value is what was sealed last."""

    @abstractmethod
    def close(self, state: State) -> None:
        """Seal a value."""

    def start(self) -> None:
        """Forget the last flight."""
        self._sealed = ""

    def seal(self, state: State, time_us: int) -> None:
        """Take a value as its producer hands it over."""
        self._sealed = state.spec.name if state.spec.name in self._states else ""
        if self._sealed:
            self.close(state)

    def score(self, state: State, time_us: int) -> float | None:
        """2 of a value that is not what was sent, else 0; None if it was not sealed."""
        if state.spec.name != self._sealed:
            return None
        return 0.0 if self.intact(state) else DIFFERENT

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Judge a publication."""
        score = self.score(state, time_us)
        if not score:
            return None
        return Alarm(self.source, state.spec.stage.value, score=score, fields=(state.spec.name,), hard=True)

    def accept(self, state: State, time_us: int) -> None:  # noqa: B027 - there is nothing to remember
        """Nothing is learned."""

    def memory(self) -> tuple[()]:
        """What is remembered, see `Detector`."""
        return ()

    def restore(self, memory: tuple[()]) -> None:
        """Inverse of `memory`."""
        self.start()


class Checksum(Sealed):
    """CRC-32C of header and elements.

    Args:
        large: Whether clouds and map updates have one, too.
    """

    source = "checksum"

    def __init__(self, large: bool = False) -> None:
        super().__init__(ALL if large else SMALL)
        self._sum = 0

    def close(self, state: State) -> None:
        """Note the checksum."""
        self._sum = checksum(state)

    def intact(self, state: State) -> bool:
        """Whether a value has the checksum that was noted."""
        return checksum(state) == self._sum


class Oracle(Sealed):
    """An alarm at exactly the values that were changed on their way: a bound for detectors of faults in states."""

    source = "oracle"

    def __init__(self) -> None:
        super().__init__(ALL)
        self._sent: State | None = None

    def close(self, state: State) -> None:
        """Keep it; published values never change."""
        self._sent = state

    def intact(self, state: State) -> bool:
        """Whether a value is the kept one, bit for bit."""
        return self._sent is not None and (state is self._sent or state.same_bits(self._sent))


def checksum(state: State) -> int:
    """CRC-32C of the bytes of a state: header, then elements."""
    value = crc32c(state.header.view(np.uint8), 0)
    if len(state.elements):
        value = crc32c(np.ascontiguousarray(state.elements).view(np.uint8), value)
    return int(value)
