"""Calls of AirSim's API before version 1.3, which later clients have under other names or not at all."""

from typing import Any

from mavfi.bridges.airsim.frames import quaternion, rotation, vector
from mavfi.bridges.airsim.sensing import collision, find_camera, place_camera
from mavfi.bridges.airsim.table import Api, call


@call("getPosition")
def _(api: Api, vehicle_name: str = "") -> dict[str, float]:
    return vector(api.vehicle.in_ned(api.vehicle.believed)[0])


@call("getVelocity")
def _(api: Api, vehicle_name: str = "") -> dict[str, float]:
    return vector(api.vehicle.in_ned(api.vehicle.believed)[2])


@call("getOrientation")
def _(api: Api, vehicle_name: str = "") -> dict[str, float]:
    return rotation(api.vehicle.in_ned(api.vehicle.believed)[1])


@call("getCollisionInfo")
def _(api: Api, vehicle_name: str = "") -> dict[str, Any]:
    return collision(api)


@call("simSetCameraOrientation")
def _(api: Api, camera_name: str, orientation: Any, vehicle_name: str = "") -> None:
    camera = find_camera(api, camera_name)
    place_camera(camera, camera.position, quaternion(orientation))
