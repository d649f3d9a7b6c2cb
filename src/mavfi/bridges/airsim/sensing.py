"""Calls that return states and sensor data: collisions, inertial and other sensors, cameras, lidar."""

import math
from functools import cache
from typing import Any

import numpy as np

from mavfi.bridges.airsim import pictures
from mavfi.bridges.airsim.frames import (
    LEVEL,
    Data,
    Triple,
    flipped,
    geo_point,
    looking,
    mount,
    pose,
    pose_numbers,
    quaternion,
    vector,
)
from mavfi.bridges.airsim.frames import rotation as rotated
from mavfi.bridges.airsim.table import (
    DESTROYED,
    GROUND,
    NARROWEST,
    WIDEST,
    Api,
    Camera,
    add_readings,
    call,
    camera_call,
    vehicle_call,
)
from mavfi.bridges.airsim.vehicle import FLYING, LANDED
from mavfi.config import CameraConfig
from mavfi.errors import BadInputError
from mavfi.numerics.elementary import cos, sin, tan
from mavfi.numerics.rotations import rotation_matrix
from mavfi.sim import grounded
from mavfi.sim.engine import GRAVITY

CAMERA_RANGE = 100.0
"""Beyond it a depth image shows the sky (m)."""
SKY = 65504.0
"""Depth of the sky, the largest float16, as in AirSim."""
_FACING = {"front_center": (0, 0), "front_right": (0, 0), "front_left": (0, 0), "bottom_center": (0, -90),
           "back_center": (180, 0)}  # fmt: skip
_NUMBERS = dict(zip("01234", _FACING, strict=True))
_CAMERAS = {**_FACING, "fpv": (0, 0)}
"""AirSim's cameras: turned to the right and up (deg); all of them sit at the centre of the vehicle."""
_CHANNELS, _STEPS = 16, 360
_LIDAR_TOP_DEG, _LIDAR_BOTTOM_DEG, _LIDAR_RANGE = -15.0, -25.0, 100.0
_NEAREST, _FARTHEST = 0.2, 40.0
_FIELD = (0.253, 0.049, 0.428)
"""Magnetic field at Redmond, WA, NED (gauss): World Magnetic Model, rounded."""
_SEA_LEVEL_PA, _QNH = 101325.0, 1013.25
_AIR_DENSITY = 1.225
_THRUST_COEFFICIENT, _PROPELLER_M = 0.109919, 0.2286
"""Thrust coefficient and diameter of AirSim's propeller (RotorParams: GWS 9x5, measured by UIUC)."""


def kinematics(api: Api, odometry: np.ndarray) -> Data:
    """KinematicsState of a state of the vehicle."""
    position, orientation, velocity, rates = api.vehicle.in_ned(odometry)
    return {
        **pose(position, orientation), "linear_velocity": vector(velocity), "angular_velocity": vector(rates),
        "linear_acceleration": vector(flipped(api.vehicle.sim.acceleration())),
        "angular_acceleration": vector((0, 0, 0)),
    }  # fmt: skip


def collision(api: Api) -> Data:
    """CollisionInfo."""
    v, found = api.vehicle, api.vehicle.collision
    if found is None:
        zero = vector((0, 0, 0))
        return {
            "has_collided": v.has_collided, "normal": zero, "impact_point": zero, "position": zero,
            "penetration_depth": 0.0, "time_stamp": 0, "object_name": "", "object_id": -1,
        }  # fmt: skip
    others = {grounded.GROUND: GROUND, grounded.SCAN: "scan", DESTROYED: ""}
    name = others[found.obstacle] if found.obstacle < 0 else api.objects[found.obstacle]
    return {
        "has_collided": v.has_collided, "normal": vector(flipped(found.normal)),
        "impact_point": vector(v.to_ned(found.point)), "position": vector(v.to_ned(found.vehicle)),
        "penetration_depth": found.depth, "time_stamp": v.stamp - 1000 * (v.sim.time_us - found.time_us),
        "object_name": name, "object_id": found.obstacle,
    }  # fmt: skip


