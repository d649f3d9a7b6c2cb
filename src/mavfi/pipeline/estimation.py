"""State estimation from IMU, position fixes and compass, for missions without access to the true state."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mavfi.kernels.perception import state_estimation as filtering
from mavfi.pipeline.memory import Memory, Remembers, zeros
from mavfi.states import ODOMETRY, Stage, State, floats, new_state

AT_REST = filtering.Spread(velocity=0.02, tilt=0.01, force_bias=0.002, rate_bias=0.0002)
"""Initial uncertainty: before take-off the vehicle is at rest and level."""
IN_FLIGHT = filtering.Spread(velocity=2.0, tilt=0.3, force_bias=0.05, rate_bias=0.005)
"""Uncertainty after a re-initialization: of the motion nothing is known."""
READ_BACK = filtering.Spread(velocity=0.2, tilt=0.03, force_bias=0.002, rate_bias=0.0002)
"""Uncertainty after a restart with the last output, which is some control periods old."""
_MOVED = 1.0
"""Standard deviation of the position after such a restart (m): the first fix corrects it."""
PATIENCE = 10
"""Consecutive rejected fixes (1 s at 10 Hz) after which the filter is re-initialized to the fix."""
_ODOMETRY_WIDTH = 19
"""Numbers of a published estimate, see the state table."""


@dataclass(slots=True)
class _Filter(Memory):
    """State of the filter, and the pending fix."""

    nominal: np.ndarray = zeros(filtering.NOMINAL_WIDTH)
    covariance: np.ndarray = zeros(filtering.ERROR_WIDTH, filtering.ERROR_WIDTH)
    sample: np.ndarray = zeros(6)
    time_us: int = 0
    aligned: bool = False
    refused: int = 0
    fix: np.ndarray | None = None


@dataclass(slots=True)
class _EstimatorMemory(Memory):
    """The last sample, the current filter, and the filter at the mark."""

    sample: np.ndarray = zeros(6)
    filter: _Filter = field(default_factory=_Filter)
    marked: _Filter = field(default_factory=_Filter)


class StateEstimator(Remembers):
    """Kernel `state_estimation`; stepped at each IMU sample, initialized by the first fix.

    It screens measurements: samples outside the sensors' range are replaced by the last valid one, improbable fixes
    are rejected; after `PATIENCE` rejections the filter is re-initialized to the last fix.
    """

    name = "state_estimation"
    stage = Stage.PERCEPTION
    reads = ("sensor.imu", "sensor.position")
    writes = (ODOMETRY["estimator"],)
    memory: _EstimatorMemory

    def __init__(self, noise: filtering.Noise) -> None:
        self._noise = noise
        self.memory = _EstimatorMemory()

    def receive(self, state: State, time_us: int) -> bool:
        """An IMU sample makes a step due; a fix is stored until the next step."""
        if state.spec.name == "sensor.imu":
            self.memory.sample = floats(state.header, 6)
            return True
        self.memory.filter.fix = floats(state.header, filtering.FIX_WIDTH)
        return False

    def step(self, time_us: int) -> list[State]:
        """Propagate the estimate to the current instant and apply a pending fix; no output before the first fix."""
        memory = self.memory.filter
        if filtering.usable_sample(self.memory.sample):
            memory.sample = self.memory.sample  # else the last valid one is used again
        # Propagate to this instant.
        if memory.aligned:
            dt = 1e-6 * (time_us - memory.time_us)
            filtering.predict(memory.nominal, memory.covariance, memory.sample, dt, self._noise)
        memory.time_us = time_us
        # Correct by the pending fix.
        if memory.fix is not None and filtering.usable_fix(memory.fix):
            self._take_fix(memory, memory.fix)
        memory.fix = None
        if memory.aligned:
            return [self._estimate(memory)]
        return []

    def _take_fix(self, memory: _Filter, fix: np.ndarray) -> None:
        """Correct the estimate by a fix; align the filter to it at the start, or after too many refused ones."""
        if memory.aligned:
            distance = filtering.correct(memory.nominal, memory.covariance, fix, self._noise)
            if distance <= filtering.GATE:
                memory.refused = 0
            else:
                memory.refused += 1
            if memory.refused < PATIENCE:
                return
        spread = AT_REST
        if memory.aligned:
            spread = IN_FLIGHT
        filtering.align(memory.nominal, memory.covariance, fix, self._noise, spread)
        memory.aligned = True
        memory.refused = 0

    def _estimate(self, memory: _Filter) -> State:
        """The filter's estimate as a publication: motion, turn rate without bias, and the biases."""
        estimate = new_state(self.writes[0])
        values = floats(estimate.header, _ODOMETRY_WIDTH)
        values[:10] = memory.nominal[:10]
        values[10:13] = memory.sample[3:] - memory.nominal[13:]
        values[13:] = memory.nominal[10:]
        return estimate

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """Continue from the last estimate, less certain; the last fix is older than that.

        After repeated restarts the estimate itself may be seconds old: the first fix that contradicts it re-initializes
        the filter.
        """
        estimate = last.get(self.writes[0])
        if estimate is None:
            values = np.full(1, np.nan)
        else:
            values = floats(estimate.header, _ODOMETRY_WIDTH)
        if not np.isfinite(values).all():
            return ()
        memory = self.memory.filter
        noise = self._noise._replace(position=_MOVED)
        filtering.align(memory.nominal, memory.covariance, np.append(values[:3], 0.0), noise, READ_BACK)
        memory.nominal[:10] = values[:10]
        memory.nominal[10:] = values[13:]
        memory.time_us = time_us
        memory.aligned = True
        memory.refused = PATIENCE - 1
        return ("sensor.position",)

    def mark(self) -> None:
        """Save the current memory for `rollback`."""
        self.memory.marked = self.memory.filter.copy()

    def rollback(self) -> None:
        """Restore the filter of the mark; the last sample and a fix received since then are kept."""
        memory = self.memory
        waiting = memory.filter.fix
        memory.filter = memory.marked.copy()
        if waiting is not None:
            memory.filter.fix = waiting
