"""Calls about cameras: pictures, poses, lenses, and the objects of wanted names that a camera sees.

Cameras are pinholes, so that of lens, film and focus only the field of view changes a picture.
"""

import math
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import product
from typing import Any

import numpy as np

from mavfi.config import CameraConfig
from mavfi.errors import BadInputError, not_known
from mavfi.extras.airsim.frames import (
    Data,
    Quaternion,
    flipped,
    from_pose,
    from_quaternionr,
    looking,
    merged_pose,
    mount,
    to_geo_point,
    to_pose,
    to_quaternionr,
    to_vector3r,
    turned,
)
from mavfi.extras.airsim.settings import MAX_FIELD_OF_VIEW, MIN_FIELD_OF_VIEW
from mavfi.extras.airsim.table import (
    FILM_MM,
    GROUND,
    Api,
    ApiCamera,
    DetectionFilter,
    call,
    camera_call,
    vehicle_call,
)
from mavfi.extras.shared.frames import Triple
from mavfi.numerics.elementary import atan2, exp, tan
from mavfi.numerics.rotations import rotation_matrix

# ---- images, computed from ranges: depth, a shaded picture, segmentation; as floats, bytes or PNG --------------------
SCENE = 0
PLANAR = 1
PERSPECTIVE = 2
VISUAL = 3
DISPARITY = 4
SEGMENTATION = 5
INFRARED = 7
_KINDS = (SCENE, PLANAR, PERSPECTIVE, VISUAL, DISPARITY, SEGMENTATION, INFRARED)
DEPTH = (PLANAR, PERSPECTIVE, VISUAL, DISPARITY)
_WHITE_M = 100.0
"""Distance shown in white in a depth picture (m)."""
_BASELINE_M = 0.25
"""Between the two cameras of a disparity (m)."""
_SURFACE_M = 0.01
"""Tolerance of points on the surface of a box (m)."""
FOG = 7
DUST = 6
"""AirSim's numbers of the weather parameters that are drawn."""
_THICKNESS = 0.1
"""Extinction of fog with parameter 1 (1/m)."""


@dataclass(frozen=True, slots=True)
class CameraView:
    """What a camera sees.

    Attributes:
        ranges: Along the rays (m), infinity = sky. Shape (height * width,), float32.
        rays: Unit vectors, camera frame, x forward. Shape (height * width, 3).
        width: Pixels.
        height: Pixels.
        pose: Of the camera in the world: position (m), quaternion w x y z. Shape (7,).
    """

    ranges: np.ndarray
    rays: np.ndarray
    width: int
    height: int
    pose: list[float]

    def planar(self) -> np.ndarray:
        """Distance of each pixel from the image plane (m). Shape (height * width,), float32."""
        return self.ranges * self.rays[:, 0].astype(np.float32)

    def points(self) -> np.ndarray:
        """Points in the world (m), infinite for the sky. Shape (height * width, 3)."""
        matrix = np.empty((3, 3))
        rotation_matrix(np.array(self.pose[3:]), matrix)
        points: np.ndarray = np.array(self.pose[:3]) + (self.rays @ matrix.T) * self.ranges[:, None]
        return points


def check_kind(kind: int) -> None:
    """Raise a `BadInputError` for a kind of image that is not drawn."""
    if kind not in _KINDS:
        raise BadInputError(f"image type {kind}: not drawn; allowed: {', '.join(map(str, _KINDS))}")


def floats(view: CameraView, kind: int, sky: float) -> list[float]:
    """An image of numbers: depth (m), or the disparity."""
    check_kind(kind)
    if kind not in (PLANAR, PERSPECTIVE, DISPARITY):
        raise BadInputError(f"image type {kind} as floats: not drawn; allowed: {PLANAR}, {PERSPECTIVE}, {DISPARITY}")
    depth = view.planar()
    if kind == PERSPECTIVE:
        depth = view.ranges
    if kind == DISPARITY:
        depth = np.where(np.isfinite(depth), np.float32(_BASELINE_M) / np.maximum(depth, np.float32(1e-3)), 0.0)
    values: list[float] = np.where(np.isfinite(depth), depth, np.float32(sky)).tolist()
    return values


def encoded(api: Api, view: CameraView, kind: int, compress: bool = True) -> bytes:
    """A picture as PNG, or as bytes R G B."""
    check_kind(kind)
    picture = _picture(api, view, kind)
    if compress:
        return png(picture)
    return picture.tobytes()


