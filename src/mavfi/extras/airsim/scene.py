"""Calls about the program's connection, time, the scene, drawing and weather."""

import json
import math
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from mavfi.config import names
from mavfi.errors import BadInputError, not_known
from mavfi.extras.airsim.cameras import DUST, FOG
from mavfi.extras.airsim.frames import (
    LEVEL,
    Data,
    flipped,
    from_geo_point,
    from_pose,
    from_vector3r,
    merged_pose,
    to_geo_point,
    to_pose,
    to_vector3r,
)
from mavfi.extras.airsim.piloted import TICK_US
from mavfi.extras.airsim.settings import VehicleSettings
from mavfi.extras.airsim.table import CALLS, DESTROYED, GROUND, Api, add_readings, call, vehicle_call
from mavfi.extras.shared.frames import Triple
from mavfi.mission import Scenario
from mavfi.numerics.rotations import yaw_of
from mavfi.sim.environments.world import World
from mavfi.sim.scene import STEP_US

_DRAWN = {FOG: "Fog", DUST: "Dust", 8: "Enabled"}
_KNOWN_WEATHER = {0: "Rain", 1: "Roadwetness", 2: "Snow", 3: "RoadSnow", 4: "MapleLeaf", 5: "RoadLeaf", **_DRAWN}
_NO_WINDOW = "there is no window to draw into"
WITHOUT_EFFECT = {
    **dict.fromkeys(
        (
            "simFlushPersistentMarkers",
            "simPlotPoints",
            "simPlotLineStrip",
            "simPlotLineList",
            "simPlotArrows",
            "simPlotStrings",
            "simPlotTransforms",
            "simPlotTransformsWithNames",
            "simSetTraceLine",
            "simPrintLogMessage",
        ),
        _NO_WINDOW,
    ),
    "simSetTimeOfDay": "no sun lights the pictures",
    **dict.fromkeys(("simEnableManualFocus", "simEnableFocusPlane"), "all distances are in focus"),
}
"""Calls that are accepted and do nothing, with the reason: programs that make them fly as they would without."""


add_readings(
    call,
    {
        "ping": lambda _: True,
        "getServerVersion": lambda api: api.scene.version,
        "getMinRequiredClientVersion": lambda api: api.scene.version,
        "listVehicles": lambda api: list(api.scene.vehicles),
        "simIsPaused": lambda api: api.scene.paused,
        "simListAssets": lambda _: ["Cube"],
        "isRecording": lambda api: api.scene.recording,
    },
)


# ---- connection ------------------------------------------------------------------------------------------------------
@call
def getSettingsString(api: Api) -> str:
    """AirSim's settings, and under a key of its own what the server flies."""
    vehicles: Data = {name: {} for name in api.scene.vehicles}
    report = identity(api.vehicle.scenario, api.vehicle.sim.world, in_flight=not api.vehicle.on_ground)
    defaults = {"SettingsVersion": 1.2, "SimMode": "Multirotor", "ClockSpeed": 1.0, "Vehicles": vehicles}
    settings = {**defaults, **api.scene.settings.content, KEY: report}
    return json.dumps(settings)


@call
def simPrintLogMessage(api: Api, message: Any, message_param: Any = "", severity: int = 0) -> bool:
    return True


