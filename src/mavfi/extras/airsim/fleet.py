"""Vehicles that fly together: their places at the start, collisions between them, and that they see one another."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mavfi.flight.compose import resolve
from mavfi.flight.piloted import PilotedVehicle
from mavfi.mission import MissionSpec
from mavfi.numerics.elementary import cos, sin
from mavfi.numerics.frames import Triple, flipped, turned
from mavfi.numerics.rotations import rotation_matrix
from mavfi.numerics.vectors import product
from mavfi.sim.environments import build_world
from mavfi.sim.grounded import Contact

VEHICLES = -100
"""`Contact.obstacle` of the first vehicle; those of the next ones are smaller by one each."""
_RESTITUTION = 0.3
"""Speed after a collision of two vehicles, as a share of that before: both bounce a little."""
_SEPARATION_S = 0.1
"""Time in which vehicles that overlap part (s)."""


class FleetVehicle(PilotedVehicle):
    """A vehicle with a place of its own.

    Args:
        spec: The mission.
        home: Origin of its NED, in the scene's NED (m), whose origin is the mission's start; it stands on the ground
            there.
        yaw_deg: Heading at the start, clockwise from north (deg); None = towards the mission's goal.
        is_armed: Whether its motors run at the start.
        number: Among the vehicles, from 0; sensors of each have noise of their own.
        begin_us: Instant at which it appears (us).
        on_ground: See `PilotedVehicle`.

    Attributes:
        home: As above.
    """

    def __init__(
        self,
        spec: MissionSpec,
        *,
        home: Triple = (0.0, 0.0, 0.0),
        yaw_deg: float | None = None,
        is_armed: bool = True,
        number: int = 0,
        begin_us: int = 0,
        on_ground: bool = True,
    ) -> None:
        self.home = home
        self._yaw_deg = yaw_deg
        self._is_armed = is_armed
        self._vehicle_number = number
        super().__init__(spec, on_ground=on_ground)
        self._base_us = begin_us

    def load(self, spec: MissionSpec) -> None:
        """See `PilotedVehicle.load`."""
        scenario = resolve(spec)
        world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
        shift = np.array(flipped((*self.home[:2], 0.0)))
        world = replace(world, start=world.start + shift, goal=world.goal + shift)
        if self._vehicle_number:
            scenario = scenario.model_copy(update={"seed": scenario.seed + self._vehicle_number})
        self._start_in(world, scenario)
        self.spec = spec

    def _begin(self) -> None:
        """See `PilotedVehicle._begin`."""
        super()._begin()
        self.origin[2] -= self.home[2]
        if not self._is_armed:
            self.sim.arm(False)
        if self._yaw_deg is not None:
            half = 0.5 * math.radians(self._yaw_deg)
            self.sim.place(self.sim.odometry[:3].copy(), np.array(turned((cos(half), 0.0, 0.0, sin(half)))))

    @property
    def radius(self) -> float:
        """Radius of the sphere that touches others (m)."""
        return self.scenario.vehicle.collision_radius


def free_place(home: Triple, radius: float, others: Sequence[FleetVehicle]) -> Triple:
    """The place for a new vehicle: as requested, or the next free one to the east, in steps of 1 m.

    Args:
        home: The requested place, see `FleetVehicle`.
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


def collide(vehicles: Sequence[FleetVehicle]) -> None:
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

            # from the second to the first
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
    ranges: np.ndarray, directions: np.ndarray, limit: float, pose: Sequence[float], others: Sequence[FleetVehicle]
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
