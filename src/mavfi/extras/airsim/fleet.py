"""Vehicles that fly together: their places at the start, collisions between them, and that they see one another."""

import math
from collections.abc import Sequence

import numpy as np

from mavfi.extras.airsim.frames import flipped
from mavfi.extras.airsim.grounded import Contact
from mavfi.extras.airsim.piloted import PilotedVehicle
from mavfi.extras.shared.frames import Triple
from mavfi.numerics.rotations import rotation_matrix
from mavfi.numerics.vectors import product

VEHICLES = -100
"""`Contact.obstacle` of the first vehicle; those of the next ones are smaller by one each."""
_RESTITUTION = 0.3
"""Speed after a collision of two vehicles, as a share of that before: both bounce a little."""
_SEPARATION_S = 0.1
"""Time in which vehicles that overlap part (s)."""


def free_place(home: Triple, radius: float, others: Sequence[PilotedVehicle]) -> Triple:
    """The place for a new vehicle: as requested, or the next free one to the east, in steps of 1 m.

    Args:
        home: The requested place, see `PilotedVehicle`.
        radius: Of the vehicle (m).
        others: The vehicles that are there.
    """
    north, east, down = home
    standing = [np.array(flipped(other.sim.odometry[:3] - other.origin)) + other.home for other in others]
    while any(
        math.dist((north, east, 0.0), place) < radius + other.radius
        for place, other in zip(standing, others, strict=True)
    ):
        east += 1.0
    return north, east, down


def collide(vehicles: Sequence[PilotedVehicle]) -> None:
    """Let vehicles that touch bounce, and note the contact for both.

    A vehicle at rest on the ground is not moved.  Rotation is not changed.
    """
    for index, first in enumerate(vehicles):
        for later, second in enumerate(vehicles[index + 1 :], index + 1):
            way = first.sim.odometry[:3] - second.sim.odometry[:3]
            distance = math.sqrt(float(np.square(way).sum()))
            depth = first.radius + second.radius - distance
            if depth <= 0.0:
                continue

            # Normal from the second to the first, and the point of contact.
            normal = np.array([0.0, 0.0, 1.0])
            if distance > 0.0:
                normal = way / distance
            point = second.sim.odometry[:3] + normal * (second.radius - 0.5 * depth)

            # they part at a share of the speed at which they met, and at least so fast that they soon do not overlap
            closing = -float(((first.sim.odometry[3:6] - second.sim.odometry[3:6]) * normal).sum())
            change = max(0.0, closing + max(_RESTITUTION * closing, depth / _SEPARATION_S))
            movable = [not vehicle.sim.resting for vehicle in (first, second)]
            share = change / max(1, sum(movable))
            for vehicle, other, side, moves in ((first, later, 1.0, movable[0]), (second, index, -1.0, movable[1])):
                position = vehicle.sim.odometry[:3].copy()
                contact = Contact(vehicle.sim.time_us, position, point, side * normal, depth, VEHICLES - other)
                vehicle.sim.bump(contact, side * share * float(moves) * normal)


def nearer(
    ranges: np.ndarray, directions: np.ndarray, limit: float, pose: Sequence[float], others: Sequence[PilotedVehicle]
) -> np.ndarray:
    """Ranges along rays, with other vehicles in their way.

    Args:
        ranges: Without them (m). Shape (n,), float32.
        directions: Unit vectors in the sensor's frame. Shape (n, 3).
        limit: Range (m).
        pose: Of the sensor in the world: position (m) and quaternion w x y z. Shape (7,).
        others: The vehicles, seen as the spheres that touch others.
    """
    if not others:
        return ranges
    matrix = np.empty((3, 3))
    rotation_matrix(np.array(pose[3:]), matrix)
    rays = product(directions, matrix.T)
    for other in others:
        # a point at range t is on the sphere where t^2 - 2 t (ray . centre) + centre^2 = radius^2
        centre = other.sim.odometry[:3] - np.array(pose[:3])
        along = product(rays, centre[:, None])[:, 0]
        root = np.square(along) - float(np.square(centre).sum()) + other.radius**2
        entry = along - np.sqrt(np.maximum(root, 0.0))
        is_hit = (root >= 0.0) & (entry > 0.0) & (entry <= limit)
        ranges = np.where(is_hit, np.minimum(ranges, entry.astype(np.float32)), ranges)
    return ranges
