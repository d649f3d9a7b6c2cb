"""Point cloud by a pinhole camera: depth along the optical axis, to points in the camera frame, to the map frame.

ROS uses these steps (`depth_image_proc`, `tf`), so that a foreign node can replace this kernel.  The pipeline's own
kernel transforms ranges to the map frame directly in double precision; the results differ by rounding alone.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mavfi.config import CameraConfig
from mavfi.hosts.ros1.mirrors import cosines, focal_length
from mavfi.hosts.ros1.plan import Plan
from mavfi.kernels.perception.point_cloud import BEYOND_RANGE
from mavfi.pipeline.functions import PLAIN, KernelFunctions

Projection = Callable[[np.ndarray], np.ndarray]
"""Depth along the optical axis (m), shape (height, width), float32 -> points in frame `camera_optical` (m), shape
(height * width, 3), float32; NaN where the depth is not finite."""


def projection(camera: CameraConfig) -> Projection:
    """The computation of `depth_image_proc/point_cloud_xyz`, replicated operation by operation in single precision.

    Source: `depth_image_proc/depth_conversions.h`, version 1.17.
    """
    center = np.float32(0.5 * camera.width - 0.5), np.float32(0.5 * camera.height - 0.5)
    scale = np.float32(1.0 / focal_length(camera))
    across = np.arange(camera.width, dtype=np.float32) - center[0]
    down = (np.arange(camera.height, dtype=np.float32) - center[1])[:, None]

    def project(depth: np.ndarray) -> np.ndarray:
        points = np.stack([across * depth * scale, down * depth * scale, depth], axis=-1)
        points[~np.isfinite(depth)] = np.nan
        return points.reshape(-1, 3)

    return project


class Pinhole:
    """Replacement for the function `back_project` of the kernel `point_cloud`; `project` computes the points."""

    def __init__(self, camera: CameraConfig, project: Projection) -> None:
        self._shape = camera.height, camera.width
        self._cosines = cosines(camera)
        self._project = project

    def back_project(
        self, ranges: np.ndarray, directions: np.ndarray, rotation: np.ndarray, origin: np.ndarray, max_range: float,
        points: np.ndarray,
    ) -> None:  # fmt: skip
        """Depth image -> points in frame `map`; arguments: see `mavfi.kernels.perception.point_cloud.back_project`."""
        count = len(ranges)
        depth = np.full(self._cosines.size, np.nan, np.float32)
        depth[:count] = np.where(ranges > max_range, max_range * BEYOND_RANGE, ranges) * self._cosines[:count]
        found = self._project(depth.reshape(self._shape))[:count].astype(float)
        # from camera_optical (z forward, x right, y down) to the body frame (x forward, y left, z up)
        x, y, z = found[:, 2], -found[:, 0], -found[:, 1]
        for axis in range(3):
            points[:, axis] = origin[axis] + rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2] * z


def functions_of(plan: Plan) -> KernelFunctions:
    """Kernel functions with which an in-process flight has the same digest as this flight on ROS."""
    if not plan.foreign:
        return PLAIN
    camera = plan.scenario.camera
    return replace(PLAIN, back_project=Pinhole(camera, projection(camera)).back_project)
