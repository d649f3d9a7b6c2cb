"""Publications of the vehicle's sensors: the true odometry, or the inputs of an estimator."""

from dataclasses import dataclass, field

import numpy as np

from mavfi.config import LocalizationConfig
from mavfi.flight.plant import Plant
from mavfi.pipeline.memory import Memory
from mavfi.sim.scene import STEP_US
from mavfi.states import ODOMETRY, State, floats, new_state

_ESTIMATE = ODOMETRY["estimator"]


@dataclass(slots=True)
class SensorMemory(Memory):
    """When the next position fix is due (us), and the last estimate published to consumers: position, quaternion."""

    next_fix_us: int = 0
    estimate: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))


class Sensors:
    """The sensors of one flight; `estimating`: whether an estimator is used; `memory`: their state.

    With an estimator, the true pose is published only through sensors: an image carries the last estimate published to
    consumers, whereas the camera renders from the true pose.
    """

    def __init__(self, plant: Plant, localization: LocalizationConfig) -> None:
        self.estimating = localization.kind == "estimator"
        self._plant = plant
        self._period_us = localization.position_period_us
        self.memory = SensorMemory()

    def samples_between(self, now: int, later: int) -> range:
        """Sampling instants of the IMU (us) between `now` and the next control period `later`, both exclusive."""
        return range(now + STEP_US, later, STEP_US) if self.estimating else range(0)

    def depth(self) -> State:
        """A depth image with the believed pose."""
        ranges, pose = self._plant.depth()
        state = new_state("sensor.depth", len(ranges))
        floats(state.header, 7)[:] = self.memory.estimate if self.estimating else pose
        state.elements["range"] = ranges
        return state

    def motion(self, now: int) -> list[State]:
        """Motion sensors: the true odometry; or an IMU sample, preceded by a position fix when one is due."""
        if not self.estimating:
            return [_state(ODOMETRY["truth"], self._plant.odometry)]
        measured = []
        if now >= self.memory.next_fix_us:
            self.memory.next_fix_us += self._period_us
            measured.append(_state("sensor.position", self._plant.position_fix()))
        return [*measured, _state("sensor.imu", self._plant.imu())]

    def see(self, state: State) -> None:
        """Store the last estimate published to consumers."""
        if state.spec.name == _ESTIMATE:
            values = floats(state.header, 10)
            self.memory.estimate = np.concatenate([values[:3], values[6:]])


def _state(name: str, values: np.ndarray) -> State:
    state = new_state(name)
    floats(state.header, len(values))[:] = values
    return state
