"""Calls that fly: arming, tasks, poses."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from inspect import Parameter, Signature
from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.airsim.frames import from_geo_point, from_pose, from_vector3r, merged_pose
from mavfi.extras.airsim.piloted import (
    Task,
    Vertical,
    Yaw,
    at_attitude,
    at_rates,
    fly_path,
    fly_rotors,
    fly_velocity,
    fly_velocity_at,
    from_body,
    hover,
    land,
    motors,
    take_off,
    turn_to,
)
from mavfi.extras.airsim.table import Api, add_readings, call, require_ready, task, vehicle_call

_FORWARD_ONLY = 1
_HOME_SPEED = 0.5
_RC_S = 1e6


def yaw_of(mode: Any, drivetrain: Any = 0) -> Yaw:  # noqa: ANN401 - a client's
    """YawMode and DrivetrainType; without a mode, a yaw rate of 0.

    The key `rad`, which only mavfi's own client sends, is the value in rad or rad/s: a conversion to degrees and back
    changes the last bit in some cases.

    Raises:
        BadInputError: It is none.
    """
    if mode is None:
        return Yaw()
    try:
        if "rad" in mode:
            value = float(mode["rad"])
        else:
            value = math.radians(float(mode["yaw_or_rate"]))
        return Yaw(bool(mode["is_rate"]), value, drivetrain == _FORWARD_ONLY)
    except (KeyError, TypeError, ValueError):
        raise BadInputError(f"{mode!r}: allowed: a YawMode (is_rate, yaw_or_rate)") from None


# ---- control ---------------------------------------------------------------------------------------------------------
@call
def reset(api: Api) -> None:
    """All vehicles return to their starts."""
    for other in api.scene.vehicles.values():
        other.vehicle.reset()


add_readings(
    vehicle_call,
    {
        "isApiControlEnabled": lambda api: api.vehicle.api,
        "cancelLastTask": lambda api: api.vehicle.cancel(),
    },
)


@vehicle_call
def enableApiControl(api: Api, is_enabled: bool) -> None:
    api.vehicle.api = bool(is_enabled)


@vehicle_call
def armDisarm(api: Api, arm: bool) -> bool:
    if bool(arm) != api.vehicle.sim.armed:
        if not arm:
            api.vehicle.cancel()
        api.vehicle.sim.arm(bool(arm))
    return True


@vehicle_call
def simSetVehiclePose(api: Api, pose: Any, ignore_collision: bool) -> bool:
    """What is NaN stays as it is."""
    current = api.vehicle.in_ned(api.vehicle.sim.odometry)[:2]
    api.vehicle.place(*merged_pose(from_pose(pose), current))
    return True


@vehicle_call
def simSetKinematics(api: Api, state: Any, ignore_collision: bool) -> None:
    try:
        moving = [from_vector3r(state[name]) for name in ("linear_velocity", "angular_velocity")]
    except (KeyError, TypeError):
        raise BadInputError(f"{state!r}: allowed: a KinematicsState") from None
    if any(any(values) for values in moving):
        raise BadInputError("simSetKinematics: a velocity cannot be set; allowed: 0")
    current = api.vehicle.in_ned(api.vehicle.sim.odometry)[:2]
    api.vehicle.place(*merged_pose(from_pose(state), current))


# ---- tasks -----------------------------------------------------------------------------------------------------------
@task
def takeoff(api: Api, timeout_sec: float = 20.0) -> Task:
    return take_off(api.vehicle, timeout_sec)


@partial(task, name="land")
def _land(api: Api, timeout_sec: float = 60.0) -> Task:
    return land(api.vehicle, timeout_sec)


@task
def goHome(api: Api, timeout_sec: float = 3e38) -> Task:
    return fly_path(api.vehicle, [(0.0, 0.0, 0.0)], _HOME_SPEED, timeout_sec, Yaw())


@partial(task, name="hover")
def _hover(api: Api) -> Task:
    return hover(api.vehicle)


_VELOCITIES = {
    "moveByVelocity": "vx vy vz",
    "moveByVelocityZ": "vx vy z",
    "moveByVelocityBodyFrame": "vx vy vz",
    "moveByVelocityZBodyFrame": "vx vy z",
}
"""Arguments of the tasks for velocities (m/s; height, m), before the duration."""


def _with_signature(function: Callable[..., Task], numbers: Sequence[str], **others: Any) -> Callable[..., Task]:
    """Name the arguments of a task: numbers, then others with their defaults."""
    kind = Parameter.POSITIONAL_ONLY
    parameters = [Parameter("api", kind), *(Parameter(name, kind, annotation=float) for name in numbers)]
    parameters += [Parameter(name, kind, default=default, annotation=type(default)) for name, default in others.items()]
    function.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return function


def _add_velocity_task(name: str, arguments: str) -> None:
    along_heading = name.endswith("BodyFrame")
    at_height = arguments.endswith(" z")

    def fly(
        api: Api, vx: float, vy: float, vertical: float, duration: float, drivetrain: int = 0, yaw_mode: Any = None
    ) -> Task:
        yaw = yaw_of(yaw_mode, drivetrain)
        horizontal = (vx, vy)
        if along_heading:
            horizontal = from_body(api.vehicle, vx, vy)
        if at_height:
            return fly_velocity_at(api.vehicle, horizontal, vertical, duration, yaw)
        return fly_velocity(api.vehicle, (*horizontal, vertical), duration, yaw)

    numbers = (*arguments.split(), "duration")
    task(_with_signature(fly, numbers, drivetrain=0, yaw_mode=None), name)


for _name, _arguments in _VELOCITIES.items():
    _add_velocity_task(_name, _arguments)


@task
def moveOnPath(
    api: Api,
    path: Any,
    velocity: float,
    timeout_sec: float,
    drivetrain: int,
    yaw_mode: Any,
    lookahead: float,
    adaptive_lookahead: float,
) -> Task:
    yaw = yaw_of(yaw_mode, drivetrain)
    if yaw.is_rate and drivetrain == _FORWARD_ONLY:
        raise BadInputError("moveOnPath: ForwardOnly with a yaw rate; allowed: YawMode(is_rate=False)")
    if not isinstance(path, list) or not path:
        raise BadInputError("moveOnPath: no path; allowed: at least one Vector3r")
    return fly_path(api.vehicle, [from_vector3r(point) for point in path], velocity, timeout_sec, yaw, lookahead)


@task
def moveToPosition(
    api: Api,
    x: float,
    y: float,
    z: float,
    velocity: float,
    timeout_sec: float,
    drivetrain: int,
    yaw_mode: Any,
    lookahead: float,
    adaptive_lookahead: float,
) -> Task:
    return fly_path(api.vehicle, [(x, y, z)], velocity, timeout_sec, yaw_of(yaw_mode, drivetrain), lookahead)


@task
def moveToGPS(
    api: Api,
    latitude: float,
    longitude: float,
    altitude: float,
    velocity: float,
    timeout_sec: float,
    drivetrain: int,
    yaw_mode: Any,
    lookahead: float,
    adaptive_lookahead: float,
) -> Task:
    target = api.from_scene(from_geo_point({"latitude": latitude, "longitude": longitude, "altitude": altitude}))
    return fly_path(api.vehicle, [target], velocity, timeout_sec, yaw_of(yaw_mode, drivetrain), lookahead)


@task
def moveToZ(
    api: Api, z: float, velocity: float, timeout_sec: float, yaw_mode: Any, lookahead: float, adaptive_lookahead: float
) -> Task:
    north, east, _ = api.vehicle.position
    return fly_path(api.vehicle, [(north, east, z)], velocity, timeout_sec, yaw_of(yaw_mode), lookahead)


@task
def rotateToYaw(api: Api, yaw: float, timeout_sec: float, margin: float) -> Task:
    return turn_to(api.vehicle, math.radians(yaw), timeout_sec, math.radians(margin))


@task
def rotateByYawRate(api: Api, yaw_rate: float, duration: float) -> Task:
    return fly_velocity(api.vehicle, (0.0, 0.0, 0.0), duration, Yaw(value=math.radians(yaw_rate)))


# ---- attitude, rates, motors -----------------------------------------------------------------------------------------
_ATTITUDES = {
    "moveByRollPitchYawZ": "roll pitch yaw z",
    "moveByRollPitchYawThrottle": "roll pitch yaw throttle",
    "moveByRollPitchYawrateThrottle": "roll pitch yaw_rate throttle",
    "moveByRollPitchYawrateZ": "roll pitch yaw_rate z",
    "moveByAngleRatesZ": "roll_rate pitch_rate yaw_rate z",
    "moveByAngleRatesThrottle": "roll_rate pitch_rate yaw_rate throttle",
    "moveByAngle": "pitch roll z yaw",  # before AirSim 1.3
    "moveByAngleZ": "pitch roll z yaw",
    "moveByAngleThrottle": "pitch roll throttle yaw_rate",
}
"""Arguments of the tasks for attitudes and body rates (rad, rad/s), before the duration."""


def _add_attitude_task(name: str, arguments: str) -> None:
    numbers = (*arguments.split(), "duration")

    def fly(api: Api, *values: Any) -> Task:
        target = dict(zip(numbers, values, strict=False))
        vertical = Vertical(target.get("throttle"), target.get("z", 0.0))
        if "roll_rate" in target:
            rotors = at_rates(api.vehicle, target["roll_rate"], target["pitch_rate"], target["yaw_rate"], vertical)
        else:
            yaw = target.get("yaw", 0.0)
            rotors = at_attitude(api.vehicle, target["roll"], target["pitch"], yaw, target.get("yaw_rate"), vertical)
        return fly_rotors(api.vehicle, rotors, target["duration"])

    task(_with_signature(fly, numbers), name)


for _name, _arguments in _ATTITUDES.items():
    _add_attitude_task(_name, _arguments)


@task
def moveByMotorPWMs(
    api: Api,
    front_right_pwm: float,
    rear_left_pwm: float,
    front_left_pwm: float,
    rear_right_pwm: float,
    duration: float,
) -> Task:
    shares = (front_right_pwm, rear_left_pwm, front_left_pwm, rear_right_pwm)
    if not np.isfinite(shares).all():
        raise BadInputError(f"moveByMotorPWMs: {shares}: allowed: 0 to 1")
    return fly_rotors(api.vehicle, motors(api.vehicle, shares), duration)


@vehicle_call
def moveByRC(api: Api, rcdata: Any) -> None:
    """Positions of the sticks of a remote control: roll, pitch and yaw rate from -1 to 1, throttle from 0 to 1."""
    try:
        sticks = {key: float(rcdata[key]) for key in ("roll", "pitch", "yaw", "throttle")}
    except (KeyError, TypeError, ValueError):
        raise BadInputError(f"{rcdata!r}: allowed: RCData") from None
    require_ready(api, "moveByRC")
    api.sticks = sticks
    tilt = api.vehicle.scenario.vehicle.max_tilt
    rotors = at_attitude(
        api.vehicle,
        tilt * sticks["roll"],
        tilt * sticks["pitch"],
        0.0,
        api.vehicle.scenario.vehicle.max_yaw_rate * sticks["yaw"],
        Vertical(sticks["throttle"]),
    )
    api.vehicle.start(fly_rotors(api.vehicle, rotors, _RC_S))


@task
def moveByManual(
    api: Api, vx_max: float, vy_max: float, z_min: float, duration: float, drivetrain: int, yaw_mode: Any
) -> Task:
    """Velocities from the sticks of the last moveByRC; without one, they are centred."""
    forward = vx_max * api.sticks.get("pitch", 0.0)
    right = vy_max * api.sticks.get("roll", 0.0)
    velocity = from_body(api.vehicle, forward, right)
    return fly_velocity_at(api.vehicle, velocity, z_min, duration, yaw_of(yaw_mode, drivetrain))
