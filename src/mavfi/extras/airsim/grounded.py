"""A vehicle that starts on the ground; motors, pose, wind, obstacles and cameras change at run time.

Missions start in the air and end at the first contact; the bridges need more.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavfi.config import CameraConfig
from mavfi.errors import BadInputError
from mavfi.mission import Scenario
from mavfi.numerics.elementary import cos, sin
from mavfi.numerics.rotations import rotation_matrix, yaw_of
from mavfi.numerics.vectors import product
from mavfi.sim.camera import Camera, cast_rays, pixel_directions
from mavfi.sim.engine import GRAVITY
from mavfi.sim.environments.world import World
from mavfi.sim.scene import ACCELEROMETER, STEP_US
from mavfi.sim.simulator import Simulator
from mavfi.sim.vehicle import hover_thrusts

GROUND, SCAN = -1, -2
"""`Contact.obstacle` of the ground, and of the voxels of a scan."""
_ON_GROUND = 0.01
"""Height below which a vehicle can rest (m)."""
_NO_MOUNT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
Rotors = Callable[[int, np.ndarray], np.ndarray]
"""Rotor commands (N), shape (4,), from time (us) and odometry, shape (13,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """A contact of the collision sphere.

    Attributes:
        time_us: Time.
        vehicle: Position of the vehicle, world frame (m). Shape (3,).
        point: Place of the contact, world frame (m). Shape (3,).
        normal: From the obstacle to the vehicle, unit vector. Shape (3,).
        depth: Penetration (m).
        obstacle: Index of the box, `GROUND` or `SCAN`.
    """

    time_us: int
    vehicle: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    depth: float
    obstacle: int


def on_the_ground(world: World, radius: float) -> World:
    """The world with its start on the ground.

    Raises:
        BadInputError: It has no ground plane, or an obstacle stands at that place.
    """
    if world.is_voxels:
        raise BadInputError(
            "start on the ground: the environment is a scan, without a ground plane; allowed: in flight"
        )
    start = np.array([*world.start[:2], radius])
    if len(world.lower):
        gaps = np.maximum(np.maximum(world.lower - start, start - world.upper), 0.0)
        if (np.square(gaps).sum(axis=1) < radius * radius).any():
            raise BadInputError(
                f"start on the ground: an obstacle stands at {start[0]:g} {start[1]:g}; allowed: in flight"
            )
    return replace(world, start=start)


class Grounded(Simulator):
    """A `Simulator` with motors that can be off.

    Attributes:
        world: Its world, with obstacles added at run time.
        armed: Whether the motors run.
        resting: Whether it stands on the ground with the motors off or idle; nothing moves it then.
        rotors: Rotor commands in place of the flight controller's; None = the controller flies.
        touched: The last contact with an obstacle; None = none since the start.
        landed_at: The last contact with the ground; None = none in flight.
    """

    def __init__(self, world: World, scenario: Scenario, *, on_ground: bool = True) -> None:
        """Place the vehicle at the start: on the ground with motors off, or hovering as in a mission.

        Raises:
            BadInputError: The world has no free ground below the start.
        """
        self.world = on_the_ground(world, scenario.vehicle.collision_radius) if on_ground else world
        super().__init__(self.world, scenario)
        self._rays: dict[CameraConfig, np.ndarray] = {}
        self.armed, self.resting = not on_ground, False
        self.rotors: Rotors | None = None
        self.touched: Contact | None = None
        self.landed_at: Contact | None = None
        if on_ground:
            self._thrusts[:] = 0.0
            self._rest()

    # ---- time -------------------------------------------------------------------------------------------------------
    def advance(self, time_us: int) -> None:
        """See `Simulator.advance`."""
        if time_us % STEP_US or time_us < self.time_us:
            raise BadInputError(f"time {time_us} us: must be a multiple of {STEP_US} us from {self.time_us} us on")
        while self.time_us < time_us:
            if self.resting and (self.rotors is None or not self.armed):
                self.time_us = time_us
                return
            self.resting = False
            if self.armed and self.rotors is None:
                super().advance(self.time_us + STEP_US)
            else:
                self._advance_rotors(self.time_us + STEP_US)
            self._note_contacts()

    def _advance_rotors(self, time_us: int) -> None:
        """Advance with rotor commands of another source, or with the motors off."""
        wind, off = self._weather.until(1e-6 * time_us), np.zeros(4)
        while self.time_us < time_us:
            wanted = self.rotors(self.time_us, self.odometry) if self.armed and self.rotors is not None else off
            self._turn_rotors(wind, wanted)

    def _note_contacts(self) -> None:
        """Separate obstacles from the ground; a disarmed vehicle that touches the ground comes to rest."""
        if self._voxels.occupied.size and self.collided:
            here = self.odometry[:3].copy()
            self.touched = Contact(self.time_us, here, here, np.zeros(3), 0.0, SCAN)
        for index in range(self._data.ncon):
            contact = self._data.contact[index]
            other = int(min(contact.geom1, contact.geom2))  # the collision sphere is the last geom
            sign = 1.0 if contact.geom1 == other else -1.0
            noted = Contact(
                self.time_us,
                self.odometry[:3].copy(),
                np.array(contact.pos),
                sign * np.array(contact.frame[:3]),
                max(0.0, -float(contact.dist)),
                other - 1,
            )
            if noted.obstacle == GROUND:
                self.landed_at = noted
            else:
                self.touched = noted
        if self.landed_at is not None and self.landed_at.time_us == self.time_us and not self.armed:
            self._rest()

    def _rest(self) -> None:
        """Stand on the ground: level, at rest."""
        height, yaw = self._airframe.collision_radius, float(yaw_of(self.odometry[6:10]))
        self._set_state(np.array([*self.odometry[:2], height]), (cos(0.5 * yaw), 0.0, 0.0, sin(0.5 * yaw)))
        self._data.sensordata[ACCELEROMETER] = (0.0, 0.0, GRAVITY)
        self.resting = True

    def _set_state(self, position: np.ndarray, quaternion: Sequence[float]) -> None:
        self._data.qpos[:3], self._data.qpos[3:7], self._data.qvel[:] = position, quaternion, 0.0
        self._data.qfrc_applied[:] = 0.0
        self._derive()
        self.odometry[:3], self.odometry[3:6] = self._data.qpos[:3], 0.0
        self.odometry[6:10], self.odometry[10:] = self._data.qpos[3:7], 0.0

    # ---- commands ---------------------------------------------------------------------------------------------------
    def command(self, velocity_yaw_rate: np.ndarray, duration: float) -> None:
        """See `Simulator.command`; a command with a duration above 0 ends the rest of an armed vehicle."""
        super().command(velocity_yaw_rate, duration)
        if self.armed and self._expiry_us > self.time_us:
            self.resting = False

    def rest(self) -> None:
        """Stand still, with the motors idle, if the vehicle is on the ground."""
        if self.height < _ON_GROUND and not self._voxels.occupied.size:
            self._rest()

    @property
    def height(self) -> float:
        """Height of the collision sphere above the ground plane (m)."""
        return float(self.odometry[2]) - self._airframe.collision_radius

    @property
    def max_thrust(self) -> float:
        """Largest thrust of one rotor (N)."""
        return self._airframe.max_thrust

    def arm(self, on: bool) -> None:
        """Switch the motors on or off."""
        self.armed, self.rotors = on, None
        if on:
            self._new_controller()

    def place(self, position: np.ndarray, quaternion: np.ndarray) -> None:
        """Put the vehicle to a pose, at rest; in the air with running motors it hovers there.

        Args:
            position: World frame (m). Shape (3,).
            quaternion: Unit quaternion w x y z, body to world. Shape (4,).

        Raises:
            BadInputError: A value is not finite, or the quaternion is zero.
        """
        values, norm = np.concatenate([position, quaternion]), float(np.sqrt(np.square(quaternion).sum()))
        if not np.isfinite(values).all() or not norm > 0.0:
            raise BadInputError(f"pose {values.tolist()}: allowed: finite numbers, and an orientation other than zero")
        self._set_state(position, tuple(float(value) / norm for value in quaternion))
        self._data.sensordata[ACCELEROMETER] = (0.0, 0.0, GRAVITY)
        self.touched = self.landed_at = None
        self.collided = False
        self.resting = False
        self.rest()
        self._new_controller()

    def bump(self, contact: Contact, change: np.ndarray) -> None:
        """Note a contact with something that the world does not contain, and change the velocity (m/s). Shape (3,)."""
        self.touched = contact
        self._data.qvel[:3] += change
        self.odometry[3:6] = self._data.qvel[:3]

    def _new_controller(self) -> None:
        """Restart the flight controller from the current state."""
        self.controller.close()
        self._thrusts[:] = hover_thrusts(self._airframe) if self.armed else 0.0
        self._setpoint[:], self._expiry_us = 0.0, 0
        self.controller = self._make_controller(float(yaw_of(self.odometry[6:10])))

    # ---- scene ------------------------------------------------------------------------------------------------------
    def set_wind(self, mean: Sequence[float]) -> None:
        """Set the mean wind, world frame (m/s); raises `BadInputError` for one that is not allowed."""
        self._weather.set_mean(mean)

    def set_boxes(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Replace the obstacles of a world of boxes.

        Args:
            lower: Lower corners (m). Shape (n, 3).
            upper: Upper corners (m). Shape (n, 3).
        """
        self.world = replace(self.world, lower=lower, upper=upper)
        physics, old = self._physics(), self._data
        self._build(self.world, self.controller.period_us)
        self._set_physics(physics)
        self._derive()
        self._data.sensordata[:], self._data.warning.number[:] = old.sensordata, old.warning.number
        self._camera = Camera(self._scenario.camera, self.world, self._camera.noise_key)

    def ranges(self, camera: CameraConfig, mount: Sequence[float] = _NO_MOUNT) -> tuple[np.ndarray, np.ndarray]:
        """Depth image of any camera, without noise.

        Args:
            camera: Size, field of view and range; its own noise and period do not count.
            mount: Position (m) and unit quaternion w x y z in the body frame (x forward, y left, z up). Shape (7,).

        Returns:
            Ranges along the rays (m), infinity beyond the camera's range, shape (height * width,), float32; and the
            directions of the rays in the camera's frame, shape (height * width, 3).
        """
        if camera not in self._rays:
            self._rays[camera] = _read_only(pixel_directions(camera))
        directions = self._rays[camera]
        return self.cast(directions, camera.range, mount), directions

    def cast(self, directions: np.ndarray, limit: float, mount: Sequence[float] = _NO_MOUNT) -> np.ndarray:
        """Ranges along rays (m), float32, infinity beyond the limit (m).

        Args:
            directions: Unit vectors in the sensor's frame. Shape (n, 3).
            limit: Range (m).
            mount: As for `ranges`.
        """
        ranges = np.empty(len(directions), np.float32)
        pose = np.array(self.sensor_pose(mount))
        cast_rays(self._camera.columns, self._voxels, pose, _read_only(directions), limit, ranges)
        return ranges

    def points(self, directions: np.ndarray, ranges: np.ndarray) -> np.ndarray:
        """World coordinates (m) of the points that rays in the body frame hit. Shape (n, 3)."""
        matrix = np.empty((3, 3))
        rotation_matrix(self.odometry[6:10], matrix)
        points: np.ndarray = self.odometry[:3] + product(directions, matrix.T) * ranges[:, None]
        return points

    def acceleration(self) -> tuple[float, float, float]:
        """Acceleration during the last physics step, world frame (m/s^2), without noise."""
        matrix = np.empty((3, 3))
        rotation_matrix(self.odometry[6:10], matrix)
        x, y, z = product(matrix, self._data.sensordata[ACCELEROMETER][:, None])[:, 0].tolist()
        return x, y, z - GRAVITY

    @property
    def thrusts(self) -> np.ndarray:
        """Rotor thrusts (N). Shape (4,)."""
        return self._thrusts.copy()

    def sensor_pose(self, mount: Sequence[float]) -> list[float]:
        """Pose of a sensor in the world frame: position (m) and unit quaternion. Shape (7,)."""
        matrix = np.empty((3, 3))
        rotation_matrix(self.odometry[6:10], matrix)
        position, at = self.odometry[:3].tolist(), mount[:3]
        turned = [sum(matrix[axis, k] * at[k] for k in range(3)) for axis in range(3)]
        return [*(float(a + b) for a, b in zip(position, turned, strict=True)), *times(self.odometry[6:10], mount[3:])]

    def is_free(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Whether no obstacle is between two points, world frame (m). Shapes (3,)."""
        way = end - start
        length = float(np.sqrt(np.square(way).sum()))
        if length == 0.0:
            return True
        range_ = np.empty(1, np.float32)
        pose = np.array([*start, 1.0, 0.0, 0.0, 0.0])
        cast_rays(self._camera.columns, self._voxels, pose, _read_only((way / length)[None, :]), length, range_)
        return bool(np.isinf(range_[0]))


def _read_only(array: np.ndarray) -> np.ndarray:
    """The array, read-only like those of `Camera`: compiled code has one version for them."""
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view


def times(first: Sequence[float] | np.ndarray, second: Sequence[float] | np.ndarray) -> list[float]:
    """Product of two quaternions w x y z. Shape (4,)."""
    a, b, c, d = (float(value) for value in first)
    w, x, y, z = (float(value) for value in second)
    return [
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    ]