@call
def simAddVehicle(api: Api, vehicle_name: str, vehicle_type: str, pose: Any, pawn_path: str = "") -> bool:
    """A vehicle on the ground below the pose, whose position is the origin of its NED."""
    if str(vehicle_type).lower() != "simpleflight":
        raise BadInputError(f"simAddVehicle: {vehicle_type!r}: allowed: SimpleFlight")
    if pawn_path:
        raise BadInputError(f"simAddVehicle: pawn_path: {pawn_path!r}: allowed: none, as vehicles have no pictures")
    if not vehicle_name or vehicle_name in api.scene.vehicles:
        raise BadInputError(f"simAddVehicle: {vehicle_name!r}: allowed: a name that no vehicle has")
    if not api.vehicle.on_ground:
        raise BadInputError("simAddVehicle: the mission's vehicle starts in the air; allowed: without --in-flight")
    position, orientation = merged_pose(from_pose(pose), ((0.0, 0.0, 0.0), LEVEL))
    yaw_deg = math.degrees(float(yaw_of(np.array(orientation))))
    try:
        api.scene.add(api.vehicle.spec, VehicleSettings(vehicle_name, position, yaw_deg))
    except BadInputError as error:
        raise BadInputError(f"simAddVehicle: {vehicle_name}: {error}") from None
    return True


# ---- time ------------------------------------------------------------------------------------------------------------
@call
def simPause(api: Api, is_paused: bool) -> None:
    api.scene.paused = bool(is_paused)
    api.scene.resume_until_us = None


def continue_for(api: Api, seconds: float) -> None:
    """Plan a pause after this time; the clock lets the time pass.

    Raises:
        BadInputError: Not a time.
    """
    if not 0.0 <= seconds <= 1e6:
        raise BadInputError(f"simContinueForTime: {seconds}: allowed: 0 to 1e6 s")
    api.scene.paused = False
    api.scene.resume_until_us = api.scene.now_us + round(seconds * 1e6 / STEP_US) * STEP_US


@call
def simContinueForTime(api: Api, seconds: float) -> None:
    continue_for(api, seconds)


@call
def simContinueForFrames(api: Api, frames: int) -> None:
    continue_for(api, 1e-6 * TICK_US * frames)


# ---- objects ---------------------------------------------------------------------------------------------------------
def _index_of(api: Api, name: str) -> int:
    if name not in api.scene.objects:
        raise BadInputError(f"object {name!r}: not known; allowed: names of simListSceneObjects")
    return api.scene.objects.index(name)


