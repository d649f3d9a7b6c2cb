"""What a detector is to a host: it checks published states, may ask for recovery, and never sees a fault."""

import copy
import mmap
import pickle
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar

import numpy as np

from mavfi.errors import BadInputError, MavfiError, hint
from mavfi.ir.forked import WALL_CLOCK, ChildEnd, ForkPoint
from mavfi.states import STAGE_KERNELS, STATES, State

DIFFERENT = 2.0
"""Score of a value that differs from the one sent."""


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
        withhold: With a request for a stop or the next way-point: withhold the value, too, whatever its state; the next
            one of this state is its replacement.  A way-point is withheld in any case.
    """

    source: str
    stage: str
    abandon_waypoint: bool = False
    stop: bool = False
    score: float = 0.0
    fields: tuple[str, ...] = ()
    hard: bool = False
    withhold: bool = False

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


class Detector:
    """Checks the published states of one flight; base class of every detector, with defaults for all but the check.

    The host calls `check` with every publication before a consumer reads it (coupling `inline`).  On an alarm the host
    recomputes the stage and then calls `accept` with the value actually published; without one it calls `accept`
    immediately.  Hence deltas always refer to published values.

    `accept` belongs to the publication that was checked last, or to one that was not checked: a host passes a value
    that is sent again as a copy.

    A constructor with a parameter `limits` receives the `MissionLimits` of the mission, one with `seed` its seed.

    Attributes:
        source: Name in its alarms, and of the target of faults in its instructions and memory.
        states: Names of the states that it reads; a host need not pass it any others.  None = all.
        seals: Whether the host calls `seal` with each value as its producer sends it, before it is injected.
        duplicates: Kernels whose steps the host computes twice, and compares.
        parts: The detectors of which it consists, in the order in which they are asked.
        recovery: Mission keys that go with it, where a command or an arm does not choose them.
        compiled: Its compiled functions in which faults can be injected, by name.
        requested_as: Name by which a mission asked for it; "" = it was constructed otherwise, or is part of mavfi.
    """

    source: str = ""
    requested_as: str = ""
    states: Collection[str] | None = None
    seals: bool = False
    duplicates: tuple[str, ...] = ()
    parts: tuple["Detector", ...] = ()
    recovery: ClassVar[Mapping[str, Any]] = {}

    def start(self) -> None:
        """Reset the memory at the start of a flight."""

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Check a publication; must change neither the memory nor the state, which is the published value itself."""
        return None

    def accept(self, state: State, time_us: int) -> None:
        """Record a published value."""

    def seal(self, state: State, time_us: int) -> None:
        """Record a value as its producer sends it; see `seals`."""

    def score(self, state: State, time_us: int) -> float | None:
        """Score of a publication in units of the threshold (> 1 is an alarm); None if it has none."""
        return None

    def memory(self) -> Any:  # noqa: ANN401 - the detector's own
        """What it remembers between publications; `==` compares it bit for bit.  By default, all of its attributes."""
        return CopiedMemory(vars(self))

    def restore(self, memory: Any) -> None:  # noqa: ANN401
        """Inverse of `memory`."""
        vars(self).clear()
        vars(self).update(copy.deepcopy(memory.attributes))

    def arrays(self) -> dict[str, np.ndarray]:
        """Targets of faults in its memory: the arrays that it remembers between publications, by name, not copies.

        The parameters of its model are not among them.  Called between publications only.
        """
        return {}

    @property
    def compiled(self) -> Mapping[str, Callable[..., Any]]:
        """See the class."""
        return {}

    def instrument(self, instrumented: Mapping[str, Callable[..., Any]]) -> None:
        """Replace functions of `compiled` by those of the same name in `instrumented`; restore all others."""


class CopiedMemory:
    """The memory of a detector that does not say what it remembers.

    Attributes:
        attributes: A deep copy of all of its attributes.
    """

    def __init__(self, attributes: Mapping[str, Any]) -> None:
        self.attributes = copy.deepcopy(dict(attributes))

    def __eq__(self, other: object) -> bool:
        """Whether both have the same pickle; False if either cannot be pickled."""
        if not isinstance(other, CopiedMemory):
            return False
        try:
            return pickle.dumps(self.attributes) == pickle.dumps(other.attributes)
        except Exception:  # noqa: BLE001 - any exception of a user's object
            return False

    __hash__ = None  # type: ignore[assignment]


