"""Poses, shapes and mass properties of models."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from mavfi.numerics.elementary import cos, sin
from mavfi.numerics.vectors import length, product


class Pose(NamedTuple):
    """Position and orientation of a frame in another one.

    Attributes:
        matrix: Rotation to the other frame. Shape (3, 3).
        position: Origin, in the other frame (m). Shape (3,).
    """

    matrix: np.ndarray
    position: np.ndarray

    def apply(self, inner: "Pose") -> "Pose":
        """Pose of a frame whose pose in this one is `inner`."""
        return Pose(product(self.matrix, inner.matrix), self.point(inner.position))

    def point(self, local: np.ndarray) -> np.ndarray:
        """A point of this frame in the other one (m). Shape (3,)."""
        moved: np.ndarray = product(self.matrix, local[:, None])[:, 0] + self.position
        return moved

    def inverse(self) -> "Pose":
        """Pose of the other frame in this one."""
        back = self.matrix.T
        return Pose(back, -product(back, self.position[:, None])[:, 0])


IDENTITY = Pose(np.eye(3), np.zeros(3))


def matrix_of_rpy(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rotation about the fixed axes x, y, z, in this order, as in SDF and URDF (rad). Shape (3, 3)."""
    cr = cos(roll)
    sr = sin(roll)
    cp = cos(pitch)
    sp = sin(pitch)
    cy = cos(yaw)
    sy = sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def pose_of(values: Sequence[float]) -> Pose:
    """Pose from x y z (m) and roll pitch yaw (rad)."""
    return Pose(matrix_of_rpy(*values[3:6]), np.array(values[:3], float))


class MassProperties(NamedTuple):
    """Mass and inertia of a part or a whole.

    Attributes:
        mass: Mass (kg).
        centre: Centre of mass, in the axes of the model (m). Shape (3,).
        tensor: Inertia about the centre of mass, same axes (kg m^2). Shape (3, 3).
    """

    mass: float
    centre: np.ndarray
    tensor: np.ndarray


def lump(parts: Iterable[MassProperties]) -> MassProperties | None:
    """Mass properties of rigidly connected parts, by the parallel-axis theorem; None = they have no mass."""
    heavy = [part for part in parts if part.mass > 0.0]
    mass = math.fsum(part.mass for part in heavy)
    if not mass > 0.0:
        return None
    centre = np.zeros(3)
    for part in heavy:
        centre += part.mass / mass * part.centre
    tensor = np.zeros((3, 3))
    for part in heavy:
        arm = part.centre - centre
        tensor += part.tensor + part.mass * (float(np.square(arm).sum()) * np.eye(3) - np.outer(arm, arm))
    return MassProperties(mass, centre, tensor)


BOX, CYLINDER, SPHERE, CAPSULE, ELLIPSOID, PLANE, MESH = (
    "box", "cylinder", "sphere", "capsule", "ellipsoid", "plane", "mesh",
)  # fmt: skip


class Shape(NamedTuple):
    """A shape for contacts.

    Attributes:
        kind: One of the kinds above.
        size: Box: edges. Cylinder, capsule: radius, length along z (of a capsule without its caps). Sphere: radius.
            Ellipsoid: half axes. Plane, mesh: empty (m).
        pose: Of its centre, in the axes of the model; a plane's normal is z.
        owner: Names of model and link, for messages.
        vertices: Of a mesh that stands for its convex hull, in the axes of the shape (m), shape (n, 3); None = unknown.
    """

    kind: str
    size: tuple[float, ...]
    pose: Pose
    owner: str
    vertices: np.ndarray | None = None


def half_extents(shape: Shape) -> np.ndarray:
    """Half edges of the box, in the axes of the shape, that holds it (m); NaN for planes and meshes. Shape (3,)."""
    if shape.kind == BOX:
        return 0.5 * np.array(shape.size)
    if shape.kind == ELLIPSOID:
        return np.array(shape.size)
    if shape.kind == SPHERE:
        return np.full(3, shape.size[0])
    if shape.kind == CYLINDER:
        return np.array([shape.size[0], shape.size[0], 0.5 * shape.size[1]])
    if shape.kind == CAPSULE:
        return np.array([shape.size[0], shape.size[0], 0.5 * shape.size[1] + shape.size[0]])
    return np.full(3, np.nan)


def reach_of(shapes: Iterable[Shape], centre: np.ndarray) -> float:
    """Largest distance of the shapes from a point (m); planes and meshes do not count."""
    reach = 0.0
    for shape in shapes:
        reach = max(reach, _reach(shape, shape.pose.inverse().point(centre)))
    return reach


def _reach(shape: Shape, point: np.ndarray) -> float:
    """Largest distance of a shape from a point in its axes (m); of an ellipsoid that of its box."""
    if shape.kind == SPHERE:
        return length(point) + shape.size[0]
    if shape.kind == CYLINDER:
        from_axis = length(point[:2]) + shape.size[0]
        return math.hypot(from_axis, abs(point[2]) + 0.5 * shape.size[1])
    if shape.kind == CAPSULE:
        end = np.array([point[0], point[1], abs(point[2]) + 0.5 * shape.size[1]])
        return length(end) + shape.size[0]
    if shape.kind in (BOX, ELLIPSOID):
        return length(np.abs(point) + half_extents(shape))
    return 0.0