def _picture(api: Api, view: CameraView, kind: int) -> np.ndarray:
    """Shape (height, width, 3), uint8."""
    if kind in (SEGMENTATION, INFRARED):
        return _segments(api, view, kind)
    planar: np.ndarray = np.where(np.isfinite(view.ranges), view.planar(), _WHITE_M).reshape(view.height, view.width)
    if kind == SCENE:
        grey = _shaded(api, planar)
    elif kind == DISPARITY:
        grey = 255.0 * np.minimum(1.0, _BASELINE_M / np.maximum(planar, 1e-3))
    else:
        grey = 255.0 / _WHITE_M * planar
    return np.repeat(np.clip(grey, 0.0, 255.0).astype(np.uint8)[:, :, None], 3, axis=2)


def _shaded(api: Api, planar: np.ndarray) -> np.ndarray:
    """Brightness by nearness and slope, veiled by fog and dust. Shape (height, width)."""
    slope = np.abs(np.gradient(planar, axis=1)) + np.abs(np.gradient(planar, axis=0))
    grey: np.ndarray = 230.0 - 1.6 * planar - 40.0 * np.clip(slope, 0.0, 2.0)
    haze = 0.0
    if api.scene.weather_on:
        haze = sum(api.scene.weather.get(kind, 0.0) for kind in (FOG, DUST))
    # share of the light that passes; `exp` of this project has the same bits on every machine
    clear = np.array([exp(value) for value in (-_THICKNESS * haze * planar).ravel().tolist()]).reshape(planar.shape)
    veiled: np.ndarray = clear * grey + (1.0 - clear) * 200.0
    return veiled


def owners(api: Api, view: CameraView) -> np.ndarray:
    """What each pixel shows, by its place among `ApiScene.things`; -1 = ground, -2 = sky. Shape (pixels,)."""
    points = view.points()
    owner = np.where(np.isfinite(view.ranges), -1, -2)
    for index, (lower, upper) in enumerate(_boxes(api)):
        owner[((points >= lower - _SURFACE_M) & (points <= upper + _SURFACE_M)).all(axis=1)] = index
    return owner


def _boxes(api: Api) -> list[tuple[np.ndarray, np.ndarray]]:
    """Lower and upper corners of all things (m), in the order of `ApiScene.things`; nothing for the vehicle itself."""
    world = api.vehicle.sim.world
    boxes = list(zip(world.lower, world.upper, strict=True))
    for other in api.scene.vehicles.values():
        centre = other.vehicle.sim.odometry[:3]
        radius = other.vehicle.radius
        if other is api:
            radius = -math.inf
        boxes.append((centre - radius, centre + radius))
    return boxes


def _segments(api: Api, view: CameraView, kind: int) -> np.ndarray:
    """Colours by segmentation id: 0 = sky, 1 = ground, then the boxes. Shape (height, width, 3), uint8."""
    segments = [*map(api.scene.segment, api.scene.things), 0, api.scene.segment(GROUND)]
    ids = np.array(segments, np.int64)[owners(api, view)]
    if kind == INFRARED:
        return np.repeat(ids.astype(np.uint8).reshape(view.height, view.width, 1), 3, axis=2)
    colours: np.ndarray = _colours()[ids % 256]
    return colours.reshape(view.height, view.width, 3)


def _colours() -> np.ndarray:
    """A colour for each id; 0 is black. Shape (256, 3), uint8."""
    number = np.arange(256)
    return np.stack([(number * 97) % 256, (number * 57) % 256, (number * 181) % 256], axis=1).astype(np.uint8)


def png(picture: np.ndarray) -> bytes:
    """An 8-bit RGB picture as a PNG file. Shape (height, width, 3)."""
    height, width, channels = picture.shape
    rows = picture.reshape(height, width * channels)
    data = np.concatenate([np.zeros((height, 1), np.uint8), rows], axis=1).tobytes()

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(data, 1)) + chunk(b"IEND", b"")


# ---- cameras ---------------------------------------------------------------------------------------------------------
CAMERA_RANGE = 100.0
"""Beyond it a depth image shows the sky (m)."""
SKY = 65504.0
"""Depth of the sky, the largest float16, as in AirSim."""
_FACING = {
    "front_center": (0, 0),
    "front_right": (0, 0),
    "front_left": (0, 0),
    "bottom_center": (0, -90),
    "back_center": (180, 0),
}
_NUMBERS = dict(zip("01234", _FACING, strict=True))
_CAMERAS = {**_FACING, "fpv": (0, 0)}
"""AirSim's cameras: turned to the right and up (deg); all of them sit at the centre of the vehicle."""
LENS = "Pinhole"
FILM = "16:9 Digital Film"
"""The only presets: Unreal's default film."""