class NoDetector(Detector):
    """Never raises an alarm, and reads nothing."""

    states = frozenset[str]()

    def check(self, state: State, time_us: int) -> None:
        """Raise no alarm."""


class Chain(Detector):
    """Several detectors in sequence: the first alarm counts."""

    def __init__(self, *detectors: Detector) -> None:
        self.parts = detectors
        self._readers: dict[str, tuple[Detector, ...]] = {}
        if all(part.states is not None for part in detectors):
            self.states = frozenset(name for part in detectors for name in part.states or ())
            for name in self.states:
                self._readers[name] = tuple(part for part in detectors if name in (part.states or ()))

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        for detector in self.parts:
            detector.start()

    def score(self, state: State, time_us: int) -> float | None:
        """The largest score of all detectors."""
        scores = [detector.score(state, time_us) for detector in self.parts]
        return max((score for score in scores if score is not None), default=None)

    def check(self, state: State, time_us: int) -> Alarm | None:
        """The first alarm of any detector."""
        for detector in self._readers.get(state.spec.name, self.parts):
            alarm = detector.check(state, time_us)
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
        for detector, part_memory in zip(self.parts, memory, strict=True):
            detector.restore(part_memory)


def part_of(detector: Detector | None, source: str) -> Any:  # noqa: ANN401 - callers know that there is one
    """The part of a detector that raises alarms as `source`, if it has compiled functions; None = there is none."""
    if detector is None:
        return None
    for part in detector.parts:
        inner: Any = part_of(part, source)
        if inner is not None:
            return inner
    if detector.source == source and detector.compiled:
        return detector
    return None


def class_of(detector: object) -> str:
    """Class of a detector as "package.module:Class", for messages; of several in one, that of the last."""
    while isinstance(detector, Detector) and detector.parts:
        detector = detector.parts[-1]
    return f"{type(detector).__module__}:{type(detector).__qualname__}"


def require_detector(detector: object) -> Detector:
    """An object of a user's own as a detector.

    Raises:
        BadInputError: It is none, or lists states that do not exist; the message names its class.
    """
    if not isinstance(detector, Detector):
        raise BadInputError(f"detector {class_of(detector)}: allowed: an object whose class inherits mavfi.Detector")
    check_states(detector)
    return detector


def check_states(detector: Detector) -> None:
    """Refuse a detector that lists states that do not exist: it would never be asked about them.

    Raises:
        BadInputError: The message names the class, the name and the nearest state.
    """
    states = detector.states
    if states is None:
        return
    source = f"detector {class_of(detector)}: states"
    if isinstance(states, str) or not isinstance(states, Collection):
        raise BadInputError(f"{source}: {states!r:.60}: allowed: a set of names of states, or None")
    for name in sorted(map(str, states)):
        if name not in STATES:
            raise BadInputError(f"{source}: {name!r}: no such state{hint(name, STATES)}; `mavfi states` lists all")


def blind_spots(detector: Detector, localization: str) -> str:
    """Why a detector is not asked about states that it lists, as this localization publishes none; "" = it is.

    One that also lists states of this localization alone is made for either.
    """
    listed = [STATES[name] for name in sorted(detector.states or ())]
    if any(state.only_with == localization for state in listed):
        return ""
    absent = [state for state in listed if not state.exists_with(localization)]
    if not absent:
        return ""
    names = ", ".join(state.name for state in absent)
    return (
        f"detector {class_of(detector)}: states: {names}: never published with localization {localization!r}; "
        f"allowed: localization {absent[0].only_with!r}, or other states"
    )


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


# ---- custom detectors -----------------------------------------------------------------------------------------------
# They are not part of mavfi, so their code may raise, never return, or end the process.  A call in progress is noted in
# memory that a forked process shares with its parent, so that the parent of one that ended in a call, or did not return
# from it, can name it.
_SIZE = 256  # of a noted call (bytes); longer names are cut off
_IDLE = bytes(_SIZE)
"""The note between two calls."""


