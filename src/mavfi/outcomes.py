"""Effect of a fault on the computation: `effect_of` compares an injected run with its golden run."""

from enum import Enum

from mavfi.flight_record import End, FlightRecord


class Effect(Enum):
    """Effect of a fault; the value is a sentence for people."""

    MASKED = "Every vehicle state and command is bit for bit that of the golden run."
    SDC = "Silent data corruption: the flight differs from its golden run, and the computation ran to its end."
    CRASH = "The computation ended by a signal."
    HANG = "The computation used up its budget."
    EXCEPTION = "The computation raised an exception."
    DETECTED = "Protected code found a difference, and the step was computed again."
    NOT_ACTIVATED = "The planned site was not reached, or could not be changed."
    UNKNOWN = "Could not be judged: the flight or its golden run has no record."

    @property
    def label(self) -> str:
        """Lower-case name, as in tables and JSON."""
        return self.name.lower()


DUE = (Effect.CRASH, Effect.HANG, Effect.EXCEPTION)
"""Effects that the system notices: detected unrecoverable errors."""


def effect_of(golden: FlightRecord | None, injected: FlightRecord) -> Effect:
    """Effect of a fault on the computation of a whole flight.

    Args:
        golden: The golden run of the same arm; None = there is none.
        injected: The run with the fault. If it died on every attempt, it is a crash unless its host knows better.
    """
    if injected.end is End.DUE:
        return Effect.CRASH if injected.kernel is None else Effect[injected.kernel.effect.upper()]
    if golden is None or not golden.digest or not injected.digest:
        return Effect.UNKNOWN
    if golden.digest == injected.digest:
        return Effect.MASKED
    detected = injected.kernel is not None and injected.kernel.effect == Effect.DETECTED.label
    return Effect.DETECTED if detected else Effect.SDC
