"""Interface of a flight controller: from velocity commands to rotor commands; found by name.

Our own is `mavfi.sim.cascade.Cascade`.  Another one is a class with this interface and an entry point of the group
`mavfi.flight_controllers`, or "package:Class"; a mission chooses it by its key `flight_controller`.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol, cast

import numpy as np

from mavfi.config import VehicleConfig
from mavfi.plugins import load_object

GROUP = "mavfi.flight_controllers"
_SHIPPED = {"cascade": "mavfi.sim.cascade:Cascade"}


class InitialConditions(NamedTuple):
    """Vehicle and state with which a controller starts.

    Attributes:
        vehicle: Airframe.
        odometry: True state: x y z (m), vx vy vz (m/s), unit quaternion w x y z, wx wy wz (rad/s, body). Shape (13,).
        heading: Yaw (rad).
        seed: Of the mission.
    """

    vehicle: VehicleConfig
    odometry: np.ndarray
    heading: float
    seed: int


class Controller(Protocol):
    """A flight controller; constructed from its `InitialConditions`.

    Attributes:
        period_us: Its period and that of the physics (us): 4000 divided by an integer.
        rewindable: Whether `save` and `restore` work, and a forked process has a copy of its own.  If not, flights are
            not fast-forwarded, and faults in instructions, whose runs are forked, are refused.
    """

    period_us: int
    rewindable: bool

    def rotors(self, time_us: int, setpoint: np.ndarray, odometry: np.ndarray, force: np.ndarray) -> np.ndarray:
        """One period: from set-point and state to rotor commands.

        Args:
            time_us: Current time.
            setpoint: Wanted vx vy vz, world frame (m/s), and yaw rate (rad/s), finite and within limits. Shape (4,).
            odometry: True state, as in `InitialConditions`. Shape (13,).
            force: Specific force during the last period, body frame (m/s^2). Shape (3,).

        Returns:
            Commanded rotor thrusts (N), in the order of `mavfi.sim.vehicle`; limited to what a rotor can give, and 0
            where not a number. Shape (4,).
        """

    def save(self) -> bytes:
        """Its complete state."""

    def restore(self, saved: bytes) -> None:
        """Inverse of `save`."""

    def close(self) -> None:
        """Release what it holds, such as a process; may be called twice."""


MakeController = Callable[[InitialConditions], Controller]


def find_controller(name: str) -> MakeController:
    """A controller's class: a shipped name, an entry point of `mavfi.flight_controllers`, or "package:Class".

    Raises:
        BadInputError: It is not known, not allowed, or cannot be imported.
    """
    return cast(MakeController, load_object("flight controller", name, GROUP, _SHIPPED))


def is_rewindable(name: str) -> bool:
    """Whether flights with a controller can be saved, restored and forked."""
    return bool(getattr(find_controller(name), "rewindable", False))
