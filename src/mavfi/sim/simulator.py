"""The simulator of one flight: controller, vehicle, depth camera and IMU in a world, on integer microseconds."""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import mujoco
import numpy as np

from mavfi.errors import BadInputError
from mavfi.mission import Scenario
from mavfi.numerics.elementary import atan2, cos, sin
from mavfi.numerics.jit import entry
from mavfi.numerics.rotations import yaw_of
from mavfi.plugins import build
from mavfi.sim.camera import Camera
from mavfi.sim.cascade import Cascade, advance
from mavfi.sim.controller import Controller, InitialConditions, find_controller
from mavfi.sim.environments.world import World
from mavfi.sim.imu import Imu, Positioning
from mavfi.sim.scene import ACCELEROMETER, STEP_US, build_model
from mavfi.sim.vehicle import Body, airframe_of, hover_thrusts, turn_rotors
from mavfi.sim.wind import Weather, Wind

_PURPOSE_SENSOR_NOISE = 2
_PURPOSE_WIND = 5
_LONGEST_COMMAND = 1e6
_ROUNDING = 1e-12
"""A mixer's sum may exceed a rotor's limit by its rounding error."""


def _controller_period(name: str) -> int:
    """Period of a flight controller (us), given its name.

    Raises:
        BadInputError: It is not known, or its period is not 4000 us divided by an integer.
    """
    period_us = getattr(find_controller(name), "period_us", None)
    if not isinstance(period_us, int) or period_us < 1 or STEP_US % period_us:
        text = f"its period_us is {period_us!r}; allowed: {STEP_US} divided by an integer"
        raise BadInputError(f"flight controller {name!r}: {text}")
    return period_us


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The complete state of a flight; `Simulator.restore` continues from it bit for bit."""

    time_us: int
    physics: np.ndarray
    sensors: np.ndarray
    warnings: np.ndarray
    thrusts: np.ndarray
    controller: bytes
    setpoint: np.ndarray
    expiry_us: int
    odometry: np.ndarray
    collided: bool
    rejected_commands: int
    imu: Imu

    def same(self, other: "Snapshot") -> bool:
        """Whether both are equal, bit for bit."""
        return self._content() == other._content()

    def _content(self) -> tuple[int | bytes, ...]:
        """Every field, so that none can be forgotten: arrays as their bytes, the IMU as what it remembers."""
        content: list[int | bytes] = []
        for attribute in fields(self):
            value = getattr(self, attribute.name)
            if isinstance(value, Imu):
                content += [value.time_us, value.bias.tobytes()]
            elif isinstance(value, np.ndarray):
                content.append(value.tobytes())
            else:
                content.append(value)
        return tuple(content)


def _shortened(velocity: tuple[float, float, float], limit: float) -> tuple[float, float, float]:
    """Limit the length of a vector; scaled by its largest component first, so that squares cannot overflow."""
    x, y, z = velocity
    largest = max(abs(x), abs(y), abs(z))
    if largest == 0.0:
        return velocity
    x, y, z = x / largest, y / largest, z / largest
    norm = math.sqrt(x * x + y * y + z * z)
    if largest <= limit / norm:
        return velocity
    scale = limit / norm
    return x * scale, y * scale, z * scale


class _DeadController:
    """In the place of a flight controller that has died: no thrust.

    Attributes:
        period_us: As of the one that died.
        rewindable: See `Controller`.
    """

    rewindable = False

    def __init__(self, period_us: int) -> None:
        self.period_us = period_us

    def rotors(self, time_us: int, setpoint: np.ndarray, odometry: np.ndarray, force: np.ndarray) -> np.ndarray:
        """See `Controller.rotors`."""
        return np.zeros(4)

    def save(self) -> bytes:
        """See `Controller.save`."""
        return b""

    def restore(self, saved: bytes) -> None:
        """See `Controller.restore`."""

    def close(self) -> None:
        """See `Controller.close`."""


class Simulator:
    """Flies one vehicle in one world.

    Attributes:
        time_us: Current time.
        odometry: True state: x y z (m), vx vy vz (m/s), unit quaternion w x y z, wx wy wz (rad/s, body).
            Shape (13,); always the same array, overwritten by `advance`.
        collided: Whether the vehicle has touched an obstacle or the ground.
        rejected_commands: Number of commands rejected because they were not finite.
        controller: The flight controller.
    """

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Place the vehicle at the start, hovering and heading for the goal.

        Args:
            world: The world.
            scenario: Vehicle, camera, localization, wind, speed limit and seed.
        """
        self._scenario = scenario
        vehicle = scenario.vehicle
        period_us = _controller_period(scenario.flight_controller)
        self._build(world, period_us)
        self._airframe = airframe_of(vehicle, period_us)
        self._thrusts = hover_thrusts(self._airframe)
        self._voxels = world.voxels
        self._speed_limit = vehicle.setpoint_limit * scenario.v_max
        self._yaw_rate_limit = vehicle.max_yaw_rate
        self._setpoint = np.zeros(4)
        self._expiry_us = 0

        # Sensors and wind, each with a random stream of its own.
        keys = np.random.SeedSequence(scenario.seed, spawn_key=(_PURPOSE_SENSOR_NOISE,)).generate_state(3, np.uint64)
        self._camera = Camera(scenario.camera, world, int(keys[0]))
        self._imu = Imu(int(keys[1]), scenario.localization.imu_noise)
        self._positioning = Positioning(scenario.localization, int(keys[2]))
        self._weather = Weather(scenario.wind, np.random.SeedSequence(scenario.seed, spawn_key=(_PURPOSE_WIND,)))

        # The state at the start; the controller begins with it.
        self.time_us = 0
        self.odometry = np.zeros(13)
        self.collided = False
        self.rejected_commands = 0
        self._compiled: Callable[..., bool] | None = None  # `advance` for the types of this flight
        self.controller = self._make_controller(self._face(world.goal - world.start))

    def _build(self, world: World, period_us: int) -> None:
        """Model and data of MuJoCo for the vehicle in a world."""
        self._model = build_model(world, self._scenario.vehicle, period_us)
        self._data = mujoco.MjData(self._model)
        self._body = Body(
            self._model._address,
            self._data._address,
            self._data.qpos,
            self._data.qvel,
            self._data.qfrc_applied,
            self._data.sensordata,
        )

    def _make_controller(self, heading: float) -> Controller:
        """A new flight controller, which starts from the present state."""
        name = self._scenario.flight_controller
        start = InitialConditions(self._scenario.vehicle, self.odometry.copy(), heading, self._scenario.seed)
        controller: Controller = build("flight controller", name, find_controller(name), start)
        return controller

    def stop_controller(self) -> None:
        """The flight controller dies: the rotors stop."""
        self.controller.close()
        self.controller = _DeadController(self.controller.period_us)

    def restart_controller(self) -> None:
        """A new flight controller takes over, from the present state."""
        self.controller = self._make_controller(yaw_of(self.odometry[6:10]))

    def _face(self, way: np.ndarray) -> float:
        """Turn the vehicle into a direction; returns its heading (rad)."""
        yaw = float(atan2(way[1], way[0]))
        self._data.qpos[3:7] = (cos(0.5 * yaw), 0.0, 0.0, sin(0.5 * yaw))
        self._derive()
        self.odometry[:3] = self._data.qpos[:3]
        self.odometry[6:10] = self._data.qpos[3:7]
        return yaw

    def _derive(self) -> None:
        """Compute what follows from the positions and velocities in MuJoCo's data, without a step of time."""
        mujoco.mj_forward(self._model, self._data)

    @property
    def ray_directions(self) -> np.ndarray:
        """Unit vectors of the camera's pixels, body frame, x forward. Shape (height * width, 3)."""
        return self._camera.directions

    def command(self, velocity_yaw_rate: np.ndarray, duration: float) -> None:
        """Send the flight controller a new set-point, effective immediately.

        A command that is not finite is rejected and counted in `rejected_commands`; the previous one stays in force.
        The velocity is limited to the set-point limit (1.33 v_max), the yaw rate is clipped; after the duration the
        vehicle hovers.

        Args:
            velocity_yaw_rate: vx vy vz, world frame (m/s), and yaw rate (rad/s). Shape (4,).
            duration: Validity of the set-point (s); 0 and less = hover immediately.
        """
        vx, vy, vz, yaw_rate = velocity_yaw_rate.tolist()
        if not all(map(math.isfinite, (vx, vy, vz, yaw_rate, duration))):
            self.rejected_commands += 1
            return
        limit = self._yaw_rate_limit
        self._setpoint[:] = (*_shortened((vx, vy, vz), self._speed_limit), min(limit, max(-limit, yaw_rate)))
        self._expiry_us = self.time_us + int(min(max(duration, 0.0), _LONGEST_COMMAND) * 1e6)

    def advance(self, time_us: int) -> None:
        """Advance the simulation.

        Args:
            time_us: Target time; a multiple of the physics period (4000 us), not before the current time.

        Raises:
            BadInputError: Invalid target time.
        """
        if time_us % STEP_US or time_us < self.time_us:
            raise BadInputError(f"time {time_us} us: must be a multiple of {STEP_US} us from {self.time_us} us on")
        if time_us == self.time_us:
            return
        if type(self.controller) is Cascade:  # a subclass may have other rotor commands
            self._advance_compiled(time_us, self.controller)
            return
        wind = self._weather.until(1e-6 * time_us)
        while self.time_us < time_us:
            self._step(wind)

    def _advance_compiled(self, time_us: int, controller: Cascade) -> None:
        """Advance with our own controller, in one compiled loop."""
        steps = (time_us - self.time_us) // STEP_US
        commanded = max(0, self._expiry_us - self.time_us + STEP_US - 1) // STEP_US
        arguments = (
            self._airframe,
            self._body,
            self._voxels,
            self._weather.until(1e-6 * time_us),
            self.time_us,
            self._thrusts,
            controller.memory,
            self._setpoint,
            steps,
            commanded,
            self.odometry,
        )
        if self._compiled is None:
            self._compiled = entry(advance, *arguments)
        self.collided = self._compiled(*arguments) or self.collided
        self.time_us = time_us

    def _step(self, wind: Wind) -> None:
        """Advance by one period of the controller."""
        setpoint = self._setpoint if self.time_us < self._expiry_us else np.zeros(4)
        force = self._data.sensordata[ACCELEROMETER]
        self._turn_rotors(wind, self.controller.rotors(self.time_us, setpoint, self.odometry, force))

    def _turn_rotors(self, wind: Wind, commands: np.ndarray) -> None:
        """Advance by one period of the controller with rotor commands (N), limited as by an ESC. Shape (4,)."""
        limit = self._airframe.max_thrust * (1.0 + _ROUNDING)
        commands = np.clip(np.where(np.isnan(commands), 0.0, commands), 0.0, limit)
        period_us = self.controller.period_us
        touched = turn_rotors(
            self._airframe,
            self._body,
            self._voxels,
            wind,
            self.time_us,
            period_us,
            self._thrusts,
            commands,
            self.odometry,
        )
        self.collided = self.collided or touched
        self.time_us += period_us

    def depth(self) -> tuple[np.ndarray, np.ndarray]:
        """Take a depth image.

        Returns:
            Distances along `ray_directions` (m), infinity if nothing is within range, shape (height * width,),
            float32; and the pose of the camera: position (m) and quaternion w x y z, shape (7,), float64.
        """
        pose = np.concatenate([self.odometry[:3], self.odometry[6:10]])
        return self._camera.capture(pose, self.time_us), pose

    def imu(self) -> np.ndarray:
        """Sample the IMU in the body frame, with noise. Shape (6,).

        Specific force (m/s^2) during the last physics step, and current rates (rad/s).
        """
        return self._imu.sample(
            np.concatenate([self._data.sensordata[ACCELEROMETER], self.odometry[10:]]), self.time_us
        )

    def position_fix(self) -> np.ndarray:
        """Measure position (m) and heading (rad) in the world frame, with noise. Shape (4,)."""
        return self._positioning.fix(self.odometry, self.time_us)

    def warnings(self) -> list[str]:
        """MuJoCo's warnings so far, with their counts."""
        counts = self._data.warning.number
        kinds = [mujoco.mjtWarning(kind).name for kind in range(len(counts))]
        return [f"{kind} x {count}" for kind, count in zip(kinds, counts, strict=True) if count > 0]

    def snapshot(self) -> Snapshot:
        """The complete state of this flight."""
        return Snapshot(
            self.time_us,
            self._physics(),
            self._data.sensordata.copy(),
            self._data.warning.number.copy(),
            self._thrusts.copy(),
            self.controller.save(),
            self._setpoint.copy(),
            self._expiry_us,
            self.odometry.copy(),
            self.collided,
            self.rejected_commands,
            copy.deepcopy(self._imu),
        )

    def _physics(self) -> np.ndarray:
        """MuJoCo's integration state."""
        signature = mujoco.mjtState.mjSTATE_INTEGRATION
        physics = np.empty(mujoco.mj_stateSize(self._model, signature))
        mujoco.mj_getState(self._model, self._data, physics, signature)
        return physics

    def _set_physics(self, physics: np.ndarray) -> None:
        """Inverse of `_physics`."""
        mujoco.mj_setState(self._model, self._data, physics, mujoco.mjtState.mjSTATE_INTEGRATION)

    def is_at(self, snapshot: Snapshot) -> bool:
        """Whether the current state equals a snapshot, bit for bit."""
        return self.odometry.tobytes() == snapshot.odometry.tobytes() and self.snapshot().same(snapshot)

    def restore(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot of this simulator, or of another one of the same world and scenario.

        Args:
            snapshot: Output of `snapshot`.
        """
        self._set_physics(snapshot.physics)
        self._data.sensordata[:] = snapshot.sensors
        self._data.warning.number[:] = snapshot.warnings
        self._thrusts[:] = snapshot.thrusts
        self.controller.restore(snapshot.controller)
        self._setpoint[:] = snapshot.setpoint
        self.odometry[:] = snapshot.odometry
        self.time_us = snapshot.time_us
        self._expiry_us = snapshot.expiry_us
        self.collided = snapshot.collided
        self.rejected_commands = snapshot.rejected_commands
        self._imu = copy.deepcopy(snapshot.imu)

    def close(self) -> None:
        """Release the flight controller, which may hold a process."""
        self.controller.close()
