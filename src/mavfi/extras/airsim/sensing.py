"""Calls that return states and sensor data: collisions, inertial and other sensors, cameras, lidar."""

import math
from functools import cache

import numpy as np

from mavfi.extras.airsim import grounded
from mavfi.extras.airsim.fleet import VEHICLES
from mavfi.extras.airsim.frames import (
    LEVEL,
    NO_MOUNT,
    Data,
    flipped,
    to_geo_point,
    to_pose,
    to_quaternionr,
    to_vector3r,
)
from mavfi.extras.airsim.piloted import FLYING, LANDED
from mavfi.extras.airsim.table import (
    DESTROYED,
    GROUND,
    Api,
    add_readings,
    vehicle_call,
)
from mavfi.numerics.elementary import cos, sin
from mavfi.numerics.rotations import rotation_matrix
from mavfi.sim.engine import GRAVITY

_CHANNELS = 16
_STEPS = 360
_LIDAR_TOP_DEG = -15.0
_LIDAR_BOTTOM_DEG = -25.0
_LIDAR_RANGE = 100.0
_NEAREST = 0.2
_FARTHEST = 40.0
_FIELD = (0.253, 0.049, 0.428)
"""Magnetic field at Redmond, WA, NED (gauss): World Magnetic Model, rounded."""
_SEA_LEVEL_PA = 101325.0
_QNH = 1013.25
_AIR_DENSITY = 1.225
_THRUST_COEFFICIENT = 0.109919
_PROPELLER_M = 0.2286
"""Thrust coefficient and diameter of AirSim's propeller (RotorParams: GWS 9x5, measured by UIUC)."""


def kinematics(api: Api, odometry: np.ndarray) -> Data:
    """KinematicsState of a state of the vehicle."""
    position, orientation, velocity, rates = api.vehicle.in_ned(odometry)
    return {
        **to_pose(position, orientation),
        "linear_velocity": to_vector3r(velocity),
        "angular_velocity": to_vector3r(rates),
        "linear_acceleration": to_vector3r(flipped(api.vehicle.sim.acceleration())),
        "angular_acceleration": to_vector3r((0, 0, 0)),
    }


def collision(api: Api) -> Data:
    """CollisionInfo."""
    # without a contact all of it is zero
    vehicle = api.vehicle
    contact = vehicle.collision
    if contact is None:
        zero = to_vector3r((0, 0, 0))
        return {
            "has_collided": vehicle.has_collided,
            "normal": zero,
            "impact_point": zero,
            "position": zero,
            "penetration_depth": 0.0,
            "time_stamp": 0,
            "object_name": "",
            "object_id": -1,
        }

    # the last contact, with the name of what was touched
    names_of_others = {grounded.GROUND: GROUND, grounded.SCAN: "scan", DESTROYED: ""}
    names_of_others |= {VEHICLES - number: name for number, name in enumerate(api.scene.vehicles)}
    if contact.obstacle < 0:  # not one of the world's boxes
        name = names_of_others[contact.obstacle]
    else:
        name = api.scene.objects[contact.obstacle]
    return {
        "has_collided": vehicle.has_collided,
        "normal": to_vector3r(flipped(contact.normal)),
        "impact_point": to_vector3r(vehicle.to_ned(contact.point)),
        "position": to_vector3r(vehicle.to_ned(contact.vehicle)),
        "penetration_depth": contact.depth,
        "time_stamp": vehicle.stamp - 1000 * (vehicle.sim.time_us - contact.time_us),
        "object_name": name,
        "object_id": contact.obstacle,
    }


@vehicle_call
def getMultirotorState(api: Api) -> Data:
    switches = {f"switch{n}": 0 for n in range(1, 9)}
    landed_state = FLYING
    if api.vehicle.landed:
        landed_state = LANDED
    sticks = {key: api.sticks.get(key, 0.0) for key in ("pitch", "roll", "throttle", "yaw")}
    return {
        "collision": collision(api),
        "kinematics_estimated": kinematics(api, api.vehicle.measured_state),
        "gps_location": to_geo_point(api.in_scene(api.vehicle.position)),
        "timestamp": api.vehicle.stamp,
        "landed_state": landed_state,
        "rc_data": {
            "timestamp": 0,
            **sticks,
            "left_z": 0.0,
            "right_z": 0.0,
            "is_initialized": bool(api.sticks),
            "is_valid": bool(api.sticks),
            "vendor_id": "",
            **switches,
        },
        "ready": True,
        "ready_message": "",
        "can_arm": True,
    }


@vehicle_call
def simGetGroundTruthEnvironment(api: Api) -> Data:
    position, *_ = api.vehicle.in_ned(api.vehicle.sim.odometry)
    geo_point = to_geo_point(api.in_scene(position))
    height = geo_point["altitude"]
    kelvin = 288.15 - 0.0065 * height
    return {
        "position": to_vector3r(position),
        "geo_point": geo_point,
        "gravity": to_vector3r((0.0, 0.0, GRAVITY)),
        "air_pressure": _pressure(height),
        "temperature": kelvin,
        "air_density": _pressure(height) / (287.053 * kelvin),
    }