def find_camera(api: Api, name: Any) -> ApiCamera:  # noqa: ANN401 - a client's
    """A camera by name or number.

    Raises:
        BadInputError: There is none.
    """
    configured = api.settings.cameras
    camera_name = str(name)
    if camera_name not in configured:
        camera_name = _NUMBERS.get(camera_name, camera_name)
    if camera_name not in {**_CAMERAS, **configured}:
        names = dict.fromkeys([*_NUMBERS, *_CAMERAS, *configured])
        raise BadInputError(f"camera {not_known(name, names)}; more by --settings with the program's settings.json")
    if camera_name not in api.cameras:
        api.cameras[camera_name] = _new_camera(api, camera_name)
    return api.cameras[camera_name]


def _new_camera(api: Api, name: str) -> ApiCamera:
    """A camera as the settings define it, or AirSim."""
    scene = api.scene
    orientation = looking(*_CAMERAS.get(name, (0, 0)))
    settings = api.settings.cameras.get(name)
    if settings is None:
        return ApiCamera((0.0, 0.0, 0.0), orientation, dict(scene.settings.captures), scene.default_capture)
    if settings.orientation is not None:
        orientation = settings.orientation
    return ApiCamera(settings.position, orientation, dict(settings.captures), scene.default_capture)


def view(api: Api, name: Any, kind: int) -> CameraView:  # noqa: ANN401 - a client's
    """What a camera sees now; images of a kind with depth are those of a depth camera, which can fail."""
    camera = find_camera(api, name)
    width, height, fov_deg = camera.capture(kind)
    config = CameraConfig(width=width, height=height, field_of_view=math.radians(fov_deg), range=CAMERA_RANGE)
    camera_mount = mount(camera.position, camera.orientation)
    ranges, rays = api.vehicle.sim.ranges(config, camera_mount)
    ranges = api.with_others(ranges, rays, CAMERA_RANGE, camera_mount)
    if kind in DEPTH:
        ranges = api.vehicle.failures.ranges(api.vehicle.now_us, ranges, f"{name} {width}x{height}")
    return CameraView(ranges, rays, width, height, api.vehicle.sim.sensor_pose(camera_mount))


def _camera_pose(api: Api, name: Any) -> tuple[Any, Any]:
    camera = find_camera(api, name)
    at = api.vehicle.sim.sensor_pose(mount(camera.position, camera.orientation))
    return api.vehicle.to_ned(np.array(at[:3])), (at[3], at[4], -at[5], -at[6])


@call
def simGetImage(
    api: Api, camera_name: str, image_type: int, vehicle_name: str = "", annotation_name: Any = ""
) -> bytes:
    return encoded(api, view(api, camera_name, image_type), image_type)


@camera_call
def simGetImages(api: Api, requests: Any) -> list[Data]:
    return [_response(api, request) for request in requests]


def _response(api: Api, request: Any) -> Data:
    """ImageResponse to an ImageRequest."""
    # what is requested
    try:
        name = request["camera_name"]
        kind = int(request["image_type"])
        as_float = bool(request["pixels_as_float"])
        compress = bool(request["compress"])
    except (KeyError, TypeError, ValueError):
        raise BadInputError(f"{request!r}: allowed: an ImageRequest") from None

    # the image, as numbers or as bytes: the other one stays empty
    camera_view = view(api, name, kind)
    data = b""
    numbers: list[float] = []
    if as_float:
        numbers = floats(camera_view, kind, SKY)
    else:
        data = encoded(api, camera_view, kind, compress)
    position, orientation = _camera_pose(api, name)
    return {
        "image_data_uint8": data,
        "image_data_float": numbers,
        "camera_position": to_vector3r(position),
        "camera_name": str(name),
        "camera_orientation": to_quaternionr(orientation),
        "time_stamp": api.vehicle.stamp,
        "message": "",
        "pixels_as_float": as_float,
        "compress": compress,
        "width": camera_view.width,
        "height": camera_view.height,
        "image_type": kind,
        "annotation_name": "",
    }


@camera_call
def simGetCameraInfo(api: Api, camera_name: str) -> Data:
    width, height, fov = find_camera(api, camera_name).capture()
    x = 1.0 / tan(math.radians(0.5 * fov))
    matrix = [[x, 0.0, 0.0, 0.0], [0.0, x * width / height, 0.0, 0.0], [0.0, 0.0, 0.0, 10.0], [0.0, 0.0, 1.0, 0.0]]
    return {"pose": to_pose(*_camera_pose(api, camera_name)), "fov": fov, "proj_mat": {"matrix": matrix}}


