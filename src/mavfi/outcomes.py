"""What a fault did to a flight: `classify` compares an injected flight with its golden twin."""

from dataclasses import dataclass
from enum import Enum


class Outcome(Enum):
    """Effect of a fault; the value is a sentence for people."""

    MASKED = "Every vehicle state and command is bit for bit that of the golden twin."
    SDC = "The flight differs from its golden twin, and the computation ran to its end."
    DUE = "The computation crashed, raised or hung: the error was detected, and not recovered."
    UNKNOWN = "Could not be judged: the flight or its golden twin has no record."

    @property
    def label(self) -> str:
        """Lower-case name, as in tables and JSON."""
        return self.name.lower()


@dataclass(frozen=True, slots=True)
class FlightEnd:
    """What a verdict rests on.

    Attributes:
        digest: Digest of the flight; None if there is no log.
        died: Whether the computation died of its budget or took its process with it.
    """

    digest: str | None
    died: bool = False


def classify(golden: FlightEnd | None, injected: FlightEnd) -> Outcome:
    """Judge a flight with a fault.

    Args:
        golden: The error-free twin of the same setting (with the same detector, if there is one).
        injected: The flight with the fault.
    """
    if injected.died:
        return Outcome.DUE
    if golden is None or golden.digest is None or injected.digest is None:
        return Outcome.UNKNOWN
    return Outcome.MASKED if golden.digest == injected.digest else Outcome.SDC
