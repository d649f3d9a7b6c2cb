"""Failures of sensors and motors in a flight: at the flight controller's inputs and outputs, and in publications."""

from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault
from mavfi.faults.injector import Injector
from mavfi.flight.loop import Loop
from mavfi.flight.taps import InjectorTap
from mavfi.levels.sensor.failures import Failures
from mavfi.levels.sensor.fault import SensorFault, check_read
from mavfi.record import Injection
from mavfi.sim.controller import Controller
from mavfi.states import State, floats


class FailingController:
    """A flight controller that reads failing sensors and commands failing motors.

    Args:
        controller: The controller.
        failures: Failures of the vehicle.
        max_thrust: Of a rotor (N).
        since_us: Time of the failures at the controller's time 0.
    """

    rewindable = False

    def __init__(self, controller: Controller, failures: Failures, max_thrust: float, since_us: int = 0) -> None:
        self._controller = controller
        self._failures = failures
        self._max_thrust = max_thrust
        self._since_us = since_us
        self.period_us = controller.period_us

    def rotors(self, time_us: int, setpoint: np.ndarray, odometry: np.ndarray, force: np.ndarray) -> np.ndarray:
        """See `Controller.rotors`."""
        failures = self._failures
        now = self._since_us + time_us
        wanted = self._controller.rotors(time_us, setpoint, failures.state(now, odometry), failures.force(now, force))
        return failures.rotors(now, wanted, self._max_thrust)

    def save(self) -> bytes:
        """See `Controller.save`."""
        return self._controller.save()

    def restore(self, saved: bytes) -> None:
        """See `Controller.restore`."""
        self._controller.restore(saved)

    def close(self) -> None:
        """See `Controller.close`."""
        self._controller.close()


class SensorInjector(Injector):
    """Injector tap of a flight that has not started: changes the publications of sensors, and the flight controller.

    An image carries the pose that its readers believe, as with an estimator.

    Raises:
        BadInputError: Nothing in this flight reads the device.
    """

    def __init__(self, loop: Loop, fault: SensorFault) -> None:
        check_read(fault.unit, loop.scenario.flight_controller, loop.scenario.localization.kind)
        plant: Any = loop.plant
        self._plant = plant
        self._estimating = loop.sensors.estimating
        self._failures = Failures()
        self._failure = self._failures.begin(fault)
        if hasattr(plant, "controller"):
            limit = loop.scenario.vehicle.max_rotor_thrust
            plant.controller = FailingController(plant.controller, self._failures, limit)
        elif fault.unit == "motor":
            raise BadInputError(f"fault in {fault.site}: the motors are the server's; allowed with --world: sensors")

    @property
    def injections(self) -> list[Injection]:
        """The injection so far."""
        if self._failure.injection is None:
            return []
        return [self._failure.injection]

    def __call__(self, state: State, time_us: int) -> State:
        """The publication, with the values of failing sensors."""
        failures = self._failures
        match state.spec.name:
            case "sensor.odometry":
                return _with_header(state, failures.state(time_us, floats(state.header, 13)))
            case "sensor.imu":
                return _with_header(state, failures.imu(time_us, floats(state.header, 6)))
            case "sensor.position":
                return _with_header(state, failures.fix(time_us, floats(state.header, 4)))
            case "sensor.depth":
                return self._image(state, time_us)
        return state

    def _image(self, state: State, time_us: int) -> State:
        """A depth image with the changes that failing sensors cause in its pose and ranges."""
        pose = floats(state.header, 7)
        ranges = state.elements["range"]
        # Without an estimator, the pose is measured; an estimator's has its errors already.
        if not self._estimating:
            measured = self._failures.state(time_us, self._plant.odometry)
            if measured is not self._plant.odometry:
                pose = np.concatenate([measured[:3], measured[6:10]])
        image = _with_header(state, pose)
        failed_ranges = self._failures.ranges(time_us, ranges)
        if failed_ranges is not ranges:
            image = image.copy()
            image.elements["range"] = failed_ranges
        return image

    def finish(self) -> list[Injection]:
        """The injection, or a record that it was not activated."""
        return [self._failure.record()]


def _with_header(state: State, values: np.ndarray) -> State:
    """The state, or a copy with other leading numbers in its header."""
    current = floats(state.header, len(values))
    if current.tobytes() == values.tobytes():
        return state
    changed = state.copy()
    floats(changed.header, len(values))[:] = values
    return changed


class InjectorChain:
    """Two injectors as one: the second receives what the first leaves.

    Args:
        first: Applied first.
        second: Applied to its result.
    """

    def __init__(self, first: InjectorTap, second: InjectorTap) -> None:
        self._first = first
        self._second = second

    @property
    def spent(self) -> bool:
        """See `InjectorTap.spent`."""
        return self._first.spent and self._second.spent

    @property
    def injections(self) -> list[Injection]:
        """Those so far."""
        injections: list[Injection] = []
        for injector in (self._first, self._second):
            injections += getattr(injector, "injections", ())
        return injections

    def __call__(self, state: State, time_us: int) -> State | None:
        """See `InjectorTap`."""
        seen = self._first(state, time_us)
        if seen is None:
            return None
        return self._second(seen, time_us)

    def finish(self) -> list[Injection]:
        """See `InjectorTap`."""
        return self._first.finish() + self._second.finish()


def inject_sensor_fault(loop: Loop, fault: Fault | None) -> bool:
    """Install the injector of a sensor fault in a flight that has not started; returns whether the fault is one.

    An injector that the flight already has receives what readers of the failing sensor do.
    """
    if not isinstance(fault, SensorFault):
        return False
    injector = SensorInjector(loop, fault)
    earlier = loop.taps.injector
    if earlier is None:
        loop.taps.injector = injector
    else:
        loop.taps.injector = InjectorChain(injector, earlier)
    return True
