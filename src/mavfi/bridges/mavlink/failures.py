"""Sensor and actuator failures with PX4's names, at the inputs and outputs of the flight controller.

Units and types: MAVLink's FAILURE_UNIT and FAILURE_TYPE (https://mavlink.io/en/messages/common.html#FAILURE_UNIT).  A
failure is activated once the controller has received or given another value than without it.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from mavfi.faults.sampling import stream
from mavfi.numerics.rotations import yaw_of
from mavfi.sim.controller import Controller

UNITS = {0: "gyro", 1: "accelerometer", 2: "compass", 4: "position", 101: "motor"}
TYPES = {
    0: "ok", 1: "off", 2: "stuck", 3: "garbage", 4: "wrong", 5: "slow", 6: "delayed", 7: "intermittent",
}  # fmt: skip
WRONG = {"gyro": 0.5, "accelerometer": 2.0, "compass": 0.5 * np.pi, "position": 10.0, "motor": -0.4}
"""Error of type `wrong`: rad/s about each axis, m/s^2 along each, rad, m along x; share of a motor's thrust."""
SPREAD = {"gyro": 3.0, "accelerometer": 20.0, "compass": np.pi, "position": 50.0, "motor": 1.0}
"""Largest value of type `garbage`: uniform in both directions; of a motor from 0, as a share of its largest thrust."""
SLOW_S, DELAY_S, BLOCK_S = 0.5, 0.2, 0.1
"""Period of type `slow`, delay of `delayed`, and length of a block of `intermittent`, of which half are lost (s)."""


@dataclass(slots=True)
class Failure:
    """An active failure.

    Attributes:
        unit: Value of `UNITS`.
        kind: Value of `TYPES`.
        instance: Number of the motor from 1; 0 = all.
        since_us: Time of the command.
        activated_us: Time of the first changed value; None = not yet.
        before: The first changed value without the failure.
        after: With the failure.
    """

    unit: str
    kind: str
    instance: int
    since_us: int
    activated_us: int | None = None
    before: float = 0.0
    after: float = 0.0

    @property
    def site(self) -> str:
        """Unit and type as text."""
        return f"{self.unit}{self.instance or ''} {self.kind}"


