"""What the vehicle's sensors publish: the truth, or the inputs of an estimator."""

import numpy as np

from mavfi.config import LocalizationConfig
from mavfi.hosts.loop.plant import Plant
from mavfi.sim.scene import STEP_US
from mavfi.states import ODOMETRY, State, floats, new_state

_ESTIMATE = ODOMETRY["estimator"]


class Sensors:
    """The sensors of one flight; `estimating`: whether there is an estimator.

    With an estimator the true pose is published through sensors only: an image carries the last estimate that consumers
    have seen, while the camera looks from where the vehicle is.
    """

    def __init__(self, plant: Plant, localization: LocalizationConfig) -> None:
        self.estimating = localization.kind == "estimator"
        self._plant = plant
        self._period_us = localization.position_period_us
        self._next_fix_us = 0
        self._estimate = np.zeros(7)
        self._estimate[3] = 1.0

    def samples_between(self, now: int, later: int) -> range:
        """Instants after `now` and before `later`, the next control period, at which the IMU is sampled."""
        return range(now + STEP_US, later, STEP_US) if self.estimating else range(0)

    def depth(self) -> State:
        """A depth image with its believed pose."""
        ranges, pose = self._plant.depth()
        state = new_state("sensor.depth", len(ranges))
        floats(state.header, 7)[:] = self._estimate if self.estimating else pose
        state.elements["range"] = ranges
        return state

    def motion(self, now: int) -> list[State]:
        """Where the vehicle is: the true odometry; or an IMU sample, after a position fix if that is due."""
        if not self.estimating:
            return [_state(ODOMETRY["truth"], self._plant.odometry)]
        measured = []
        if now >= self._next_fix_us:
            self._next_fix_us += self._period_us
            measured.append(_state("sensor.position", self._plant.position_fix()))
        return [*measured, _state("sensor.imu", self._plant.imu())]

    def see(self, state: State) -> None:
        """Note the last estimate that consumers have seen."""
        if state.spec.name == _ESTIMATE:
            values = floats(state.header, 10)
            self._estimate[:3], self._estimate[3:] = values[:3], values[6:]


def _state(name: str, values: np.ndarray) -> State:
    state = new_state(name)
    floats(state.header, len(values))[:] = values
    return state
