"""Perception without the truth: where the vehicle is, from IMU, position fixes and compass."""

from dataclasses import dataclass, field, replace

import numpy as np

from mavfi.kernels.perception import state_estimation as filtering
from mavfi.states import ODOMETRY, Stage, State, floats, new_state

AT_REST = filtering.Spread(velocity=0.02, tilt=0.01, force_bias=0.002, rate_bias=0.0002)
"""Before take-off the vehicle stands still and level."""
IN_FLIGHT = filtering.Spread(velocity=2.0, tilt=0.3, force_bias=0.05, rate_bias=0.005)
PATIENCE = 10
"""Fixes refused one after the other (1 s at 10 Hz) before the filter believes them and not itself."""
_ODOMETRY_WIDTH = 19


@dataclass
class _Memory:
    """Everything that decides the next estimates."""

    nominal: np.ndarray = field(default_factory=lambda: np.zeros(filtering.NOMINAL_WIDTH))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((filtering.ERROR_WIDTH, filtering.ERROR_WIDTH)))
    sample: np.ndarray = field(default_factory=lambda: np.zeros(6))
    time_us: int = 0
    aligned: bool = False
    refused: int = 0
    fix: np.ndarray | None = None

    def copy(self) -> "_Memory":
        """A copy that shares nothing that is written."""
        return replace(self, nominal=self.nominal.copy(), covariance=self.covariance.copy(), sample=self.sample.copy())


class StateEstimator:
    """Kernel `state_estimation`; stepped at each sample of the IMU, aligned by the first fix.

    It trusts plausible measurements: samples outside of the sensors' range are replaced by the last valid one,
    improbable fixes are refused; after many refusals the filter restarts at the last of them.
    """

    name = "state_estimation"
    stage = Stage.PERCEPTION
    reads = ("sensor.imu", "sensor.position")
    writes = (ODOMETRY["estimator"],)

    def __init__(self, noise: filtering.Noise) -> None:
        self._noise = noise
        self._sample = np.zeros(6)
        self._memory = _Memory()
        self._marked = self._memory.copy()

    @property
    def covariance(self) -> np.ndarray:
        """Of the error, see `kernels.perception.state_estimation`. Shape (15, 15)."""
        return self._memory.covariance

    def receive(self, state: State, time_us: int) -> bool:
        """A sample of the IMU makes a step due; a fix waits for the next one."""
        del time_us
        if state.spec.name == "sensor.imu":
            self._sample = floats(state.header, 6)
            return True
        self._memory.fix = floats(state.header, filtering.FIX_WIDTH)
        return False

    def step(self, time_us: int) -> list[State]:
        """Carry the estimate to now, and work in a fix that has come; gives nothing before the first fix."""
        memory = self._memory
        if filtering.usable_sample(self._sample):
            memory.sample = self._sample
        if memory.aligned:
            dt = 1e-6 * (time_us - memory.time_us)
            filtering.predict(memory.nominal, memory.covariance, memory.sample, dt, self._noise)
        memory.time_us = time_us
        if memory.fix is not None and filtering.usable_fix(memory.fix):
            self._take_fix(memory, memory.fix)
        memory.fix = None
        return [self._estimate(memory)] if memory.aligned else []

    def _take_fix(self, memory: _Memory, fix: np.ndarray) -> None:
        if memory.aligned:
            distance = filtering.correct(memory.nominal, memory.covariance, fix, self._noise)
            memory.refused = 0 if distance <= filtering.GATE else memory.refused + 1
            if memory.refused < PATIENCE:
                return
        spread = IN_FLIGHT if memory.aligned else AT_REST
        filtering.align(memory.nominal, memory.covariance, fix, self._noise, spread)
        memory.aligned, memory.refused = True, 0

    def _estimate(self, memory: _Memory) -> State:
        estimate = new_state(self.writes[0])
        values = floats(estimate.header, _ODOMETRY_WIDTH)
        values[:10] = memory.nominal[:10]
        values[10:13] = memory.sample[3:] - memory.nominal[13:]
        values[13:] = memory.nominal[10:]
        return estimate

    def mark(self) -> None:
        """Remember the memory as it is."""
        self._marked = self._memory.copy()

    def rollback(self) -> None:
        """Put the memory back; the last sample stays, and so does a fix that came since."""
        waiting = self._memory.fix
        self._memory = self._marked.copy()
        if waiting is not None:
            self._memory.fix = waiting
