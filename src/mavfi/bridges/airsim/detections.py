"""Calls that detect objects in pictures: those of the wanted names that a camera sees."""

from fnmatch import fnmatchcase
from itertools import product

import numpy as np

from mavfi.bridges.airsim.frames import Data, flipped, geo_point, pose, turned, vector
from mavfi.bridges.airsim.pictures import View, check_kind, owners
from mavfi.bridges.airsim.sensing import find_camera, view
from mavfi.bridges.airsim.table import Api, Wanted, camera_call
from mavfi.errors import BadInputError
from mavfi.numerics.rotations import rotation_matrix


def _wanted(api: Api, camera_name: str, kind: int) -> Wanted:
    """What is detected in a camera's pictures of a kind.

    Raises:
        BadInputError: There is no such camera, or its pictures of this kind are not drawn.
    """
    find_camera(api, camera_name)
    check_kind(kind)
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
    owner, world = owners(api, seen).reshape(seen.height, seen.width), api.vehicle.sim.world
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
    api: Api, seen: View, name: str, box: tuple[np.ndarray, np.ndarray], rows: np.ndarray, columns: np.ndarray
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
