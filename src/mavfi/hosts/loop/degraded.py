"""Degraded modes: set-points for the vehicle when recovery cannot correct a fault, and the mission is given up.

They replace the tracker's commands, whose inputs and memory are no longer trusted, and depend on odometry alone.
"""

import math
from dataclasses import dataclass, field
from typing import Literal

from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.pipeline.memory import Memory
from mavfi.states import ODOMETRY, State, floats

Degraded = Literal["none", "hover", "hold", "back"]
MODES = ("hover", "hold", "back")
SPACING = 1.0
"""Distance between stored positions of the flown path (m)."""
REACHED = 0.5
"""Distance at which a stored position counts as reached (m); less than `SPACING`."""
SHARE = 0.5
"""Largest commanded speed / v_max."""
VALID_S = 0.1
"""Validity of a command (s): five control periods."""


@dataclass(slots=True)
class Trail(Memory):
    """Where the vehicle is, and where it has been.

    Attributes:
        position: The latest position (m); empty before the first.
        points: Positions of the flown path, oldest first, then the target (m).
    """

    position: list[float] = field(default_factory=list)
    points: list[list[float]] = field(default_factory=list)


class Setpoints:
    """Commands of a degraded mode.

    `hover`: none, so the flight controller hovers when the last command has expired.  `hold`: return to the position at
    which the mode began, and stay.  `back`: return to the start along the flown path, and stay.

    Args:
        mode: The mode.
        v_max: Speed limit of the mission (m/s).
        functions: Functions that it calls: compiled or instrumented.

    Attributes:
        states: Names of the states that it reads.
    """

    states = frozenset(ODOMETRY.values())

    def __init__(self, mode: Degraded, v_max: float, functions: KernelFunctions = PLAIN) -> None:
        self._mode, self._largest, self._functions = mode, SHARE * v_max, functions

    def note(self, trail: Trail, odometry: State, *, flown: bool) -> None:
        """Store the vehicle's position if it is finite; `flown`: it belongs to the path that `back` follows."""
        position = floats(odometry.header, 3).tolist()
        if not all(map(math.isfinite, position)):
            return
        trail.position = position
        if flown and self._mode == "back" and not (trail.points and self._away(trail) < SPACING):
            trail.points.append(position)

    def begin(self, trail: Trail) -> None:
        """Begin the mode at the latest position."""
        if self._mode == "hold":
            trail.points = [trail.position]

    def command(self, trail: Trail, published: State) -> State | None:
        """The command in place of a published one; None = none."""
        while len(trail.points) > 1 and self._away(trail) < REACHED:
            trail.points.pop()
        if self._mode == "hover" or not trail.points or not trail.position:
            return None
        rate = self._functions.closing_rate(self._away(trail), self._largest)
        velocity = [rate * (end - start) for start, end in zip(trail.position, trail.points[-1], strict=True)]
        command = published.copy()
        command.header[0] = (*velocity, 0.0, VALID_S)
        return command

    def _away(self, trail: Trail) -> float:
        """Distance to the newest stored position (m)."""
        away: float = self._functions.distance(*trail.position, *trail.points[-1])
        return away