@vehicle_call("getMultirotorState")
def _(api: Api) -> Data:
    switches = {f"switch{n}": 0 for n in range(1, 9)}
    sticks = {key: api.sticks.get(key, 0.0) for key in ("pitch", "roll", "throttle", "yaw")}
    return {
        "collision": collision(api), "kinematics_estimated": kinematics(api, api.vehicle.believed),
        "gps_location": geo_point(api.vehicle.position), "timestamp": api.vehicle.stamp,
        "landed_state": LANDED if api.vehicle.landed else FLYING,
        "rc_data": {
            "timestamp": 0, **sticks, "left_z": 0.0, "right_z": 0.0, "is_initialized": bool(api.sticks),
            "is_valid": bool(api.sticks), "vendor_id": "", **switches,
        },
        "ready": True, "ready_message": "", "can_arm": True,
    }  # fmt: skip


@vehicle_call("simGetGroundTruthEnvironment")
def _(api: Api) -> Data:
    position, *_ = api.vehicle.in_ned(api.vehicle.sim.odometry)
    height = geo_point(position)["altitude"]
    kelvin = 288.15 - 0.0065 * height
    return {
        "position": vector(position), "geo_point": geo_point(position), "gravity": vector((0.0, 0.0, GRAVITY)),
        "air_pressure": _pressure(height), "temperature": kelvin,
        "air_density": _pressure(height) / (287.053 * kelvin),
    }  # fmt: skip


@vehicle_call("getRotorStates")
def _(api: Api) -> Data:
    thrusts, ratio = api.vehicle.sim.thrusts.tolist(), api.vehicle.scenario.vehicle.rotor_torque_ratio
    rotors = [{"thrust": thrust, "torque_scaler": thrust * ratio, "speed": _rotor_speed(thrust)} for thrust in thrusts]
    return {"timestamp": api.vehicle.stamp, "rotors": rotors}


def _rotor_speed(thrust: float) -> float:
    """Speed (rad/s) at which AirSim's propeller has a thrust (N): T = C_T rho n^2 D^4."""
    per_square = _THRUST_COEFFICIENT * _AIR_DENSITY * _PROPELLER_M**4
    return 2.0 * math.pi * math.sqrt(max(0.0, thrust) / per_square)


# ---- motion sensors --------------------------------------------------------------------------------------------------
@vehicle_call("getImuData")
def _(api: Api, imu_name: str = "") -> Data:
    sample = api.vehicle.imu()
    return {
        "time_stamp": api.vehicle.stamp, "orientation": rotated(api.vehicle.orientation),
        "angular_velocity": vector(flipped(sample[3:])), "linear_acceleration": vector(flipped(sample[:3])),
    }  # fmt: skip


def _pressure(height: float) -> float:
    """Air pressure of the standard atmosphere (Pa) at a height (m)."""
    base = 1.0 - 2.25577e-5 * height
    return float(_SEA_LEVEL_PA * base**5.25588) if base > 0.0 else 0.0


@vehicle_call("getBarometerData")
def _(api: Api, barometer_name: str = "") -> Data:
    height = geo_point(api.vehicle.position)["altitude"]
    return {"time_stamp": api.vehicle.stamp, "altitude": height, "pressure": _pressure(height), "qnh": _QNH}


@vehicle_call("getMagnetometerData")
def _(api: Api, magnetometer_name: str = "") -> Data:
    matrix = np.empty((3, 3))
    rotation_matrix(np.array(api.vehicle.orientation), matrix)
    body = [float(sum(matrix[k, axis] * _FIELD[k] for k in range(3))) for axis in range(3)]
    return {"time_stamp": api.vehicle.stamp, "magnetic_field_body": vector(body), "magnetic_field_covariance": []}


