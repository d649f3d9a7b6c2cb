"""A Betaflight firmware as the flight controller of a mission (`--flight-controller betaflight`).

Our velocity loop turns the velocity command into stick positions at 250 Hz, as a companion computer does; the
firmware's own loops (attitude, body rates, filters, mixer at 8 kHz) turn these into motor commands.
"""

import math

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.firmware import betaflight
from mavfi.extras.firmware.betaflight import PERIOD_NS
from mavfi.extras.firmware.build import installed
from mavfi.extras.firmware.injector import FirmwareInjector
from mavfi.extras.firmware.process import NEVER, Firmware, FirmwareLostError
from mavfi.extras.firmware.tracking import Tracking
from mavfi.numerics.elementary import atan2, cos, sin
from mavfi.numerics.rotations import rotation_matrix, yaw_of
from mavfi.sim.cascade import MEMORY_SIZE, wanted_thrust
from mavfi.sim.controller import InitialConditions
from mavfi.sim.engine import GRAVITY
from mavfi.sim.scene import STEP_US
from mavfi.sim.vehicle import airframe_of

GYRO_NOISE = 0.01
"""White noise of each gyro sample at 1 kHz (rad/s), as of a vibrating airframe; without it, a hover is too still."""
_PURPOSE_GYRO_NOISE = 40
"""Number of this random stream among those of a mission's seed."""
_NOISE_BLOCK = 4_096
"""Samples that are drawn at a time."""


class BetaflightController:
    """A firmware process that controls one vehicle; see `mavfi.sim.controller.Controller`.

    Attributes:
        injector: Injects a register fault; None = no fault.
        lost: How the firmware ended or hung; None = it runs.  Without it, all rotor commands are 0.
        most_calls: Most calls of the shim in a period.
        tracking: Notes how well it follows its set-points; None = not noted.
    """

    period_us = PERIOD_NS // 1000
    rewindable = False

    def __init__(self, start: InitialConditions) -> None:
        self._airframe = airframe_of(start.vehicle)
        self._memory = np.zeros(MEMORY_SIZE)
        self._matrix = np.empty((3, 3))
        self.draw_noise(start.seed)
        self.injector: FirmwareInjector | None = None
        self.loss: FirmwareLostError | None = None
        self.most_calls = 0
        self.tracking: Tracking | None = None
        parts = installed()
        self.firmware = Firmware(parts.program, parts.shim, {betaflight.EEPROM: parts.configuration})
        try:
            betaflight.arm(self.firmware, _state(start.odometry, np.zeros(3), np.array([0.0, 0.0, GRAVITY])))
        except BaseException:
            self.close()
            raise

    def draw_noise(self, seed: int) -> None:
        """Draw the gyro's noise from a seed, from now on; as a rule, that of the mission."""
        sequence = np.random.SeedSequence(seed, spawn_key=(_PURPOSE_GYRO_NOISE,))
        self._random = np.random.default_rng(sequence)
        self._noise = np.empty((0, 3))
        self._sample_count = 0

    def rotors(self, time_us: int, setpoint: np.ndarray, odometry: np.ndarray, force: np.ndarray) -> np.ndarray:
        """See `Controller.rotors`; zero after the firmware has ended."""
        if self.loss is not None:
            return np.zeros(4)
        state = _state(odometry, self._gyro_noise(), force)
        rc = None
        if time_us % STEP_US == 0:  # sticks come at 250 Hz, sensors at 1 kHz
            rc = self._channels(time_us, setpoint, odometry)
        try:
            self._run(time_us, betaflight.packets(self.firmware.now_ns, state, rc))
        except FirmwareLostError as error:
            self.loss = error
            return np.zeros(4)
        self.most_calls = max(self.most_calls, self.firmware.calls)
        return np.array([self._airframe.max_thrust * min(1.0, max(0.0, motor)) ** 2 for motor in self.firmware.motors])

    def _run(self, time_us: int, packets: bytes) -> None:
        """Let the firmware run for a period, and inject if it stops where the fault is."""
        stop_at = NEVER
        if self.injector is not None:
            stop_at = self.injector.stop_at(time_us)
        if self.firmware.run(packets, PERIOD_NS, stop_at):
            assert self.injector is not None  # only then it stops
            self.injector.inject(self.firmware, time_us)

    def _channels(self, time_us: int, setpoint: np.ndarray, odometry: np.ndarray) -> list[int]:
        """Sticks for a velocity command: angles and throttle of the force that our own velocity loop wants."""
        airframe = self._airframe
        wanted_force = wanted_thrust(airframe, self._memory, setpoint, odometry[3:6])
        rotation_matrix(odometry[6:10], self._matrix)
        if self.tracking is not None:
            self.tracking.sample(time_us, setpoint, odometry, wanted_force, self._matrix[:, 2])
        # The wanted force in the world frame, and its part along the rotors' axis, which is what they can give.
        east, north, up = wanted_force.tolist()
        along = self._matrix[0, 2] * east + self._matrix[1, 2] * north + self._matrix[2, 2] * up
        # Angles that turn this axis into the direction of the force, seen along the heading.
        yaw = yaw_of(odometry[6:10])
        c = cos(yaw)
        s = sin(yaw)
        forward = c * east + s * north
        left = c * north - s * east
        pitch = atan2(forward, up)
        roll = atan2(-left, math.sqrt(forward * forward + up * up))
        throttle = math.sqrt(min(max(0.0, along) * airframe.mass / (4.0 * airframe.max_thrust), 1.0))
        return betaflight.channels(roll, pitch, throttle, float(setpoint[3]))

    def _gyro_noise(self) -> np.ndarray:
        """Noise of the next gyro sample (rad/s). Shape (3,)."""
        if self._sample_count == len(self._noise):
            self._noise = self._random.normal(0.0, GYRO_NOISE, (_NOISE_BLOCK, 3))
            self._sample_count = 0
        self._sample_count += 1
        sample: np.ndarray = self._noise[self._sample_count - 1]
        return sample

    def save(self) -> bytes:
        """Not possible: the state of another program.

        Raises:
            BadInputError: Always.
        """
        raise BadInputError("flight controller betaflight: its flights cannot be saved and continued")

    def restore(self, saved: bytes) -> None:
        """See `save`."""
        self.save()

    def close(self) -> None:
        """End the firmware."""
        self.firmware.close()


def _state(odometry: np.ndarray, noise: np.ndarray, force: np.ndarray) -> tuple[float, ...]:
    """The state that the firmware's sensors show, with noise of the gyro (rad/s)."""
    return betaflight.state_of(odometry[:3], odometry[6:10], odometry[3:6], odometry[10:] + noise, force)