@vehicle_call
def getRotorStates(api: Api) -> Data:
    thrusts = api.vehicle.sim.thrusts.tolist()
    ratio = api.vehicle.scenario.vehicle.rotor_torque_ratio
    rotors = [{"thrust": thrust, "torque_scaler": thrust * ratio, "speed": _rotor_speed(thrust)} for thrust in thrusts]
    return {"timestamp": api.vehicle.stamp, "rotors": rotors}


def _rotor_speed(thrust: float) -> float:
    """Speed (rad/s) at which AirSim's propeller has a thrust (N): T = C_T rho n^2 D^4."""
    per_square = _THRUST_COEFFICIENT * _AIR_DENSITY * _PROPELLER_M**4
    return 2.0 * math.pi * math.sqrt(max(0.0, thrust) / per_square)


# ---- motion sensors --------------------------------------------------------------------------------------------------
@vehicle_call
def getImuData(api: Api, imu_name: str = "") -> Data:
    sample = api.vehicle.imu()
    return {
        "time_stamp": api.vehicle.stamp,
        "orientation": to_quaternionr(api.vehicle.orientation),
        "angular_velocity": to_vector3r(flipped(sample[3:])),
        "linear_acceleration": to_vector3r(flipped(sample[:3])),
    }


def _pressure(height: float) -> float:
    """Air pressure of the standard atmosphere (Pa) at a height (m)."""
    base = 1.0 - 2.25577e-5 * height
    if base > 0.0:
        return float(_SEA_LEVEL_PA * base**5.25588)
    return 0.0


@vehicle_call
def getBarometerData(api: Api, barometer_name: str = "") -> Data:
    height = to_geo_point(api.in_scene(api.vehicle.position))["altitude"]
    return {"time_stamp": api.vehicle.stamp, "altitude": height, "pressure": _pressure(height), "qnh": _QNH}


@vehicle_call
def getMagnetometerData(api: Api, magnetometer_name: str = "") -> Data:
    matrix = np.empty((3, 3))
    rotation_matrix(np.array(api.vehicle.orientation), matrix)
    body = [float(sum(matrix[k, axis] * _FIELD[k] for k in range(3))) for axis in range(3)]
    return {"time_stamp": api.vehicle.stamp, "magnetic_field_body": to_vector3r(body), "magnetic_field_covariance": []}


@vehicle_call
def getGpsData(api: Api, gps_name: str = "") -> Data:
    vehicle = api.vehicle
    gnss = {
        "geo_point": to_geo_point(api.in_scene(vehicle.position)),
        "eph": 0.1,
        "epv": 0.1,
        "velocity": to_vector3r(vehicle.velocity),
        "fix_type": 3,
        "time_utc": vehicle.stamp // 1000,
    }
    return {"time_stamp": vehicle.stamp, "gnss": gnss, "is_valid": True}


@vehicle_call
def getDistanceSensorData(api: Api, distance_sensor_name: str = "") -> Data:
    distance = float(api.cast(np.array([[1.0, 0.0, 0.0]]), _FARTHEST, NO_MOUNT)[0])
    return {
        "time_stamp": api.vehicle.stamp,
        "distance": min(_FARTHEST, max(_NEAREST, distance)),
        "min_distance": _NEAREST,
        "max_distance": _FARTHEST,
        "relative_pose": to_pose((0, 0, 0), LEVEL),
    }


@cache
def lidar_rays() -> np.ndarray:
    """Unit vectors of AirSim's default lidar, 16 channels around the vehicle, body frame (z up). Shape (n, 3)."""
    elevation = np.radians(np.linspace(_LIDAR_TOP_DEG, _LIDAR_BOTTOM_DEG, _CHANNELS))
    azimuth = np.radians(np.linspace(-180.0, 180.0, _STEPS, endpoint=False))
    turns = [(cos(turn), sin(turn)) for turn in azimuth]
    tilts = [(cos(tilt), sin(tilt)) for tilt in elevation]
    return np.array([(level * x, -level * y, up) for level, up in tilts for x, y in turns])


@vehicle_call
def getLidarData(api: Api, lidar_name: str = "") -> Data:
    """Points in NED (AirSim's frame VehicleInertialFrame)."""
    vehicle = api.vehicle
    rays = lidar_rays()
    ranges = api.cast(rays, _LIDAR_RANGE, NO_MOUNT)
    seen = np.isfinite(ranges)
    points = vehicle.sim.points(rays[seen], ranges[seen]) - vehicle.origin
    points[:, 1:] *= -1.0
    return {
        "point_cloud": points.astype(np.float32).ravel().tolist(),
        "time_stamp": vehicle.stamp,
        "pose": to_pose(vehicle.position, vehicle.orientation),
        "segmentation": [],
    }


add_readings(
    vehicle_call,
    {
        "simGetGroundTruthKinematics": lambda api: kinematics(api, api.vehicle.sim.odometry),
        "simGetVehiclePose": lambda api: to_pose(*api.vehicle.in_ned(api.vehicle.sim.odometry)[:2]),
        "simGetCollisionInfo": collision,
        "getHomeGeoPoint": lambda api: to_geo_point(api.vehicle.home),
        # names before AirSim 1.3
        "getPosition": lambda api: to_vector3r(api.vehicle.position),
        "getVelocity": lambda api: to_vector3r(api.vehicle.velocity),
        "getOrientation": lambda api: to_quaternionr(api.vehicle.orientation),
        "getCollisionInfo": collision,
    },
)
