"""Calls about lens, film and focus of cameras: pinholes, so that only the field of view changes a picture."""

import math
from collections.abc import Callable
from typing import Any

from mavfi.bridges.airsim.sensing import find_camera
from mavfi.bridges.airsim.table import FILM_MM, NARROWEST, WIDEST, Api, Camera, camera_call
from mavfi.errors import BadInputError
from mavfi.numerics.elementary import atan2, tan

LENS, FILM = "Pinhole", "16:9 Digital Film"
"""The only presets: Unreal's default film."""


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
