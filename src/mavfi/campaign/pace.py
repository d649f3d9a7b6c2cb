"""Speed of a campaign, and its remaining time.

Golden runs come first and take a complete flight; injected runs start at a checkpoint, and those of a mission arrive in
bursts, cheap ones first.  So no estimate is made before a mission is complete; then it follows from the mean wall time
of each kind of run in complete missions, and from the number of concurrent missions.
"""

import itertools
import math
from collections import deque
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field

WINDOW = 400
"""Number of latest runs on which an estimate is based."""
_ENOUGH = 50
"""Number of injected runs after which an estimate does not wait for the first complete mission."""


@dataclass(slots=True)
class Pace:
    """Statistics of completed runs; `begun`: start of the first one (s, any clock)."""

    begun: float
    _ends: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW))
    _walls: deque[tuple[bool, float]] = field(default_factory=lambda: deque(maxlen=WINDOW))  # of complete missions
    _sums: dict[bool, tuple[int, float]] = field(default_factory=lambda: {True: (0, 0.0), False: (0, 0.0)})  # of _walls
    _open: dict[Hashable, list[tuple[bool, float]]] = field(default_factory=dict)  # by mission: golden, wall time (s)
    _missions: int = 0  # complete ones

    def note(self, now: float, mission: Hashable, golden: bool, wall_s: float) -> None:
        """Add a completed run."""
        if len(self._ends) == WINDOW:
            self.begun = self._ends[0]
        self._ends.append(now)
        self._open.setdefault(mission, []).append((golden, wall_s))

    def over(self, mission: Hashable) -> None:
        """Mark a mission as complete."""
        self._missions += 1
        for golden, wall_s in self._open.pop(mission, ()):
            if len(self._walls) == WINDOW:
                first, first_s = self._walls[0]
                self._sums[first] = _sum(self._sums[first], -1, -first_s)
            self._walls.append((golden, wall_s))
            self._sums[golden] = _sum(self._sums[golden], 1, wall_s)

    @property
    def rate(self) -> float:
        """Runs per second over the window; 0 = unknown yet."""
        seconds = self._ends[-1] - self.begun if self._ends else 0.0
        return len(self._ends) / seconds if seconds > 0 else 0.0

    def remaining_s(self, left: Mapping[bool, int], together: int) -> float:
        """Remaining wall time (s), see `left_s`."""
        if self._missions:
            return left_s(left, self._sums, self._missions, together)
        walls = {True: (0, 0.0), False: (0, 0.0)}
        for golden, wall_s in itertools.chain(*self._open.values()):
            walls[golden] = _sum(walls[golden], 1, wall_s)
        return left_s(left, walls, self._missions, together)


def _sum(known: tuple[int, float], number: int, wall_s: float) -> tuple[int, float]:
    return known[0] + number, known[1] + wall_s


def left_s(left: Mapping[bool, int], walls: Mapping[bool, tuple[int, float]], missions: int, together: int) -> float:
    """Remaining wall time of a campaign (s); infinite = unknown yet.

    Args:
        left: Number of remaining runs; key: whether golden.
        walls: Number and total wall time (s) of completed runs; key: whether golden.  A kind without completed runs is
            assumed to take as long as the other.
        missions: Number of complete missions.
        together: Number of concurrent missions.
    """
    if not any(left.values()):
        return 0.0
    if not together or (not missions and walls.get(False, (0, 0.0))[0] < _ENOUGH):
        return math.inf
    means = {golden: wall_s / number for golden, (number, wall_s) in walls.items() if number}
    if not means:
        return math.inf
    return sum(number * means.get(golden, max(means.values())) for golden, number in left.items()) / together
