"""Calls that fly: arming, tasks, poses."""

import math
from functools import partial
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
"""DrivetrainType.ForwardOnly: the vehicle looks in the direction of flight."""
_HOME_SPEED = 0.5
"""Speed of the way home (m/s)."""
_RC_S = 1e6
"""Time for which positions of the sticks hold, until the next call (s): for ever."""


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


@task
def moveByVelocity(
    api: Api, vx: float, vy: float, vz: float, duration: float, drivetrain: int = 0, yaw_mode: Any = None
) -> Task:
    return fly_velocity(api.vehicle, (vx, vy, vz), duration, yaw_of(yaw_mode, drivetrain))


@task
def moveByVelocityZ(
    api: Api, vx: float, vy: float, z: float, duration: float, drivetrain: int = 0, yaw_mode: Any = None
) -> Task:
    return fly_velocity_at(api.vehicle, (vx, vy), z, duration, yaw_of(yaw_mode, drivetrain))


@task
def moveByVelocityBodyFrame(
    api: Api, vx: float, vy: float, vz: float, duration: float, drivetrain: int = 0, yaw_mode: Any = None
) -> Task:
    velocity = (*from_body(api.vehicle, vx, vy), vz)
    return fly_velocity(api.vehicle, velocity, duration, yaw_of(yaw_mode, drivetrain))


@task
def moveByVelocityZBodyFrame(
    api: Api, vx: float, vy: float, z: float, duration: float, drivetrain: int = 0, yaw_mode: Any = None
) -> Task:
    return fly_velocity_at(api.vehicle, from_body(api.vehicle, vx, vy), z, duration, yaw_of(yaw_mode, drivetrain))


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
# Angles in rad, rates in rad/s, FRD.  The height z (NED, m) or the throttle, a share of the largest thrust, sets the
# collective thrust.
@task
def moveByRollPitchYawZ(api: Api, roll: float, pitch: float, yaw: float, z: float, duration: float) -> Task:
    return fly_rotors(api.vehicle, at_attitude(api.vehicle, roll, pitch, yaw, None, Vertical(z=z)), duration)


@task
def moveByRollPitchYawThrottle(
    api: Api, roll: float, pitch: float, yaw: float, throttle: float, duration: float
) -> Task:
    return fly_rotors(api.vehicle, at_attitude(api.vehicle, roll, pitch, yaw, None, Vertical(throttle)), duration)


@task
def moveByRollPitchYawrateZ(api: Api, roll: float, pitch: float, yaw_rate: float, z: float, duration: float) -> Task:
    return fly_rotors(api.vehicle, at_attitude(api.vehicle, roll, pitch, 0.0, yaw_rate, Vertical(z=z)), duration)


@task
def moveByRollPitchYawrateThrottle(
    api: Api, roll: float, pitch: float, yaw_rate: float, throttle: float, duration: float
) -> Task:
    return fly_rotors(api.vehicle, at_attitude(api.vehicle, roll, pitch, 0.0, yaw_rate, Vertical(throttle)), duration)


@task
def moveByAngleRatesZ(
    api: Api, roll_rate: float, pitch_rate: float, yaw_rate: float, z: float, duration: float
) -> Task:
    return fly_rotors(api.vehicle, at_rates(api.vehicle, roll_rate, pitch_rate, yaw_rate, Vertical(z=z)), duration)


@task
def moveByAngleRatesThrottle(
    api: Api, roll_rate: float, pitch_rate: float, yaw_rate: float, throttle: float, duration: float
) -> Task:
    return fly_rotors(api.vehicle, at_rates(api.vehicle, roll_rate, pitch_rate, yaw_rate, Vertical(throttle)), duration)


def moveByAngleZ(api: Api, pitch: float, roll: float, z: float, yaw: float, duration: float) -> Task:
    return fly_rotors(api.vehicle, at_attitude(api.vehicle, roll, pitch, yaw, None, Vertical(z=z)), duration)


task(moveByAngleZ)
task(moveByAngleZ, "moveByAngle")  # its name before AirSim 1.3


@task
def moveByAngleThrottle(api: Api, pitch: float, roll: float, throttle: float, yaw_rate: float, duration: float) -> Task:
    return fly_rotors(api.vehicle, at_attitude(api.vehicle, roll, pitch, 0.0, yaw_rate, Vertical(throttle)), duration)


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