@vehicle_call("getGpsData")
def _(api: Api, gps_name: str = "") -> Data:
    v = api.vehicle
    gnss = {
        "geo_point": geo_point(v.position), "eph": 0.1, "epv": 0.1, "velocity": vector(v.velocity), "fix_type": 3,
        "time_utc": v.stamp // 1000,
    }  # fmt: skip
    return {"time_stamp": v.stamp, "gnss": gnss, "is_valid": True}


@vehicle_call("getDistanceSensorData")
def _(api: Api, distance_sensor_name: str = "") -> Data:
    found = float(api.vehicle.sim.cast(np.array([[1.0, 0.0, 0.0]]), _FARTHEST)[0])
    return {
        "time_stamp": api.vehicle.stamp, "distance": min(_FARTHEST, max(_NEAREST, found)), "min_distance": _NEAREST,
        "max_distance": _FARTHEST, "relative_pose": pose((0, 0, 0), LEVEL),
    }  # fmt: skip


@cache
def lidar_rays() -> np.ndarray:
    """Unit vectors of AirSim's default lidar, 16 channels around the vehicle, body frame (z up). Shape (n, 3)."""
    elevation = np.radians(np.linspace(_LIDAR_TOP_DEG, _LIDAR_BOTTOM_DEG, _CHANNELS))
    azimuth = np.radians(np.linspace(-180.0, 180.0, _STEPS, endpoint=False))
    turns = [(cos(turn), sin(turn)) for turn in azimuth]
    tilts = [(cos(tilt), sin(tilt)) for tilt in elevation]
    return np.array([(level * x, -level * y, up) for level, up in tilts for x, y in turns])


@vehicle_call("getLidarData")
def _(api: Api, lidar_name: str = "") -> Data:
    """Points in NED (AirSim's frame VehicleInertialFrame)."""
    v, rays = api.vehicle, lidar_rays()
    ranges = v.sim.cast(rays, _LIDAR_RANGE)
    seen = np.isfinite(ranges)
    points = v.sim.points(rays[seen], ranges[seen]) - v.origin
    points[:, 1:] *= -1.0
    return {
        "point_cloud": points.astype(np.float32).ravel().tolist(), "time_stamp": v.stamp,
        "pose": pose(v.position, v.orientation), "segmentation": [],
    }  # fmt: skip


# ---- cameras ---------------------------------------------------------------------------------------------------------
def find_camera(api: Api, name: Any) -> Camera:  # noqa: ANN401 - a client's
    """A camera by name or number.

    Raises:
        BadInputError: There is none.
    """
    known = _NUMBERS.get(str(name), str(name))
    if known not in _CAMERAS:
        raise BadInputError(f"camera {name!r}: not known; allowed: {', '.join([*_NUMBERS, *_CAMERAS])}")
    if known not in api.cameras:
        api.cameras[known] = Camera((0.0, 0.0, 0.0), looking(*_CAMERAS[known]))
    return api.cameras[known]


def view(api: Api, name: Any, kind: int) -> pictures.View:  # noqa: ANN401 - a client's
    """What a camera sees now; images of a kind with depth are those of a depth camera, which can fail."""
    found, (width, height) = find_camera(api, name), api.pixels
    config = CameraConfig(width=width, height=height, field_of_view=math.radians(found.fov_deg), range=CAMERA_RANGE)
    placed = mount(found.position, found.orientation)
    ranges, rays = api.vehicle.sim.ranges(config, placed)
    if kind in pictures.DEPTH:
        ranges = api.vehicle.failures.ranges(api.vehicle.now_us, ranges, f"{name} {width}x{height}")
    return pictures.View(ranges, rays, width, height, api.vehicle.sim.sensor_pose(placed))


def _camera_pose(api: Api, name: Any) -> tuple[Any, Any]:
    found = find_camera(api, name)
    at = api.vehicle.sim.sensor_pose(mount(found.position, found.orientation))
    return api.vehicle.to_ned(np.array(at[:3])), (at[3], at[4], -at[5], -at[6])


@call("simGetImage")
def _(api: Api, camera_name: str, image_type: int, vehicle_name: str = "", annotation_name: Any = "") -> bytes:
    return pictures.encoded(api, view(api, camera_name, image_type), image_type)