@camera_call
def simSetCameraPose(api: Api, camera_name: str, pose: Any) -> None:
    """What is NaN stays as it is."""
    camera = find_camera(api, camera_name)
    place_camera(camera, *merged_pose(from_pose(pose), (camera.position, camera.orientation)))


def place_camera(camera: ApiCamera, position: Triple, orientation: Quaternion) -> None:
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


@camera_call
def simSetCameraFov(api: Api, camera_name: str, fov_degrees: float) -> None:
    if not MIN_FIELD_OF_VIEW <= fov_degrees <= MAX_FIELD_OF_VIEW:
        raise BadInputError(
            f"simSetCameraFov: {fov_degrees}: allowed: {MIN_FIELD_OF_VIEW:g} to {MAX_FIELD_OF_VIEW:g} deg"
        )
    find_camera(api, camera_name).set_fov(float(fov_degrees))


@vehicle_call
def simSetCameraOrientation(api: Api, camera_name: str, orientation: Any) -> None:
    camera = find_camera(api, camera_name)
    place_camera(camera, camera.position, from_quaternionr(orientation))


# ---- lens, film and focus --------------------------------------------------------------------------------------------
def focal_length(camera: ApiCamera) -> float:
    """Focal length (mm) of the field of view on the film."""
    return 0.5 * camera.film_mm[0] / tan(math.radians(0.5 * camera.fov_deg))


def _set_optics(name: str, camera: ApiCamera, film: tuple[float, float], focal: float) -> None:
    """Set film and focal length (mm), which make the field of view.

    Raises:
        BadInputError: The field of view would be too narrow or too wide, or a length is not positive.
    """
    if not (0.0 < focal < math.inf and all(0.0 < side < math.inf for side in film)):
        raise BadInputError(f"{name}: film of {film} mm, focal length {focal} mm: allowed: finite numbers above 0")
    fov = math.degrees(2.0 * atan2(0.5 * film[0], focal))
    if not MIN_FIELD_OF_VIEW <= fov <= MAX_FIELD_OF_VIEW:
        raise BadInputError(
            f"{name}: a field of view of {fov:.4g} deg: allowed: {MIN_FIELD_OF_VIEW:g} to {MAX_FIELD_OF_VIEW:g} deg"
        )
    camera.film_mm = film
    camera.set_fov(fov)


def _preset(name: str, preset: str, only: str) -> None:
    if preset != only:
        raise BadInputError(f"{name}: {preset!r}: allowed: {only!r}")


# ---- readings --------------------------------------------------------------------------------------------------------
def _film(width: float, height: float) -> str:
    return (
        f"Name: {FILM};\n\t Sensor Width: {width:g}; \t Sensor Height: {height:g}"
        f"\n\t Sensor Aspect Ratio: {width / height:g}"
    )


def _field_of_view(camera: ApiCamera) -> str:
    vertical = math.degrees(2.0 * atan2(0.5 * camera.film_mm[1], focal_length(camera)))
    return (
        f"Current Field Of View:\n\tHorizontal Field Of View: {camera.fov_deg:g};"
        f"\n\t Vertical Field Of View: {vertical:g}"
    )


