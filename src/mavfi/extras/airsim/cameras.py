"""Calls about cameras: pictures, poses, lenses, and the objects of wanted names that a camera sees.

Cameras are pinholes, so that of lens, film and focus only the field of view changes a picture.
"""

import math
from collections.abc import Callable
from fnmatch import fnmatchcase
from itertools import product
from typing import Any

import numpy as np

from mavfi.config import CameraConfig
from mavfi.errors import BadInputError
from mavfi.extras.airsim import pictures
from mavfi.extras.airsim.frames import Data, geo_point, looking, mount, pose, pose_numbers, quaternion, vector
from mavfi.extras.airsim.frames import rotation as rotated
from mavfi.extras.airsim.table import (
    FILM_MM,
    NARROWEST,
    WIDEST,
    Api,
    Camera,
    Wanted,
    call,
    camera_call,
    vehicle_call,
)
from mavfi.numerics.elementary import atan2, tan
from mavfi.numerics.frames import Triple, flipped, turned
from mavfi.numerics.rotations import rotation_matrix

CAMERA_RANGE = 100.0
"""Beyond it a depth image shows the sky (m)."""
SKY = 65504.0
"""Depth of the sky, the largest float16, as in AirSim."""
_FACING = {"front_center": (0, 0), "front_right": (0, 0), "front_left": (0, 0), "bottom_center": (0, -90),
           "back_center": (180, 0)}  # fmt: skip
_NUMBERS = dict(zip("01234", _FACING, strict=True))
_CAMERAS = {**_FACING, "fpv": (0, 0)}
"""AirSim's cameras: turned to the right and up (deg); all of them sit at the centre of the vehicle."""
LENS, FILM = "Pinhole", "16:9 Digital Film"
"""The only presets: Unreal's default film."""


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


# ---- lens, film and focus --------------------------------------------------------------------------------------------
def focal_length(camera: Camera) -> float:
    """Focal length (mm) of the field of view on the film."""
    return 0.5 * camera.film_mm[0] / tan(math.radians(0.5 * camera.fov_deg))


def _set_optics(name: str, camera: Camera, film: tuple[float, float], focal: float) -> None:
    """Set film and focal length (mm), which make the field of view.

    Raises:
        BadInputError: The field of view would be too narrow or too wide, or a length is not positive.
    """
    if not (0.0 < focal < math.inf and all(0.0 < side < math.inf for side in film)):
        raise BadInputError(f"{name}: film of {film} mm, focal length {focal} mm: allowed: finite numbers above 0")
    fov = math.degrees(2.0 * atan2(0.5 * film[0], focal))
    if not NARROWEST <= fov <= WIDEST:
        raise BadInputError(f"{name}: a field of view of {fov:.4g} deg: allowed: {NARROWEST:g} to {WIDEST:g} deg")
    camera.film_mm, camera.fov_deg = film, fov


def _preset(name: str, given: str, only: str) -> None:
    if given != only:
        raise BadInputError(f"{name}: {given!r}: allowed: {only!r}")


# ---- readings --------------------------------------------------------------------------------------------------------
def _film(width: float, height: float) -> str:
    return (
        f"Name: {FILM};\n\t Sensor Width: {width:g}; \t Sensor Height: {height:g}"
        f"\n\t Sensor Aspect Ratio: {width / height:g}"
    )


def _field_of_view(camera: Camera) -> str:
    vertical = math.degrees(2.0 * atan2(0.5 * camera.film_mm[1], focal_length(camera)))
    return (
        f"Current Field Of View:\n\tHorizontal Field Of View: {camera.fov_deg:g};"
        f"\n\t Vertical Field Of View: {vertical:g}"
    )


_READINGS: dict[str, Callable[[Camera], Any]] = {
    "simGetPresetLensSettings": lambda _: [f"Name: {LENS}"],
    "simGetLensSettings": lambda _: f"Name: {LENS}",
    "simGetFocalLength": focal_length,
    "simGetPresetFilmbackSettings": lambda _: [_film(*FILM_MM)],
    "simGetFilmbackSettings": lambda camera: _film(*camera.film_mm),
    "simGetCurrentFieldOfView": _field_of_view,
    "simGetDistortionParams": lambda _: [0.0] * 5,
    "simGetFocusDistance": lambda camera: camera.focus_distance,
    "simGetFocusAperture": lambda camera: camera.aperture,
}
"""What calls return of a camera; pictures are sharp and without distortion."""


def _add_reading(name: str, read: Callable[[Camera], Any]) -> None:
    def get(api: Api, camera_name: str) -> Any:
        return read(find_camera(api, camera_name))

    camera_call(name)(get)


for _name, _read in _READINGS.items():
    _add_reading(_name, _read)


# ---- settings --------------------------------------------------------------------------------------------------------
@camera_call("simSetPresetLensSettings")
def _(api: Api, preset_lens_settings: str, camera_name: str) -> None:
    find_camera(api, camera_name)
    _preset("simSetPresetLensSettings", preset_lens_settings, LENS)


