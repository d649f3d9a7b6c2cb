"""Interface of the plant: the vehicle in its world, as seen by the loop.  `mavfi.sim` implements it with MuJoCo."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from mavfi.mission import Scenario
from mavfi.sim.environments import World


class Plant(Protocol):
    """A vehicle with its sensors.

    Attributes:
        odometry: True state: x y z (m), vx vy vz (m/s), unit quaternion w x y z, wx wy wz (rad/s, body).
            Shape (13,); always the same array object.
        collided: Whether it has touched an obstacle or the ground.
        rejected_commands: Number of commands rejected as non-finite.
    """

    odometry: np.ndarray
    collided: bool
    rejected_commands: int

    @property
    def ray_directions(self) -> np.ndarray:
        """Unit vectors of the camera's pixels, body frame, x forward. Shape (n, 3)."""

    def command(self, velocity_yaw_rate: np.ndarray, duration: float) -> None:
        """Command a velocity (m/s, world frame) and yaw rate (rad/s), shape (4,), for a duration (s)."""

    def advance(self, time_us: int) -> None:
        """Advance the simulation to an instant (us), a multiple of the physics period."""

    def depth(self) -> tuple[np.ndarray, np.ndarray]:
        """Ranges along `ray_directions` (m), float32, and the camera pose, shape (7,)."""

    def imu(self) -> np.ndarray:
        """Specific force (m/s^2) and rates (rad/s), body frame. Shape (6,)."""

    def position_fix(self) -> np.ndarray:
        """Position (m) and heading (rad), world frame. Shape (4,)."""

    def warnings(self) -> list[str]:
        """Warnings of the simulator so far."""

    def snapshot(self) -> Any:  # noqa: ANN401 (each plant has its own form)
        """The complete state, immutable."""

    def restore(self, snapshot: Any) -> None:  # noqa: ANN401
        """Continue from a snapshot."""

    def is_at(self, snapshot: Any) -> bool:  # noqa: ANN401
        """Whether the current state is bit-identical to `snapshot`."""

    def close(self) -> None:
        """Release what the plant holds, such as the process of a flight controller."""


MakePlant = Callable[[World, Scenario], Plant]
"""Constructs the plant of a mission, with the vehicle at the start."""
