"""The failures of one vehicle, applied to everything that its sensors send and its motors receive."""

import math
from collections import deque

import numpy as np

from mavfi.faults.sampling import stream
from mavfi.levels.sensor.fault import BLOCK_US, DELAY_US, DRIFT_US, NULL, SLOW_US, UNITS, SensorFault
from mavfi.numerics.elementary import cos, sin
from mavfi.numerics.rotations import yaw_of
from mavfi.record import Injection

# Where the values of a device are.
_STATE = {"gyro": slice(10, 13), "position": slice(0, 6)}
"""In the true state of the vehicle."""
_FORCE = {"accelerometer": slice(0, 3)}
"""In the specific force."""
_IMU = _FORCE | {"gyro": slice(3, 6)}
"""In a sample of the IMU."""
_FIX = {"position": slice(0, 3), "compass": slice(3, 4)}
"""In a position fix."""
_HEADING = 3
"""Index of the heading in a position fix (rad)."""


class Failure:
    """A fault of one device, with the proof of its activation.

    Attributes:
        fault: The fault.
        injection: The first changed value; None = no reader has received one. Of a null fault, the first that passed.
    """

    def __init__(self, fault: SensorFault) -> None:
        self.fault = fault
        self.injection: Injection | None = None
        self._signals: dict[str, Signal] = {}

    def __call__(self, source: str, time_us: int, values: np.ndarray, spread: float | None = None) -> np.ndarray:
        """A sample as readers receive it; sources of different noise have signals of their own."""
        if source not in self._signals:
            self._signals[source] = Signal(self.fault, spread)
        sample = self._signals[source](time_us, values)
        if self.injection is None and sample is not values:
            self._note(time_us, values, sample)
        return sample

    def _note(self, time_us: int, values: np.ndarray, sample: np.ndarray) -> None:
        """Record the first change, given the true values and those that readers receive."""
        fault = self.fault
        differs = (values != sample) & ~(np.isnan(values) & np.isnan(sample))
        if not differs.any() and fault.kind != NULL:
            return
        first = int(differs.argmax())
        details = {}
        if fault.kind != NULL and math.isinf(fault.lasts_s):
            details["model"] = "to the end"
        elif fault.kind != NULL:
            details["model"] = f"for {fault.lasts_s:g} s"
        self.injection = Injection(
            fault.level,
            fault.site,
            time_us / 1e6,
            None,
            float(values[first]),
            float(sample[first]),
            activated=True,
            details=details,
        )

    def record(self) -> Injection:
        """The injection, or that no reader received a changed value."""
        if self.injection is not None:
            return self.injection
        fault = self.fault
        return Injection(fault.level, fault.site, fault.start_s, None, None, None, activated=False)


class Failures:
    """The failures of one vehicle; without any, every value passes as the same object.

    Attributes:
        active: The failures, in order of application.
    """

    def __init__(self) -> None:
        self.active: list[Failure] = []

    def begin(self, fault: SensorFault) -> Failure:
        """Add a failure, which begins at its instant."""
        self.active.append(Failure(fault))
        return self.active[-1]

    def state(self, time_us: int, odometry: np.ndarray) -> np.ndarray:
        """The state as its readers receive it, see `sim.simulator.Simulator.odometry`. Shape (13,)."""
        measured = self._changed("state", _STATE, time_us, odometry)
        # a failing compass turns the vehicle about the vertical
        for failure in self._of("compass"):
            heading = yaw_of(measured[6:10])
            measured_heading = float(failure("state", time_us, np.array([heading]))[0])
            if measured_heading != heading:
                measured = measured.copy()
                measured[6:10] = _turned(measured[6:10], measured_heading - heading)
        return measured

    def force(self, time_us: int, force: np.ndarray) -> np.ndarray:
        """Specific force, body frame (m/s^2). Shape (3,)."""
        return self._changed("force", _FORCE, time_us, force)

    def imu(self, time_us: int, sample: np.ndarray) -> np.ndarray:
        """A sample of the IMU, as in `flight.plant.Plant.imu`. Shape (6,)."""
        return self._changed("imu", _IMU, time_us, sample)

    def fix(self, time_us: int, measured: np.ndarray) -> np.ndarray:
        """A position fix, as in `flight.plant.Plant.position_fix`. Shape (4,)."""
        fix = self._changed("fix", _FIX, time_us, measured)
        if fix is not measured:
            fix[_HEADING] = math.remainder(fix[_HEADING], 2.0 * math.pi)
        return fix

    def ranges(self, time_us: int, ranges: np.ndarray, source: str = "image") -> np.ndarray:
        """The ranges of a depth image (m). Shape (n,)."""
        for failure in self._of("depth_camera"):
            ranges = failure(source, time_us, ranges)
        return ranges

    def rotors(self, time_us: int, thrusts: np.ndarray, max_thrust: float) -> np.ndarray:
        """Commanded thrusts (N), of motors that can give `max_thrust`. Shape (4,)."""
        for failure in self._of("motor"):
            number = failure.fault.instance
            motors = slice(None)
            if number:
                motors = slice(number - 1, number)
            thrusts = _with(thrusts, motors, failure("rotors", time_us, thrusts[motors], max_thrust))
        return thrusts

    def _of(self, unit: str) -> list[Failure]:
        """The failures of a device."""
        return [failure for failure in self.active if failure.fault.unit == unit]

    def _changed(self, source: str, columns: dict[str, slice], time_us: int, values: np.ndarray) -> np.ndarray:
        """Values with the changes of all failures of devices that have columns in them."""
        for failure in self.active:
            part = columns.get(failure.fault.unit)
            if part is not None:
                values = _with(values, part, failure(source, time_us, values[part]))
        return values