def is_custom(detector: Any) -> bool:  # noqa: ANN401 - a user's own
    """Whether there is a detector, and it, or one of its parts, is not part of mavfi."""
    if detector is None:
        return False
    if not type(detector).__module__.startswith("mavfi."):
        return True
    return any(is_custom(part) for part in getattr(detector, "parts", ()))


def custom_parts(detector: Detector | None) -> list[Detector]:
    """A detector and its parts, as far as they are not part of mavfi; the detector itself comes last."""
    if detector is None:
        return []
    custom = [inner for part in detector.parts for inner in custom_parts(part)]
    if not type(detector).__module__.startswith("mavfi."):
        custom.append(detector)
    return custom


class CustomCallError(MavfiError):
    """A call of a custom detector did not return, or ended its process."""


class StateChangedError(BadInputError):
    """A custom detector has changed a publication, which belongs to its readers."""


class _CurrentCall:
    """The call of a custom detector that is in progress in this process.

    `note` is None unless this process was forked by `split_noting_calls`: nobody would read it.
    """

    note: mmap.mmap | None = None


class NotedCalls:
    """A custom detector of which each call is noted while it is in progress, and must leave its state as it is.

    Its own change of a state would be another fault, of which no record tells.

    Args:
        detector: The detector.

    Raises:
        StateChangedError: A call has changed the state that it was shown.
    """

    def __init__(self, detector: Any) -> None:  # noqa: ANN401 - a user's own
        self._detector = detector
        self._class = class_of(detector)

    def start(self) -> None:
        """See `Detector`."""
        self._call("start")

    def check(self, state: Any, time_us: int) -> Any:  # noqa: ANN401 - a user may return anything
        """See `Detector`."""
        return self._show("check", state, time_us)

    def accept(self, state: Any, time_us: int) -> None:  # noqa: ANN401
        """See `Detector`."""
        self._show("accept", state, time_us)

    def seal(self, state: Any, time_us: int) -> None:  # noqa: ANN401
        """See `Detector`."""
        self._show("seal", state, time_us)

    def _show(self, method: str, state: State, time_us: int) -> Any:  # noqa: ANN401
        """Show a state to the detector, and compare it afterwards.

        A view that cannot be written would be of another type to compiled functions.
        """
        before = state.copy()
        answer = self._call(method, state, time_us)
        if not state.same_bits(before):
            state.header[:] = before.header  # other flights of the mission are replayed from this very object
            state.elements[:] = before.elements
            raise StateChangedError(
                f"detector {self._class}: {method} changed {state.spec.name} at {1e-6 * time_us:.2f} s, which its "
                "readers get; allowed: to read it, or to change a copy (state.copy())"
            )
        return answer

    def _call(self, method: str, *arguments: Any) -> Any:  # noqa: ANN401
        """Call a method of the detector, noting its name for the message about a process that dies in it."""
        call = getattr(self._detector, method)
        note = _CurrentCall.note
        if note is None:
            return call(*arguments)
        note[:] = f"{self._class}: {method}".encode()[:_SIZE].ljust(_SIZE, b"\0")
        try:
            return call(*arguments)
        finally:
            note[:] = _IDLE


def split_noting_calls(point: ForkPoint, timeout: float) -> ChildEnd | None:
    """As `ForkPoint.split`.

    Raises:
        CustomCallError: The child ended in a call of a custom detector, or did not return from it in time.
    """
    # The child writes to memory that it shares with this process; nested children have a note of their own.
    outer = _CurrentCall.note
    note = _CurrentCall.note = mmap.mmap(-1, _SIZE)
    try:
        ended = point.split(timeout)
    finally:
        if not point.in_child:
            _CurrentCall.note = outer
    if ended is None:  # this is the child
        return None
    # What the child was calling when it ended; empty = no custom detector.
    call = bytes(note).rstrip(b"\0").decode(errors="replace")
    note.close()
    if ended.how == "done" or not call:
        return ended
    if ended.detail == WALL_CLOCK:
        raise CustomCallError(f"detector {call} did not return within {timeout:g} s")
    raise CustomCallError(f"detector {call} ended its process ({ended.detail})")