def _box(api: Api, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Centre and size of an object (m), in the world. Shapes (3,)."""
    world = api.vehicle.sim.world
    index = _index_of(api, name)
    return 0.5 * (world.lower[index] + world.upper[index]), world.upper[index] - world.lower[index]


def _set_box(api: Api, index: int | None, centre: np.ndarray, size: np.ndarray) -> None:
    """Set one box; None = add it."""
    world = api.vehicle.sim.world
    if world.is_voxels:
        raise BadInputError("objects: the environment is a scan, whose voxels are fixed; allowed: in worlds of boxes")
    if not (np.isfinite(centre).all() and np.isfinite(size).all() and (size > 0.0).all()):
        raise BadInputError(f"object of size {size.tolist()}: allowed: finite numbers, a size above 0")
    lower = world.lower.copy()
    upper = world.upper.copy()
    if index is None:
        lower = np.vstack([lower, centre - 0.5 * size])
        upper = np.vstack([upper, centre + 0.5 * size])
    else:
        lower[index] = centre - 0.5 * size
        upper[index] = centre + 0.5 * size
    _set_boxes(api, lower, upper)


def _set_boxes(api: Api, lower: np.ndarray, upper: np.ndarray) -> None:
    """Replace the obstacles, for all vehicles."""
    for other in api.scene.vehicles.values():
        other.vehicle.sim.set_boxes(lower, upper)


def _box_position(pose: Any) -> Triple:  # noqa: ANN401 - a client's
    """Position of an object's pose; boxes are aligned with the axes."""
    position, (_, *axis) = from_pose(pose)
    if any(axis):
        raise BadInputError(f"{pose!r}: boxes stay aligned with the axes; allowed: the orientation (1, 0, 0, 0)")
    return position


def _matching(names: Iterable[str], pattern: str) -> list[str]:
    try:
        return [name for name in names if re.fullmatch(pattern, name)]
    except re.error as error:
        raise BadInputError(f"{pattern!r}: {error}; allowed: a regular expression") from None


@call
def simListSceneObjects(api: Api, name_regex: str = ".*", tags: Any = None) -> list[str]:
    return _matching((*api.scene.vehicles, *api.scene.objects), name_regex)


@call
def simGetObjectPose(api: Api, object_name: str, ned: bool = True) -> Data:
    """NaN for an object that does not exist, as in AirSim."""
    if not ned:
        raise BadInputError("simGetObjectPose: ned: False: allowed: True, as there are no coordinates of Unreal here")
    if object_name in api.scene.vehicles:
        other = api.scene.vehicles[object_name]
        return to_pose(other.in_scene(other.vehicle.position), other.vehicle.orientation)
    if object_name not in api.scene.objects:
        return to_pose((math.nan,) * 3, (math.nan,) * 4)
    return to_pose(api.scene.to_ned(_box(api, object_name)[0]), LEVEL)


@call
def simSetObjectPose(api: Api, object_name: str, pose: Any, teleport: bool = True) -> bool:
    centre = api.scene.to_world(_box_position(pose))
    _set_box(api, _index_of(api, object_name), centre, _box(api, object_name)[1])
    return True


@call
def simGetObjectScale(api: Api, object_name: str) -> dict[str, float]:
    return to_vector3r(_box(api, object_name)[1])


@call
def simSetObjectScale(api: Api, object_name: str, scale_vector: Any) -> bool:
    centre, _ = _box(api, object_name)
    _set_box(api, _index_of(api, object_name), centre, np.array(from_vector3r(scale_vector)))
    return True


@call
def simSpawnObject(
    api: Api,
    object_name: str,
    asset_name: str,
    pose: Any,
    scale: Any,
    physics_enabled: bool = False,
    is_blueprint: bool = False,
) -> str:
    """A box, as large as AirSim's cube (1 m) times the scale; returns its name, made unique."""
    if physics_enabled:
        raise BadInputError("simSpawnObject: obstacles do not move; allowed: physics_enabled=False")
    name = str(object_name)
    tries = 0
    while name in api.scene.objects:
        tries += 1
        name = f"{object_name}_{tries}"
    _set_box(api, None, api.scene.to_world(_box_position(pose)), np.array(from_vector3r(scale)))
    api.scene.objects.append(name)
    return name


@call
def simDestroyObject(api: Api, object_name: str) -> bool:
    if object_name not in api.scene.objects:
        return False
    index = _index_of(api, object_name)
    world = api.vehicle.sim.world
    _set_boxes(api, np.delete(world.lower, index, axis=0), np.delete(world.upper, index, axis=0))
    del api.scene.objects[index]

    # the last contact names its obstacle by number: the later ones have moved up
    for other in api.scene.vehicles.values():
        sim = other.vehicle.sim
        if sim.touched is not None and sim.touched.obstacle == index:
            sim.touched = replace(sim.touched, obstacle=DESTROYED)
        elif sim.touched is not None and sim.touched.obstacle > index:
            sim.touched = replace(sim.touched, obstacle=sim.touched.obstacle - 1)
    return True


@call
def simSetSegmentationObjectID(api: Api, mesh_name: str, object_id: int, is_name_regex: bool = False) -> bool:
    pattern = re.escape(mesh_name)
    if is_name_regex:
        pattern = mesh_name
    matching = _matching((*api.scene.things, GROUND), pattern)
    api.scene.segments.update(dict.fromkeys(matching, int(object_id)))
    return bool(matching)


@call
def simGetSegmentationObjectID(api: Api, mesh_name: str) -> int:
    if mesh_name in (*api.scene.things, GROUND):
        return api.scene.segment(mesh_name)
    return -1


@call
def simLoadLevel(api: Api, level_name: str) -> bool:
    """Fly in another shipped environment, with the same seed."""
    if level_name not in names("environments"):
        raise BadInputError(f"level {not_known(level_name, names('environments'))}")
    for other in api.scene.vehicles.values():
        other.vehicle.load(other.vehicle.spec.model_copy(update={"environment": level_name}))
    api.scene.name_objects()
    return True


@call
def simGetWorldExtents(api: Api) -> list[dict[str, float]]:
    world = api.vehicle.sim.world
    return [to_geo_point(api.scene.to_ned(corner)) for corner in (world.arena_lower, world.arena_upper)]


@vehicle_call
def simTestLineOfSightToPoint(api: Api, point: Any) -> bool:
    return api.vehicle.sim.is_free(api.vehicle.sim.odometry[:3].copy(), _in_world(api, point))


@call
def simTestLineOfSightBetweenPoints(api: Api, point1: Any, point2: Any) -> bool:
    return api.vehicle.sim.is_free(_in_world(api, point1), _in_world(api, point2))


def _in_world(api: Api, point: Any) -> np.ndarray:
    return api.scene.to_world(from_geo_point(point))


# ---- weather, drawing, recording -------------------------------------------------------------------------------------
@call
def simSetWind(api: Api, wind: Any) -> None:
    api.scene.wind = from_vector3r(wind)
    for other in api.scene.vehicles.values():
        other.vehicle.sim.set_wind(flipped(api.scene.wind))


@call
def simEnableWeather(api: Api, enable: bool) -> None:
    api.scene.weather_on = bool(enable)


@call
def simSetWeatherParameter(api: Api, param: int, val: float) -> None:
    """A value of 0 is accepted for all weather: there is none."""
    if param not in _DRAWN and not (param in _KNOWN_WEATHER and val == 0.0):
        weather = _KNOWN_WEATHER.get(param, "unknown")
        allowed = ", ".join(f"{number} ({name})" for number, name in _DRAWN.items())
        raise BadInputError(f"simSetWeatherParameter: {param} ({weather}): not drawn; allowed: {allowed}")
    api.scene.weather[param] = min(1.0, max(0.0, float(val)))


@call
def startRecording(api: Api) -> None:
    """Nothing is written; the program flies as if it were."""
    api.scene.recording = True


@call
def stopRecording(api: Api) -> None:
    api.scene.recording = False


def _nothing(api: Api, *arguments: Any) -> None:
    """Draw nothing."""


for _name in WITHOUT_EFFECT:
    if _name not in CALLS:
        call(_nothing, _name)


# ---- calls that are refused ------------------------------------------------------------------------------------------

_GAINS = "gains are those of the vehicle's file (--vehicle)"
_PAINT = "objects have no material, texture or light"
_STRAIGHT = "pictures have no distortion"
_SENSOR = "this sensor does not exist here"
_ONE_PLACE = "the sensor sits at the vehicle's centre"
_OF_COSYS = "annotations and instances are not drawn; simGetImages returns segmentation"

REFUSED = {
    "simSetExtForce": "external forces are not applied; wind is (simSetWind)",
    "simRunConsoleCommand": "there is no Unreal Engine here",
    "simCreateVoxelGrid": "no file is written",
    "simGetMeshPositionVertexBuffers": "obstacles have no mesh; simGetObjectPose and simGetObjectScale give the boxes",
    **dict.fromkeys(("setCarControls", "getCarState", "getCarControls"), "the vehicle is a multirotor"),
    "getComputerVisionState": "the vehicle is a multirotor",
    **dict.fromkeys(
        (
            "setVelocityControllerGains",
            "setPositionControllerGains",
            "setAngleLevelControllerGains",
            "setAngleRateControllerGains",
        ),
        _GAINS,
    ),
    **dict.fromkeys(
        (
            "simSetObjectMaterial",
            "simSetObjectMaterialFromTexture",
            "simSwapTextures",
            "simSetLightIntensity",
            "simSetVehicleLightIntensity",
            "simSetVehicleLightVisibility",
            "simSetWorldLightIntensity",
            "simSetWorldLightVisibility",
        ),
        _PAINT,
    ),
    **dict.fromkeys(("simSetDistortionParam", "simSetDistortionParams"), _STRAIGHT),
    **dict.fromkeys(
        ("getEchoData", "getGPULidarData", "getUWBData", "getUWBSensorData", "getWifiData", "getWifiSensorData"),
        _SENSOR,
    ),
    **dict.fromkeys(
        ("simSetDistanceSensorPose", "simSetLidarPose", "simSetGPULidarPose", "simSetEchoPose"), _ONE_PLACE
    ),
    **dict.fromkeys(
        (
            "simListAnnotationObjects",
            "simListAnnotationPoses",
            "simListInstanceSegmentationObjects",
            "simListInstanceSegmentationPoses",
            "simListSceneObjectsTags",
            "simGetAnnotationObjectID",
            "simSetAnnotationObjectID",
            "simGetAnnotationObjectColor",
            "simSetAnnotationObjectColor",
            "simGetAnnotationObjectValue",
            "simSetAnnotationObjectValue",
            "simGetAnnotationObjectTexturePath",
            "simSetAnnotationObjectTextureByPath",
            "simEnableAnnotationObjectTextureByPath",
        ),
        _OF_COSYS,
    ),
    **dict.fromkeys(
        ("simGetPhysicsRawKinematics", "simSetPhysicsRawKinematics"),
        "raw states are not exchanged; simGetGroundTruthKinematics and simSetKinematics are",
    ),
}
"""The reason by name of the call."""


def _refuse(name: str, reason: str) -> None:
    def refused(api: Api, *arguments: Any) -> None:
        raise BadInputError(f"{name}: {reason}")

    call(refused, name)


for _name, _reason in REFUSED.items():
    _refuse(_name, _reason)


# ---- identity of world and vehicle -----------------------------------------------------------------------------------

KEY = "Mavfi"
"""Key of the report in the settings that `getSettingsString` returns; AirSim's own settings have none."""


def identity(scenario: Scenario, world: World, *, in_flight: bool = True) -> dict[str, Any]:
    """What must be the same for a flight on a server to be the flight without one.

    Args:
        scenario: The mission.
        world: Its world.
        in_flight: Whether the vehicle starts in the air; one on the ground has a height and a speed limit of its own.

    Returns:
        Environment and vehicle by name, seed, wind (m/s, amplitude of gusts), start (x, y, m), goal (m), height of the
        start (m), speed limit (m/s).
    """
    content = {
        "environment": scenario.environment.name,
        "seed": scenario.seed,
        "vehicle": scenario.vehicle.name,
        "wind": scenario.wind.gust,
        "start": world.start[:2].tolist(),
        "goal": world.goal.tolist(),
    }
    if in_flight:
        return {**content, "height": float(world.start[2]), "v_max": scenario.v_max}
    return content


def reported(settings: Any) -> dict[str, Any]:  # noqa: ANN401 - a server's
    """The report in a server's settings (JSON); empty if there is none, as from AirSim itself."""
    try:
        report = json.loads(settings)[KEY]
    except (KeyError, TypeError, ValueError):
        return {}
    if isinstance(report, dict):
        return report
    return {}


def difference(there: dict[str, Any], here: dict[str, Any]) -> str:
    """In what a server's report differs from the flight's identity, in words; "" = in nothing."""
    keys = [key for key in here if key in there and there[key] != here[key]]
    if not keys:
        return ""
    theirs = ", ".join(f"{key} {_text(there[key])}" for key in keys)
    ours = ", ".join(f"{key} {_text(here[key])}" for key in keys)
    return f"it has {theirs}; this flight has {ours}"


def _text(value: Any) -> str:  # noqa: ANN401 - a server's
    """A name, a number, or a place."""
    if isinstance(value, list):
        return " ".join(map(_text, value))
    if isinstance(value, float):
        return f"{value:g}"
    return str(value)
