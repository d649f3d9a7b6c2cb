"""Perception: depth image -> point cloud -> map update -> collision status (MAVFI section III-A)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mavfi.kernels.perception import collision_check, octomap
from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.kernels.planning.trajectory import POINT_WIDTH
from mavfi.numerics.rotations import rotation_matrix
from mavfi.numerics.voxels import voxel_of
from mavfi.pipeline.clearance_map import ClearanceMap
from mavfi.pipeline.kernel import PipelineConfig, map_grid
from mavfi.pipeline.maps import make_map
from mavfi.pipeline.memory import Memory, Remembers, zeros
from mavfi.states import Stage, State, floats, new_state, rows

_UNKNOWN_HORIZON = 15.0
"""Distance along the trajectory within which unknown space is looked for (m)."""


@dataclass(slots=True)
class _CloudMemory(Memory):
    depth: State


class PointCloud(Remembers):
    """Kernel `point_cloud`: depth image -> points in the world frame."""

    name = "point_cloud"
    stage = Stage.PERCEPTION
    reads = ("sensor.depth",)
    writes = ("perception.point_cloud",)
    memory: _CloudMemory

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self.memory = _CloudMemory(new_state("sensor.depth"))

    def receive(self, state: State, time_us: int) -> bool:
        """A depth image makes a step due."""
        self.memory.depth = state
        return True

    def step(self, time_us: int) -> list[State]:
        """Back-project the stored image; returns the point cloud."""
        config = self._config
        depth = self.memory.depth
        pose = floats(depth.header, 7)
        ranges = np.ascontiguousarray(depth.elements["range"])
        count = min(len(ranges), len(config.directions))
        cloud = new_state("perception.point_cloud", count)
        points = cloud.elements.view(np.float32).reshape(count, 3)
        rotation = np.zeros((3, 3))
        rotation_matrix(pose[3:7], rotation)
        config.functions.back_project(
            ranges[:count], config.directions, rotation, pose[:3], config.camera.range, points
        )
        floats(cloud.header, 3)[:] = pose[:3]
        return [cloud]

    def mark(self) -> None:
        """No operation: the input is the only memory."""

    def rollback(self) -> None:
        """No operation: inputs are kept."""


@dataclass(slots=True)
class _MapMemory(Memory):
    cloud: State
    scan: int = 0
    marked_scan: int = 0


class OctoMap(Remembers):
    """Kernel `octomap`, on a dense array, an octree or a user's map, depending on the configuration.

    Attributes:
        grid: Geometry of the map.
        frame: The grid in OctoMap's keys.
        map: Occupancy of the voxels.
    """

    name = "octomap"
    stage = Stage.PERCEPTION
    reads = ("perception.point_cloud",)
    writes = ("perception.map_update",)
    memory: _MapMemory

    def __init__(self, config: PipelineConfig) -> None:
        self.grid = grid = map_grid(config)
        rule = config.map
        # half a voxel: OctoMap's voxel borders are multiples of the resolution, those of this grid lie in between
        half = 0.5 * rule.resolution
        kx, ky, kz = (round((corner + half) / rule.resolution) for corner in (grid.x0, grid.y0, grid.z0))
        self.frame = KeyFrame(rule.resolution, half, half, half, kx, ky, kz, grid.nx, grid.ny, grid.nz)
        update_rule = octomap.UpdateRule(
            *(octomap.log_odds(p) for p in (rule.hit, rule.miss, rule.clamp_min, rule.clamp_max))
        )
        self.map = make_map(
            rule.kind,
            self.frame,
            update_rule,
            config.camera.range,
            config.functions,
            rewindable=config.rewindable,
        )
        self.keepers = (self.map,)
        self.scratch = getattr(self.map, "scratch", None)
        self.memory = _MapMemory(new_state("perception.point_cloud"))

    def receive(self, state: State, time_us: int) -> bool:
        """A point cloud makes a step due."""
        self.memory.cloud = state
        return True

    def step(self, time_us: int) -> list[State]:
        """Integrate the stored cloud; returns the map update."""
        memory = self.memory
        memory.scan += 1
        points = memory.cloud.elements.view(np.float32).reshape(-1, 3)
        voxels, log_odds = self.map.insert(points, floats(memory.cloud.header, 3))
        update = new_state("perception.map_update", len(voxels))
        update.header["scan"] = memory.scan
        update.elements["voxel"] = voxels
        update.elements["log_odds"] = log_odds
        return [update]

    def mark(self) -> None:
        """Save the map and the scan number for `rollback`."""
        self.map.mark()
        self.memory.marked_scan = self.memory.scan

    def rollback(self) -> None:
        """Undo the scan since the last mark."""
        self.map.rollback()
        self.memory.scan = self.memory.marked_scan


@dataclass(slots=True)
class _CheckMemory(Memory):
    """Current inputs, inputs of the last step, and recomputation flags.

    Attributes:
        trajectories: The last two trajectories, by sequence number.
        waypoint: The way-point in force.
        position: Vehicle position (m). Shape (3,).
        remaining: Remaining time of the way-point in force, from the tracker (s).
        published: The last published status, which carries the collision counter.
        escaping: Sequence number of a trajectory that starts too close to an obstacle; -1 = none.
        used: Inputs of the last step, except the map.
        stepped: Whether a step was executed since the mark.
        rolled_back: Whether that step was rolled back.
        again: Whether the next step repeats it.
    """

    published: State
    trajectories: dict[int, State] = field(default_factory=dict)
    waypoint: State | None = None
    position: np.ndarray = zeros(3)
    remaining: float = 0.0
    escaping: int = -1
    used: "_Inputs | None" = None
    stepped: bool = False
    rolled_back: bool = False
    again: bool = False


_Inputs = tuple[State | None, int, int, np.ndarray, float]
"""Trajectory in force, index of its current point, its collision sequence number, position, remaining time."""


class CollisionCheck(Remembers):
    """Kernel `collision_check`: alarms with sequence numbers, or a check of every map.

    An alarm is one-shot, or repeated with the same number at each scan until the way-point in force answers it.

    The collision counter resides in the last published status, as in the published code, which keeps and republishes
    the message: counting continues from the value as received, corrupted or not.
    """

    name = "collision_check"
    stage = Stage.PERCEPTION
    writes = ("perception.collision_status",)
    quiet = ("planning.waypoint", "sensor.odometry", "perception.collision_status", "control.tracking")
    memory: _CheckMemory

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self.reads = (
            "perception.map_update",
            "planning.trajectory",
            "planning.waypoint",
            config.odometry,
            "perception.collision_status",
            "control.tracking",
        )
        self._every_map = config.autopilot.replanning == "every_map"
        # at most the planner's clearance, or a path along a wall would always encounter the unknown space inside it
        self._reach = max(1, math.ceil(config.plan_radius / config.map.resolution))
        self.clearance_map = ClearanceMap(config, config.functions.apply_updates)
        self.keepers = (self.clearance_map,)
        self.memory = _CheckMemory(new_state("perception.collision_status"))

    def receive(self, state: State, time_us: int) -> bool:
        """A map update makes a step due; with a check of every map, so does a new trajectory."""
        name = state.spec.name
        memory = self.memory
        if name == "perception.map_update":
            self.clearance_map.apply(state)
            memory.again = memory.rolled_back
            return True
        if name == self._config.odometry:
            memory.position = floats(state.header, 3).copy()
        elif name == "planning.waypoint":
            memory.waypoint = state
        elif name == "control.tracking":
            memory.remaining = state.value("remaining")
        elif name == "perception.collision_status":
            memory.published = state
        else:
            return self._take_trajectory(state)
        return False

    def _take_trajectory(self, state: State) -> bool:
        """Store a trajectory to be checked; returns whether it is checked at once."""
        if self._every_map and len(state.elements) == 0:
            return False  # planning failed: the current trajectory remains in force
        # a new trajectory takes effect some periods after its publication: its predecessor is still needed
        number = state.value("trajectory_seq")
        trajectories = self.memory.trajectories
        trajectories[number] = state
        while len(trajectories) > 2:
            del trajectories[next(iter(trajectories))]
        if len(state.elements) == 0:
            return False
        if self._too_close(rows(state.elements, 3)[0]):
            self.memory.escaping = number
        return self._every_map

    def _too_close(self, point: np.ndarray) -> bool:
        """Whether a point is within the checker's radius of an obstacle."""
        voxel = voxel_of(self.clearance_map.grid, point[0], point[1], point[2])
        return voxel >= 0 and bool(self.clearance_map.narrow[voxel] > 0)

    def _in_force(self) -> tuple[State | None, int, int]:
        """Trajectory in force, index of its current point, and its collision sequence number."""
        waypoint = self.memory.waypoint
        trajectories = self.memory.trajectories
        if self._every_map and trajectories:
            newest = next(reversed(trajectories))
            if waypoint is None or waypoint.value("trajectory_seq") != newest:
                return trajectories[newest], 0, trajectories[newest].value("future_collision_seq")
        if waypoint is None:
            return None, -1, 0
        number, index, alarm_seq = map(waypoint.value, ("trajectory_seq", "index", "future_collision_seq"))
        return trajectories.get(number), index, alarm_seq

    def step(self, time_us: int) -> list[State]:
        """Check the remaining trajectory in force on the current map."""
        memory = self.memory
        config = self._config
        clearance = self.clearance_map
        memory.stepped = True
        seq = memory.published.value("future_collision_seq")
        status = new_state("perception.collision_status")
        status.header[0] = (collision_check.NO_COLLISION, np.inf, np.inf, seq, -1, False)

        # The inputs; a recomputation uses those of the original step.
        if memory.again:
            memory.again = False
            memory.rolled_back = False
        else:
            memory.used = (*self._in_force(), memory.position, memory.remaining)
        assert memory.used is not None  # `again` requires an earlier step
        trajectory, index, alarm_seq, position, remaining = memory.used

        # Without a trajectory there is nothing to check, nor after a single alarm that is not yet answered.
        if trajectory is None or index < 0 or index >= len(trajectory.elements):
            return [status]
        unanswered = alarm_seq < seq and not self._every_map
        if unanswered and config.autopilot.alarm == "one_shot":
            return [status]

        # The check; with a check of every map also the distances that limit the speed of the reference.
        points = rows(trajectory.elements, POINT_WIDTH)
        time = config.functions.time_to_collision(
            clearance.narrow, clearance.grid, position, points, index, remaining, config.autopilot.geofence
        )
        header = status.header[0]
        if self._every_map:
            number = trajectory.value("trajectory_seq")
            blocked, unknown = config.functions.known_free_distance(
                clearance.narrow,
                clearance.cells,
                clearance.grid,
                points,
                index,
                _UNKNOWN_HORIZON,
                self._reach,
                self._still_escaping(number, points[index]),
            )
            header["trajectory_seq"] = number
            header["distance_to_blocked"] = blocked
            header["distance_to_unknown"] = unknown
            if blocked < np.inf:
                time = max(time, 0.0)
            else:
                time = -1.0

        # An alarm; the first one after an answer gets the next sequence number, which wraps around as an int32.
        if time >= 0.0:
            header["time_to_collision"] = time
            if unanswered:
                header["future_collision_seq"] = seq
            else:
                header["future_collision_seq"] = np.int32((seq + 1 + 2**31) % 2**32 - 2**31)
            header["collision"] = True
        return [status]

    def _still_escaping(self, number: int, point: np.ndarray) -> bool:
        """Whether the trajectory starts too close to an obstacle, and the reference has not left that zone yet."""
        if number != self.memory.escaping:
            return False
        if self._too_close(point):
            return True
        self.memory.escaping = -1
        return False

    def mark(self) -> None:
        """Save the map for `rollback`."""
        self.clearance_map.mark()
        self.memory.stepped = False

    def again(self) -> None:
        """Repeat the last step on the same map, which a step does not modify."""
        self.memory.again = self.memory.used is not None

    def rollback(self) -> None:
        """Undo the map updates since the last mark; a step since then is repeated on its original inputs."""
        self.clearance_map.rollback()
        self.memory.rolled_back = self.memory.stepped

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """Restore the collision counter from the last status."""
        status = last.get("perception.collision_status")
        if status is not None:
            self.receive(status, time_us)
        return ()
