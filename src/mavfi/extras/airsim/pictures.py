"""AirSim's image types, computed from ranges: depth, a shaded picture, segmentation; as floats, bytes or PNG."""

import struct
import zlib
from dataclasses import dataclass

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.airsim.table import GROUND, Api
from mavfi.numerics.elementary import exp
from mavfi.numerics.rotations import rotation_matrix

SCENE, PLANAR, PERSPECTIVE, VISUAL, DISPARITY, SEGMENTATION, INFRARED = 0, 1, 2, 3, 4, 5, 7
_KINDS = (SCENE, PLANAR, PERSPECTIVE, VISUAL, DISPARITY, SEGMENTATION, INFRARED)
DEPTH = (PLANAR, PERSPECTIVE, VISUAL, DISPARITY)
_WHITE_M = 100.0
"""Distance shown in white in a depth picture (m)."""
_BASELINE_M = 0.25
"""Between the two cameras of a disparity (m)."""
_SURFACE_M = 0.01
"""Tolerance of points on the surface of a box (m)."""
FOG, DUST = 7, 6
"""AirSim's numbers of the weather parameters that are drawn."""
_THICKNESS = 0.1
"""Extinction of fog with parameter 1 (1/m)."""


@dataclass(frozen=True, slots=True)
class View:
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
        found: np.ndarray = self.ranges * self.rays[:, 0].astype(np.float32)
        return found

    def points(self) -> np.ndarray:
        """Points in the world (m), infinite for the sky. Shape (height * width, 3)."""
        matrix = np.empty((3, 3))
        rotation_matrix(np.array(self.pose[3:]), matrix)
        found: np.ndarray = np.array(self.pose[:3]) + (self.rays @ matrix.T) * self.ranges[:, None]
        return found


def check_kind(kind: int) -> None:
    """Raise a `BadInputError` for a kind of image that is not drawn."""
    if kind not in _KINDS:
        raise BadInputError(f"image type {kind}: not drawn; allowed: {', '.join(map(str, _KINDS))}")


def floats(view: View, kind: int, sky: float) -> list[float]:
    """An image of numbers: depth (m), or the disparity."""
    check_kind(kind)
    if kind not in (PLANAR, PERSPECTIVE, DISPARITY):
        raise BadInputError(f"image type {kind} as floats: not drawn; allowed: {PLANAR}, {PERSPECTIVE}, {DISPARITY}")
    depth = view.ranges if kind == PERSPECTIVE else view.planar()
    if kind == DISPARITY:
        depth = np.where(np.isfinite(depth), np.float32(_BASELINE_M) / np.maximum(depth, np.float32(1e-3)), 0.0)
    found: list[float] = np.where(np.isfinite(depth), depth, np.float32(sky)).tolist()
    return found


def encoded(api: Api, view: View, kind: int, compress: bool = True) -> bytes:
    """A picture as PNG, or as bytes R G B."""
    check_kind(kind)
    picture = _picture(api, view, kind)
    return png(picture) if compress else picture.tobytes()


def _picture(api: Api, view: View, kind: int) -> np.ndarray:
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
    haze = sum(api.weather.get(kind, 0.0) for kind in (FOG, DUST)) if api.weather_on else 0.0
    clear = np.array([exp(value) for value in (-_THICKNESS * haze * planar).ravel().tolist()]).reshape(planar.shape)
    veiled: np.ndarray = clear * grey + (1.0 - clear) * 200.0
    return veiled


def owners(api: Api, view: View) -> np.ndarray:
    """The object that each pixel shows, by its place among `Api.objects`; -1 = ground, -2 = sky. Shape (pixels,)."""
    points, world = view.points(), api.vehicle.sim.world
    found = np.where(np.isfinite(view.ranges), -1, -2)
    for place in range(len(api.objects)):
        lower, upper = world.lower[place] - _SURFACE_M, world.upper[place] + _SURFACE_M
        found[((points >= lower) & (points <= upper)).all(axis=1)] = place
    return found


def _segments(api: Api, view: View, kind: int) -> np.ndarray:
    """Colours by segmentation id: 0 = sky, 1 = ground, then the boxes. Shape (height, width, 3), uint8."""
    segments = [*map(api.segment, api.objects), 0, api.segment(GROUND)]
    ids = np.array(segments, np.int64)[owners(api, view)]
    if kind == INFRARED:
        return np.repeat(ids.astype(np.uint8).reshape(view.height, view.width, 1), 3, axis=2)
    picture: np.ndarray = _colours()[ids % 256].reshape(view.height, view.width, 3)
    return picture


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
