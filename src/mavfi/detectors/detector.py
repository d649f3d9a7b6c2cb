"""Interface of host and detector: it checks published states, may request recomputation, and never sees a fault."""

from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from mavfi.errors import BadInputError, hint
from mavfi.states import STAGE_KERNELS, STATES, State


@dataclass(frozen=True, slots=True)
class Alarm:
    """A detector's request for recovery.

    Attributes:
        source: Detector or gate that raised it, e.g. "gaussian", "autoencoder", "acceptance", "physics_gate".
        stage: Stage to recompute: "perception", "planning" or "control".
        abandon_waypoint: Skip the way-point in force for the next one (the paper's autoencoder policy).
        stop: Alarms persist: stop and replan.
        score: Anomaly score in units of the threshold (> 1 is an alarm).
        fields: The anomalous monitored fields, "state.field".
        hard: A rule is violated, not a statistic exceeded: recomputing the same value does not prove it right.
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
    """Checks the published states of one flight.

    The host calls `check` with every publication before a consumer reads it (coupling `inline`).  On an alarm the host
    recomputes the stage and then calls `accept` with the value actually published; without one it calls `accept`
    immediately.  Hence deltas always refer to published values.

    A detector may have `states`, the names of the states that it reads; a host need not pass it any others.  If absent
    or None, the detector receives all states.

    `accept` belongs to the publication that was checked last, or to one that was not checked: a host passes a value
    that is sent again as a copy.

    A detector may have `at_once`, an `AtOnce`, always the same object: what a host asks first, see `admission`.  A
    subclass of it that changes `check` or `accept` needs its own; else the host calls these two.  With `retract()`,
    which takes back the publication accepted at once last, it can be in front of others in a `Chain`.

    A detector whose memory can be injected has `arrays()`: the arrays that it remembers between publications, by name,
    not copies; without the parameters of its model, and called between publications only.

    A detector may also have `memory()` and `restore(memory)`: its memory as plain data that `==` compares bit for bit,
    and the inverse.  A host that restores a checkpoint copies a detector without these methods as a whole.
    """

    def start(self) -> None:
        """Reset the memory at the start of a flight."""

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Check a publication; must change neither the memory nor the state, which is the published value itself."""

    def accept(self, state: State, time_us: int) -> None:
        """Record a published value."""


class AtOnce(dict[str, Callable[..., object]]):
    """By state: a function of the header that accepts a publication or returns a true value.

    The latter means that it takes longer: there is an alarm, or the state is not in the dictionary.
    """

    def __missing__(self, name: str) -> Callable[..., object]:
        """The answer for other states."""
        return _takes_longer


def _takes_longer(header: Any) -> bool:  # noqa: ANN401 - an array
    return True


class Admission(NamedTuple):
    """How a host passes publications to a detector: most pass `at_once`, without a further call in Python.

    Attributes:
        at_once: Asked first, by name of the state, with the header.
        otherwise: Called with state and time (us) if that returns a true value: `check`, then `accept` if no alarm.
    """

    at_once: AtOnce
    otherwise: Callable[[State, int], Alarm | None]

    def __call__(self, state: State, time_us: int) -> Alarm | None:
        """Pass a publication, and return the alarm on it."""
        return self.otherwise(state, time_us) if self.at_once[state.spec.name](state.header) else None


def admission(detector: Detector) -> Admission:
    """How to pass publications to a detector; only by `check` and `accept` if a subclass changes these."""

    def admit(state: State, time_us: int) -> Alarm | None:
        alarm = detector.check(state, time_us)
        if alarm is None:
            detector.accept(state, time_us)
        return alarm

    most = min(_level_of(detector, "check"), _level_of(detector, "accept"))
    own: Any = detector
    at_once = own.at_once if _level_of(detector, "at_once") <= most else AtOnce()
    return Admission(at_once, admit)


def _level_of(detector: Detector, method: str) -> float:
    """How many classes come before the one that defines a method: 0 is the object itself; infinite if none does."""
    places = (detector, *type(detector).__mro__)
    return next((place for place, own in enumerate(places) if method in getattr(own, "__dict__", {})), float("inf"))


def part_of(detector: Any, source: str) -> Any:  # noqa: ANN401 - a detector of ours
    """The part of a detector whose attribute is `source`, if its compiled functions can be instrumented; else None.

    That is the part that raises alarms as `source`, or one with its code, like the single rules of the acceptance test.

    It has `compiled`, these functions by name, and `instrument`, which replaces the functions of the given names and
    restores all others.
    """
    parts = getattr(detector, "parts", None)
    if parts is not None:
        return next((found for part in parts if (found := part_of(part, source)) is not None), None)
    return detector if getattr(detector, "source", "") == source and getattr(detector, "compiled", None) else None


def class_of(detector: Any) -> str:  # noqa: ANN401 - a user's own
    """Class of a detector as "package.module:Class", for messages; of several in one, that of the last."""
    while parts := getattr(detector, "parts", ()):
        detector = parts[-1]
    return f"{type(detector).__module__}:{type(detector).__qualname__}"


def check_states(detector: Any) -> None:  # noqa: ANN401 - a user's own
    """Refuse a detector that lists states that do not exist: it would never be asked about them.

    Raises:
        BadInputError: The message names the class, the name and the nearest state.
    """
    states = getattr(detector, "states", None)
    if states is None:
        return
    place = f"detector {class_of(detector)}: states"
    if isinstance(states, str) or not isinstance(states, Collection):
        raise BadInputError(f"{place}: {states!r:.60}: allowed: a set of names of states, or None")
    for name in sorted(map(str, states)):
        if name not in STATES:
            raise BadInputError(f"{place}: {name!r}: no such state{hint(name, STATES)}; `mavfi states` lists all")


def checked_alarm(detector: Any, alarm: Any) -> Alarm:  # noqa: ANN401 - a user's own
    """The alarm that a detector's `check` returned.

    Raises:
        BadInputError: It is no `Alarm`, names a stage that cannot be recomputed, or its score is no number.
    """
    if not isinstance(alarm, Alarm):
        text = f"check returned {alarm!r:.60}; allowed: an Alarm, or None"
        raise BadInputError(f"detector {class_of(detector)}: {text}")
    if alarm.stage not in STAGE_KERNELS:
        text = f"stage {alarm.stage!r}: cannot be run again; allowed: {', '.join(STAGE_KERNELS)}"
        raise BadInputError(f"detector {class_of(detector)}: alarm {alarm.source!r}: {text}")
    score: Any = alarm.score
    if type(score) is float:
        return alarm
    if not isinstance(score, (int, float, np.integer, np.floating)):
        text = f"score {score!r:.60}: allowed: a number, in units of the threshold"
        raise BadInputError(f"detector {class_of(detector)}: alarm {alarm.source!r}: {text}")
    return replace(alarm, score=float(score))
