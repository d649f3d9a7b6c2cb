"""What a failure does to a signal: a function of its samples so far, of the fault and its seed."""

from collections import deque

import numpy as np

from mavfi.faults.levels.sensor.fault import BLOCK_US, DELAY_US, DRIFT_US, SLOW_US, UNITS, SensorFault
from mavfi.faults.sampling import stream


class Signal:
    """One signal of a failing device, as its readers receive it.

    Outside the time of the fault, samples pass unchanged.  Several readers may ask for the same sample: the answer
    depends on its time and value only.

    Args:
        fault: The failure.
        spread: Largest value of `garbage`; None = that of the unit.
    """

    def __init__(self, fault: SensorFault, spread: float | None = None) -> None:
        self._fault, self._unit = fault, UNITS[fault.unit]
        self._spread = self._unit.spread if spread is None else spread
        self._held: np.ndarray | None = None
        self._due_us = fault.time_us
        self._block, self._lost = -1, False
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
        if self._held is None:
            self._held = values.copy()
        found: np.ndarray = getattr(self, fault.kind)(time_us, values)
        return found

    def ok(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """No failure."""
        del time_us
        return values.copy()

    def off(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """No value."""
        return self.stuck(time_us, values) if self._unit.lost is None else np.full_like(values, self._unit.lost)

    def stuck(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """The held value: that at the start of the failure."""
        del time_us, values
        assert self._held is not None  # set by the first sample
        return self._held.copy()

    def garbage(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """Noise, drawn from the seed and the instant."""
        low = 0.0 if self._unit.relative else -self._spread
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
        error = share * self._unit.error
        if self._unit.relative:
            found = values * values.dtype.type(max(0.0, 1.0 + error))
        elif self._fault.unit == "position":
            found = values + np.eye(1, len(values))[0] * error
        else:
            found = values + error
        return np.asarray(found)

    def slow(self, time_us: int, values: np.ndarray) -> np.ndarray:
        """Updates at a low rate."""
        if time_us >= self._due_us:
            self._held = values.copy()
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
            self._block, self._lost = block, bool(random.random() < 0.5)
        if self._lost:
            return self.off(time_us, values)
        self._held = values.copy()
        return values