class _Signal:
    """The values of a unit, changed by a failure.

    Args:
        failure: The failure.
        seed: Of its random values.
        spread: Largest value of type `garbage`.
    """

    def __init__(self, failure: Failure, seed: int, spread: float) -> None:
        self.failure, self._random = failure, stream(seed, "failure", failure.since_us)
        self._spread = spread
        self._held: np.ndarray | None = None
        self._next_us, self._lost = 0, False
        self._past: deque[tuple[int, np.ndarray]] = deque()

    def __call__(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """The values that are received. Shape (n,)."""
        if self._held is None:
            self._held = values.copy()
        failure = self.failure
        changed: np.ndarray = getattr(self, failure.kind)(time_us, values)
        if failure.activated_us is None and not np.array_equal(values, changed):
            place = int(np.flatnonzero(values != changed)[0])
            failure.activated_us = time_us
            failure.before, failure.after = float(values[place]), float(changed[place])
        return changed

    def off(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """A motor stands still; a sensor sends nothing, so that the last value stays."""
        return np.zeros_like(values) if self.failure.unit == "motor" else self.stuck(time_us, values)

    def stuck(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """The value at the start of the failure."""
        assert self._held is not None  # precondition
        return self._held.copy()

    def garbage(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """Noise."""
        low = 0.0 if self.failure.unit == "motor" else -self._spread
        found: np.ndarray = self._random.uniform(low, self._spread, len(values))
        return found

    def wrong(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """A constant error; of a motor, in proportion to its thrust."""
        error: float | np.ndarray = WRONG[self.failure.unit]
        if self.failure.unit == "motor":
            return np.asarray(values * (1.0 + error))
        if self.failure.unit == "position":
            error = np.eye(len(values))[0] * error
        found: np.ndarray = values + error
        return found

    def slow(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """Updates at a low rate."""
        if time_us >= self._next_us:
            self._held, self._next_us = values.copy(), time_us + round(1e6 * SLOW_S)
        return self.stuck(time_us, values)

    def delayed(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """The values of some time ago."""
        self._past.append((time_us, values.copy()))
        while len(self._past) > 1 and self._past[1][0] <= time_us - round(1e6 * DELAY_S):
            self._past.popleft()
        return self._past[0][1].copy()

    def intermittent(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """Half of all blocks of time are lost."""
        if time_us >= self._next_us:
            self._next_us, self._lost = time_us + round(1e6 * BLOCK_S), bool(self._random.random() < 0.5)
        if self._lost:
            return self.off(time_us, values)
        self._held = values.copy()
        return values


class FailingController:
    """A flight controller whose inputs and outputs can fail.

    Args:
        controller: The controller.
        max_thrust: Of a rotor (N).
        seed: Of random failures.

    Attributes:
        odometry: State of the vehicle as the controller received it last. Shape (13,).
    """

    rewindable = False

    def __init__(self, controller: Controller, odometry: np.ndarray, max_thrust: float, seed: int) -> None:
        self._controller, self._max_thrust, self._seed = controller, max_thrust, seed
        self.period_us = controller.period_us
        self.odometry = odometry.copy()
        self._signals: list[_Signal] = []

    @property
    def failures(self) -> list[Failure]:
        """Active failures."""
        return [signal.failure for signal in self._signals]

    def add(self, failure: Failure) -> None:
        """Start a failure."""
        spread = SPREAD[failure.unit] * (self._max_thrust if failure.unit == "motor" else 1.0)
        self._signals.append(_Signal(failure, self._seed, spread))

    def clear(self, unit: str, instance: int) -> bool:
        """End the failures of a unit (instance 0: of all instances); returns whether there were any."""
        ended = [failure for failure in self.failures if failure.unit == unit and instance in (0, failure.instance)]
        for failure in ended:
            self.remove(failure)
        return bool(ended)

    def remove(self, failure: Failure) -> None:
        """End one failure."""
        self._signals = [signal for signal in self._signals if signal.failure is not failure]

    def rotors(self, time_us: int, setpoint: np.ndarray, odometry: np.ndarray, force: np.ndarray) -> np.ndarray:
        """See `Controller`."""
        self.odometry[:] = odometry
        if not self._signals:
            return self._controller.rotors(time_us, setpoint, odometry, force)
        measured = force.copy()
        for signal in self._signals:
            if signal.failure.unit != "motor":
                self._measure(signal, time_us, measured)
        wanted = np.array(self._controller.rotors(time_us, setpoint, self.odometry, measured), np.float64)
        for signal in self._signals:
            if signal.failure.unit == "motor":
                number = signal.failure.instance
                motors = slice(number - 1, number) if number else slice(None)
                wanted[motors] = signal(time_us, wanted[motors])
        return wanted

    def _measure(self, signal: _Signal, time_us: int, force: np.ndarray) -> None:
        """Change what the sensors of a unit measure."""
        unit, seen = signal.failure.unit, self.odometry
        if unit == "gyro":
            seen[10:13] = signal(time_us, seen[10:13])
        elif unit == "accelerometer":
            force[:] = signal(time_us, force)
        elif unit == "position":
            seen[:6] = signal(time_us, seen[:6])
        else:
            heading = float(yaw_of(seen[6:10]))
            seen[6:10] = _turned(seen[6:10], float(signal(time_us, np.array([heading]))[0]) - heading)

    def save(self) -> bytes:
        """See `Controller`."""
        return self._controller.save()

    def restore(self, saved: bytes) -> None:
        """See `Controller`."""
        self._controller.restore(saved)

    def close(self) -> None:
        """See `Controller`."""
        self._controller.close()


def _turned(quaternion: np.ndarray, angle: float) -> np.ndarray:
    """The orientation turned about the world's z axis. Shape (4,)."""
    w, x, y, z = map(float, quaternion)
    c, s = float(np.cos(0.5 * angle)), float(np.sin(0.5 * angle))
    return np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