_READINGS: dict[str, Callable[[ApiCamera], Any]] = {
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


def _add_reading(name: str, read: Callable[[ApiCamera], Any]) -> None:
    def get(api: Api, camera_name: str) -> Any:
        return read(find_camera(api, camera_name))

    camera_call(get, name)


for _name, _read in _READINGS.items():
    _add_reading(_name, _read)


# ---- settings --------------------------------------------------------------------------------------------------------
@camera_call
def simSetPresetLensSettings(api: Api, preset_lens_settings: str, camera_name: str) -> None:
    find_camera(api, camera_name)
    _preset("simSetPresetLensSettings", preset_lens_settings, LENS)


@camera_call
def simSetFocalLength(api: Api, focal_length: float, camera_name: str) -> None:
    camera = find_camera(api, camera_name)
    _set_optics("simSetFocalLength", camera, camera.film_mm, focal_length)


@camera_call
def simSetPresetFilmbackSettings(api: Api, preset_filmback_settings: str, camera_name: str) -> None:
    camera = find_camera(api, camera_name)
    _preset("simSetPresetFilmbackSettings", preset_filmback_settings, FILM)
    _set_optics("simSetPresetFilmbackSettings", camera, FILM_MM, focal_length(camera))


@camera_call
def simSetFilmbackSettings(api: Api, sensor_width: float, sensor_height: float, camera_name: str) -> float:
    """Sides of the film (mm); the focal length stays.  Returns their ratio."""
    camera = find_camera(api, camera_name)
    _set_optics("simSetFilmbackSettings", camera, (sensor_width, sensor_height), focal_length(camera))
    return sensor_width / sensor_height


def _enable(api: Api, enable: bool, camera_name: str) -> None:
    find_camera(api, camera_name)


for _name in ("simEnableManualFocus", "simEnableFocusPlane"):
    camera_call(_enable, _name)


@camera_call
def simSetFocusDistance(api: Api, value: float, camera_name: str) -> None:
    find_camera(api, camera_name).focus_distance = float(value)


@camera_call
def simSetFocusAperture(api: Api, value: float, camera_name: str) -> None:
    find_camera(api, camera_name).aperture = float(value)


# ---- detections ------------------------------------------------------------------------------------------------------
def _detection_filter(api: Api, camera_name: str, kind: int) -> DetectionFilter:
    """What is detected in a camera's pictures of a kind.

    Raises:
        BadInputError: There is no such camera, or its pictures of this kind are not drawn.
    """
    find_camera(api, camera_name)
    check_kind(kind)
    return api.detected.setdefault((str(camera_name), int(kind)), DetectionFilter())


@camera_call
def simSetDetectionFilterRadius(api: Api, camera_name: str, image_type: int, radius_cm: float) -> None:
    if not radius_cm >= 0.0:
        raise BadInputError(f"simSetDetectionFilterRadius: {radius_cm}: allowed: 0 or more (cm)")
    _detection_filter(api, camera_name, image_type).radius = 0.01 * radius_cm


@camera_call
def simAddDetectionFilterMeshName(api: Api, camera_name: str, image_type: int, mesh_name: str) -> None:
    _detection_filter(api, camera_name, image_type).names.append(str(mesh_name))


@camera_call
def simClearDetectionMeshNames(api: Api, camera_name: str, image_type: int) -> None:
    _detection_filter(api, camera_name, image_type).names.clear()


@camera_call
def simGetDetections(api: Api, camera_name: str, image_type: int) -> list[Data]:
    """DetectionInfo of each object with a wanted name, within the radius, of which a pixel is seen."""
    detection_filter = _detection_filter(api, camera_name, image_type)
    camera_view = view(api, camera_name, image_type)
    owner = owners(api, camera_view).reshape(camera_view.height, camera_view.width)
    detections = []
    for index, (name, box) in enumerate(zip(api.scene.things, _boxes(api), strict=True)):
        rows, columns = np.nonzero(owner == index)
        if not len(rows):
            continue
        centre = 0.5 * (box[0] + box[1])
        is_near = np.linalg.norm(centre - camera_view.pose[:3]) <= detection_filter.radius
        if is_near and any(fnmatchcase(name, pattern) for pattern in detection_filter.names):
            detections.append(_detection(api, camera_view, name, box, rows, columns))
    return detections


def _detection(
    api: Api, view: CameraView, name: str, box: tuple[np.ndarray, np.ndarray], rows: np.ndarray, columns: np.ndarray
) -> Data:
    """DetectionInfo of a box, lower and upper corner in the world (m), that is seen in these pixels."""
    matrix = np.empty((3, 3))
    rotation_matrix(np.array(view.pose[3:]), matrix)
    camera = np.array(view.pose[:3])
    centre = 0.5 * (box[0] + box[1])
    # the eight corners in the camera's frame
    corners_in_world = [np.array(corner) for corner in product(*zip(*box, strict=True))]
    corners = np.array([flipped((corner - camera) @ matrix) for corner in corners_in_world])
    w, x, y, z = view.pose[3:]
    return {
        "name": name,
        "geo_point": to_geo_point(api.scene.to_ned(centre)),
        "box2D": {"min": _pixel(columns.min(), rows.min()), "max": _pixel(columns.max(), rows.max())},
        "box3D": {"min": to_vector3r(corners.min(axis=0)), "max": to_vector3r(corners.max(axis=0))},
        "relative_pose": to_pose(flipped((centre - camera) @ matrix), turned((w, -x, -y, -z))),
    }


def _pixel(column: int, row: int) -> dict[str, float]:
    """Vector2r."""
    return {"x_val": float(column), "y_val": float(row)}