@camera_call("simSetFocalLength")
def _(api: Api, focal_length: float, camera_name: str) -> None:
    camera = find_camera(api, camera_name)
    _set_optics("simSetFocalLength", camera, camera.film_mm, focal_length)


@camera_call("simSetPresetFilmbackSettings")
def _(api: Api, preset_filmback_settings: str, camera_name: str) -> None:
    camera = find_camera(api, camera_name)
    _preset("simSetPresetFilmbackSettings", preset_filmback_settings, FILM)
    _set_optics("simSetPresetFilmbackSettings", camera, FILM_MM, focal_length(camera))


@camera_call("simSetFilmbackSettings")
def _(api: Api, sensor_width: float, sensor_height: float, camera_name: str) -> float:
    """Sides of the film (mm); the focal length stays.  Returns their ratio."""
    camera = find_camera(api, camera_name)
    _set_optics("simSetFilmbackSettings", camera, (sensor_width, sensor_height), focal_length(camera))
    return sensor_width / sensor_height


def _enable(api: Api, enable: bool, camera_name: str) -> None:
    find_camera(api, camera_name)


for _name in ("simEnableManualFocus", "simEnableFocusPlane"):
    camera_call(_name)(_enable)


@camera_call("simSetFocusDistance")
def _(api: Api, value: float, camera_name: str) -> None:
    find_camera(api, camera_name).focus_distance = float(value)


@camera_call("simSetFocusAperture")
def _(api: Api, value: float, camera_name: str) -> None:
    find_camera(api, camera_name).aperture = float(value)


# ---- detections ------------------------------------------------------------------------------------------------------
def _wanted(api: Api, camera_name: str, kind: int) -> Wanted:
    """What is detected in a camera's pictures of a kind.

    Raises:
        BadInputError: There is no such camera, or its pictures of this kind are not drawn.
    """
    find_camera(api, camera_name)
    pictures.check_kind(kind)
    return api.detected.setdefault((str(camera_name), int(kind)), Wanted())


@camera_call("simSetDetectionFilterRadius")
def _(api: Api, camera_name: str, image_type: int, radius_cm: float) -> None:
    if not radius_cm >= 0.0:
        raise BadInputError(f"simSetDetectionFilterRadius: {radius_cm}: allowed: 0 or more (cm)")
    _wanted(api, camera_name, image_type).radius = 0.01 * radius_cm


@camera_call("simAddDetectionFilterMeshName")
def _(api: Api, camera_name: str, image_type: int, mesh_name: str) -> None:
    _wanted(api, camera_name, image_type).names.append(str(mesh_name))


@camera_call("simClearDetectionMeshNames")
def _(api: Api, camera_name: str, image_type: int) -> None:
    _wanted(api, camera_name, image_type).names.clear()


@camera_call("simGetDetections")
def _(api: Api, camera_name: str, image_type: int) -> list[Data]:
    """DetectionInfo of each object with a wanted name, within the radius, of which a pixel is seen."""
    wanted = _wanted(api, camera_name, image_type)
    seen = view(api, camera_name, image_type)
    owner, world = pictures.owners(api, seen).reshape(seen.height, seen.width), api.vehicle.sim.world
    found = []
    for place, name in enumerate(api.objects):
        centre = 0.5 * (world.lower[place] + world.upper[place])
        near = np.linalg.norm(centre - seen.pose[:3]) <= wanted.radius
        if near and any(fnmatchcase(name, pattern) for pattern in wanted.names):
            rows, columns = np.nonzero(owner == place)
            if len(rows):
                found.append(_detection(api, seen, name, (world.lower[place], world.upper[place]), rows, columns))
    return found


def _detection(
    api: Api, seen: pictures.View, name: str, box: tuple[np.ndarray, np.ndarray], rows: np.ndarray, columns: np.ndarray
) -> Data:
    """DetectionInfo of a box, lower and upper corner in the world (m), that is seen in these pixels."""
    matrix = np.empty((3, 3))
    rotation_matrix(np.array(seen.pose[3:]), matrix)
    camera, centre = np.array(seen.pose[:3]), 0.5 * (box[0] + box[1])
    corners = np.array([flipped((np.array(corner) - camera) @ matrix) for corner in product(*zip(*box, strict=True))])
    w, x, y, z = seen.pose[3:]
    return {
        "name": name, "geo_point": geo_point(api.vehicle.to_ned(centre)),
        "box2D": {"min": _pixel(columns.min(), rows.min()), "max": _pixel(columns.max(), rows.max())},
        "box3D": {"min": vector(corners.min(axis=0)), "max": vector(corners.max(axis=0))},
        "relative_pose": pose(flipped((centre - camera) @ matrix), turned((w, -x, -y, -z))),
    }  # fmt: skip


def _pixel(column: int, row: int) -> dict[str, float]:
    """Vector2r."""
    return {"x_val": float(column), "y_val": float(row)}
