"""Degraded mode `hold`: where recovery cannot correct a fault, the mission is given up, and the vehicle holds position.

Its commands replace those of the tracker, whose inputs and memory are no longer trusted; they depend on odometry alone.
"""

import math
from dataclasses import dataclass, field

from mavfi.pipeline.memory import Memory
from mavfi.states import ODOMETRY, State, floats

GAIN = 1.0
"""Commanded speed / distance to the position (1/s)."""
SHARE = 0.5
"""Largest commanded speed / v_max."""
VALID_S = 0.1
"""Validity of a command (s): five control periods."""


@dataclass(slots=True)
class HoldMemory(Memory):
    """Where the vehicle is, and where it shall stay.

    Attributes:
        position: The latest position (m); empty before the first.
        target: The position at which the mode began (m); empty before.
    """

    position: list[float] = field(default_factory=list)
    target: list[float] = field(default_factory=list)


class HoldPosition:
    """Commands that return the vehicle to the position at which the mode began.

    Args:
        v_max: Speed limit of the mission (m/s).

    Attributes:
        states: Names of the states that it reads.
    """

    states = frozenset(ODOMETRY.values())

    def __init__(self, v_max: float) -> None:
        self._max_speed = SHARE * v_max

    def note(self, memory: HoldMemory, odometry: State) -> None:
        """Store the vehicle's position if it is finite."""
        position = floats(odometry.header, 3).tolist()
        if all(map(math.isfinite, position)):
            memory.position = position

    def begin(self, memory: HoldMemory) -> None:
        """Begin the mode at the latest position."""
        memory.target = memory.position

    def command(self, memory: HoldMemory, published: State) -> State | None:
        """The command in place of a published one; None = none: the flight controller hovers."""
        if not memory.target or not memory.position:
            return None
        dx, dy, dz = (target - current for target, current in zip(memory.target, memory.position, strict=True))
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        rate = 0.0  # commanded speed / distance (1/s)
        if distance > 0.0:
            rate = min(GAIN * distance, self._max_speed) / distance
        command = published.copy()
        command.header[0] = (rate * dx, rate * dy, rate * dz, 0.0, VALID_S)
        return command
