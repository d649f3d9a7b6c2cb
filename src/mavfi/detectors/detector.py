"""What a detector is to the host: it watches published states, may ask for a recomputation, and never sees a fault."""

from dataclasses import asdict, dataclass
from typing import Any, Protocol

from mavfi.states import State


@dataclass(frozen=True, slots=True)
class Alarm:
    """A detector's request for recovery.

    Attributes:
        source: Which detector or gate raised it, e.g. "gaussian", "autoencoder", "acceptance", "physics_gate".
        stage: Stage to recompute: "perception", "planning" or "control".
        abandon_waypoint: The way-point in force is dropped for the next one (the paper's autoencoder policy).
        stop: Alarms persist: stop and plan anew.
        score: How anomalous, in units of the threshold (> 1 is an alarm).
        fields: The monitored fields that stand out, "state.field".
        hard: A rule is broken, not a statistic exceeded: the same value twice is no proof that it is right.
    """

    source: str
    stage: str
    abandon_waypoint: bool = False
    stop: bool = False
    score: float = 0.0
    fields: tuple[str, ...] = ()
    hard: bool = False

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


class Detector(Protocol):
    """Watches the published states, one flight long.

    The host calls `check` with every publication before it is seen by a consumer (coupling `inline`).  On an alarm the
    host recomputes the stage and then calls `accept` with the value that is really published; without one it calls
    `accept` right away.  So references for deltas are always values that were published.

    A detector may have `states`: names of the states that it wants to see; a host need not show it others.  Without it,
    or where it is None, the detector is shown all of them.

    A detector may also have `memory()` and `restore(memory)`: what it remembers, as plain data that `==` compares bit
    for bit, and its inverse.  A host that goes back to an earlier instant copies a detector without them as a whole.
    """

    def start(self) -> None:
        """Forget the last flight."""

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Judge a publication; must not change what the detector remembers."""

    def accept(self, state: State, time_us: int) -> None:
        """Take note of a value that was published."""


def part_of(detector: Any, source: str) -> Any:  # noqa: ANN401 - a detector of ours
    """The part of a detector that raises alarms as `source`, if its compiled functions can be instrumented; or None.

    It has `compiled`, these functions by name, and `instrument`, which puts others in the place of those with the same
    names, and themselves in the place of all that are not given.
    """
    parts = getattr(detector, "parts", (detector,))
    found = (part for part in parts if getattr(part, "source", "") == source and getattr(part, "compiled", None))
    return next(found, None)
