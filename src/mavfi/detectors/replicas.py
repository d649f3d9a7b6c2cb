"""Copies of a detector that vote, against faults in the detector itself (MAVFI, section IV: several detection nodes).

Each copy has its own memory and sees every publication.  An alarm needs half of the live copies: one of one or two, two
of three.  So of two copies a silent one is covered, and of three a silent or an alarming one.
"""

import copy
from collections import Counter
from collections.abc import Sequence
from typing import Any

from mavfi.detectors.detector import Alarm, Chain, Detector, checked_alarm
from mavfi.errors import BadInputError
from mavfi.states import State

INJECTED = 0
"""Copy with the faults in instructions: the vote is symmetric, so it does not matter which."""


def needed(live: int) -> int:
    """Number of live copies that must agree on an alarm: half of them, rounded up; at least 1."""
    return max(1, (live + 1) // 2)


def voted(alarms: Sequence[Alarm]) -> Alarm:
    """The alarm of several copies: what most of them request, as most of those report it.

    If as many copies make another request, the stronger one counts, whatever their order: a stop, then an abandoned
    way-point.
    """
    requests, reports = Counter(map(_request, alarms)), Counter(alarms)
    return max(alarms, key=lambda alarm: (requests[_request(alarm)], _request(alarm), reports[alarm]))


def _request(alarm: Alarm) -> tuple[bool, bool, bool, str]:
    """What an alarm asks of the host."""
    return alarm.stop, alarm.abandon_waypoint, alarm.hard, alarm.stage


class Replicated(Chain):
    """Copies of a detector that vote, see the module.

    Args:
        copies: Detectors of the same kind, with separate memories.

    Attributes:
        parts: The copies.
        dead: Indices of the copies that are out of service: they see nothing and do not vote.
    """

    def __init__(self, *copies: Any) -> None:  # noqa: ANN401 - `Detector`s
        super().__init__(*copies)
        self.dead: set[int] = set()

    @property
    def live(self) -> list[Any]:
        """The copies in service."""
        return [part for place, part in enumerate(self.parts) if place not in self.dead]

    def start(self) -> None:
        """Reset the memory at the start of a flight; all copies are in service."""
        self.dead = set()
        super().start()

    def score(self, state: State, time_us: int) -> float | None:
        """The score that as many copies reach as an alarm needs; None if the state is not watched."""
        scores = [part.score(state, time_us) for part in self.live if hasattr(part, "score")]
        found = sorted((score for score in scores if score is not None), reverse=True)
        return found[needed(len(found)) - 1] if found else None

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Ask every live copy; a copy that dies meanwhile has no vote."""
        asked = [(place, part) for place, part in enumerate(self.parts) if place not in self.dead]
        found = [(place, part.check(state, time_us)) for place, part in asked]
        raised = [(place, alarm) for place, alarm in found if alarm is not None and place not in self.dead]
        alarms = [checked_alarm(self.parts[place], alarm) for place, alarm in raised]
        return voted(alarms) if len(alarms) >= needed(len(self.live)) else None

    def accept(self, state: State, time_us: int) -> None:
        """Pass a published value to every live copy."""
        for part in self.live:
            part.accept(state, time_us)

    def lose(self) -> None:
        """Take the injected copy out of service."""
        self.dead.add(INJECTED)

    def rejoin(self) -> None:
        """Put the injected copy into service; the caller has initialized it."""
        self.dead.discard(INJECTED)

    def memory(self) -> tuple[Any, ...]:
        """Memories of all copies, and which are dead."""
        return super().memory(), tuple(sorted(self.dead))

    def restore(self, memory: tuple[Any, ...]) -> None:
        """Inverse of `memory`."""
        kept, dead = memory
        super().restore(kept)
        self.dead = set(dead)


def replicated(detector: Detector, copies: int) -> Detector:
    """A detector in so many copies, the first of which is the given one; for one copy it is returned as it is.

    Raises:
        BadInputError: It acts on unpublished values, or cannot be copied.
    """
    if copies == 1:
        return detector
    name = type(detector).__name__
    if detector.seals or detector.duplicates:
        raise BadInputError(f"copies: {copies}: detector {name} takes part in what is not published; allowed: 1")
    try:
        others = [copy.deepcopy(detector) for _ in range(copies - 1)]
    except Exception as error:
        text = f"detector {name} cannot be copied ({type(error).__name__}: {error})"
        raise BadInputError(f"copies: {copies}: {text}; allowed: 1") from error
    return Replicated(detector, *others)
