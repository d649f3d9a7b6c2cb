"""What moves: the vehicle in its world, as the loop sees it.  MuJoCo (`mavfi.sim`) is one plant."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from mavfi.mission import Scenario
from mavfi.sim.environments import World


class Plant(Protocol):
    """A vehicle with its sensors.

    Attributes:
        odometry: True state: x y z (m), vx vy vz (m/s), unit quaternion w x y z, wx wy wz (rad/s, body).
            Shape (13,); the same array throughout.
        collided: Whether it has touched an obstacle or the ground.
        rejected_commands: How many commands were refused because they were not finite.
    """

    odometry: np.ndarray
    collided: bool
    rejected_commands: int

    @property
    def ray_directions(self) -> np.ndarray:
        """Unit vectors of the camera's pixels, body frame, x forward. Shape (n, 3)."""

    def command(self, velocity_yaw_rate: np.ndarray, duration: float) -> None:
        """Fly at a velocity (m/s, world frame) and yaw rate (rad/s), shape (4,), for so long (s)."""

    def advance(self, time_us: int) -> None:
        """Let time pass until an instant, a multiple of the physics period."""

    def depth(self) -> tuple[np.ndarray, np.ndarray]:
        """Ranges along `ray_directions` (m), float32, and the pose of the camera, shape (7,)."""

    def imu(self) -> np.ndarray:
        """Specific force (m/s^2) and rates (rad/s), body frame. Shape (6,)."""

    def position_fix(self) -> np.ndarray:
        """Position (m) and heading (rad), world frame. Shape (4,)."""

    def warnings(self) -> list[str]:
        """What the simulator complained about so far."""

    def snapshot(self) -> Any:  # noqa: ANN401 (each plant has its own form)
        """The complete state; never changed afterwards."""

    def restore(self, snapshot: Any) -> None:  # noqa: ANN401
        """Continue from a snapshot."""

    def is_at(self, snapshot: Any) -> bool:  # noqa: ANN401
        """Whether `snapshot` would give the same, bit for bit."""


MakePlant = Callable[[World, Scenario], Plant]
"""Puts the vehicle of a mission at its start."""