@camera_call("simGetImages")
def _(api: Api, requests: Any) -> list[Data]:
    return [_response(api, request) for request in requests]


def _response(api: Api, request: Any) -> Data:
    """ImageResponse to an ImageRequest."""
    try:
        name, kind = request["camera_name"], int(request["image_type"])
        as_float, compress = bool(request["pixels_as_float"]), bool(request["compress"])
    except (KeyError, TypeError, ValueError):
        raise BadInputError(f"{request!r}: allowed: an ImageRequest") from None
    seen = view(api, name, kind)
    position, orientation = _camera_pose(api, name)
    return {
        "image_data_uint8": b"" if as_float else pictures.encoded(api, seen, kind, compress),
        "image_data_float": pictures.floats(seen, kind, SKY) if as_float else [],
        "camera_position": vector(position), "camera_name": str(name), "camera_orientation": rotated(orientation),
        "time_stamp": api.vehicle.stamp, "message": "", "pixels_as_float": as_float, "compress": compress,
        "width": seen.width, "height": seen.height, "image_type": kind, "annotation_name": "",
    }  # fmt: skip


@camera_call("simGetCameraInfo")
def _(api: Api, camera_name: str) -> Data:
    width, height = api.pixels
    fov = find_camera(api, camera_name).fov_deg
    x = 1.0 / tan(math.radians(0.5 * fov))
    matrix = [[x, 0.0, 0.0, 0.0], [0.0, x * width / height, 0.0, 0.0], [0.0, 0.0, 0.0, 10.0], [0.0, 0.0, 1.0, 0.0]]
    return {"pose": pose(*_camera_pose(api, camera_name)), "fov": fov, "proj_mat": {"matrix": matrix}}


@camera_call("simSetCameraPose")
def _(api: Api, camera_name: str, pose: Any) -> None:
    place_camera(find_camera(api, camera_name), *pose_numbers(pose))


def place_camera(camera: Camera, position: Triple, orientation: tuple[float, float, float, float]) -> None:
    """Set position and orientation in the body frame FRD (m, w x y z).

    Raises:
        BadInputError: Not finite, or an orientation of zero.
    """
    norm = math.sqrt(sum(value * value for value in orientation))
    if not norm > 0.0 or not all(map(math.isfinite, (*position, *orientation))):
        text = "allowed: finite numbers, an orientation other than zero"
        raise BadInputError(f"camera at {position}, orientation {orientation}: {text}")
    camera.position = position
    camera.orientation = tuple(value / norm for value in orientation)  # type: ignore[assignment]


@camera_call("simSetCameraFov")
def _(api: Api, camera_name: str, fov_degrees: float) -> None:
    if not NARROWEST <= fov_degrees <= WIDEST:
        raise BadInputError(f"simSetCameraFov: {fov_degrees}: allowed: {NARROWEST:g} to {WIDEST:g} deg")
    find_camera(api, camera_name).fov_deg = float(fov_degrees)


@vehicle_call("simSetCameraOrientation")
def _(api: Api, camera_name: str, orientation: Any) -> None:
    camera = find_camera(api, camera_name)
    place_camera(camera, camera.position, quaternion(orientation))


add_readings(
    vehicle_call,
    {
        "simGetGroundTruthKinematics": lambda api: kinematics(api, api.vehicle.sim.odometry),
        "simGetVehiclePose": lambda api: pose(*api.vehicle.in_ned(api.vehicle.sim.odometry)[:2]),
        "simGetCollisionInfo": collision,
        "getHomeGeoPoint": lambda _: geo_point((0.0, 0.0, 0.0)),
        # names before AirSim 1.3
        "getPosition": lambda api: vector(api.vehicle.position),
        "getVelocity": lambda api: vector(api.vehicle.velocity),
        "getOrientation": lambda api: rotated(api.vehicle.orientation),
        "getCollisionInfo": collision,
    },
)