def _with(values: np.ndarray, part: slice, replacement: np.ndarray) -> np.ndarray:
    """Values with a part replaced; unchanged values are returned as they are."""
    if replacement.tobytes() == values[part].tobytes():
        return values
    changed = values.copy()
    changed[part] = replacement
    return changed


def _turned(quaternion: np.ndarray, angle: float) -> np.ndarray:
    """The orientation turned about the world's z axis. Shape (4,)."""
    w, x, y, z = map(float, quaternion)
    c = float(cos(0.5 * angle))
    s = float(sin(0.5 * angle))
    return np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])


# ---- What a failure does to a signal: a function of its samples so far, of the fault and its seed.


class Signal:
    """One signal of a failing device, as its readers receive it.

    Outside the time of the fault, samples pass unchanged.  Several readers may ask for the same sample: the answer
    depends on its time and value only.

    Args:
        fault: The failure.
        spread: Largest value of `garbage`; None = that of the unit.
    """

    def __init__(self, fault: SensorFault, spread: float | None = None) -> None:
        self._fault = fault
        self._device = UNITS[fault.unit]
        self._spread = self._device.spread
        if spread is not None:
            self._spread = spread
        self._held_value: np.ndarray | None = None  # what readers receive while there is no new value
        self._due_us = fault.time_us  # of `slow`: next update
        self._block = -1  # of `intermittent`: number of the block of time
        self._lost = False  # and whether it is lost
        self._past: deque[tuple[int, np.ndarray]] = deque()

    def __call__(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """The sample that readers receive.

        Args:
            time_us: Instant, not before that of the last call.
            values: The true sample. Shape (n,).
        """
        fault = self._fault
        if fault.kind == "delayed" and time_us < fault.end_us:
            self._remember(time_us, values)
        if not fault.time_us <= time_us < fault.end_us:
            return values
        if self._held_value is None:
            self._held_value = values.copy()
        sample: np.ndarray = getattr(self, fault.kind)(time_us, values)  # the method of this name
        return sample

    def ok(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """No failure."""
        del time_us
        return values.copy()

    def off(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """No value."""
        if self._device.lost is None:
            return self.stuck(time_us, values)
        return np.full_like(values, self._device.lost)

    def stuck(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """The held value: that at the start of the failure."""
        del time_us, values
        assert self._held_value is not None  # set by the first sample
        return self._held_value.copy()

    def garbage(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """Noise, drawn from the seed and the instant."""
        low = -self._spread
        if self._device.relative:
            low = 0.0  # amounts are never negative
        random = stream(self._fault.seed, "garbage", self._fault.device, time_us)
        return random.uniform(low, self._spread, len(values)).astype(values.dtype)

    def wrong(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """A constant error."""
        del time_us
        return self._with_error(values, 1.0)

    def drift(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """An error in proportion to the time since the start of the failure."""
        return self._with_error(values, (time_us - self._fault.time_us) / DRIFT_US)

    def _with_error(self, values: np.ndarray, share: float) -> np.ndarray:
        """Values with a share of the device's error."""
        error = share * self._device.error
        if self._device.relative:
            return np.asarray(values * values.dtype.type(max(0.0, 1.0 + error)))
        if self._fault.unit == "position":
            along_x = np.eye(1, len(values))[0]
            return np.asarray(values + along_x * error)
        return np.asarray(values + error)

    def slow(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """Updates at a low rate."""
        if time_us >= self._due_us:
            self._held_value = values.copy()
            self._due_us = time_us + SLOW_US
        return self.stuck(time_us, values)

    def _remember(self, time_us: int, values: np.ndarray) -> None:
        """Keep the samples that are still needed, from before the start on."""
        self._past.append((time_us, values.copy()))
        while len(self._past) > 1 and self._past[1][0] <= time_us - DELAY_US:
            self._past.popleft()

    def delayed(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """The last sample that is as old as the delay, or the first of all."""
        del time_us, values
        return self._past[0][1].copy()

    def intermittent(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """Some blocks of time are lost."""
        block = (time_us - self._fault.time_us) // BLOCK_US
        if block != self._block:
            random = stream(self._fault.seed, "intermittent", self._fault.device, self._fault.time_us, block)
            self._block = block
            self._lost = bool(random.random() < 0.5)
        if self._lost:
            return self.off(time_us, values)
        self._held_value = values.copy()
        return values
