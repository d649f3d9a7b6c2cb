"""Perception: depth image -> point cloud -> map update -> collision status (MAVFI section III-A)."""

import math

import numpy as np

from mavfi.kernels.perception import collision_check, octomap
from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.numerics.rotations import rotation_matrix
from mavfi.numerics.voxels import voxel_of
from mavfi.pipeline.kernel import PipelineConfig, map_grid
from mavfi.pipeline.maps import make_map
from mavfi.pipeline.room import Room
from mavfi.states import STATES, Stage, State, floats, new_state

_UNKNOWN_HORIZON = 15.0


class PointCloud:
    """Kernel `point_cloud`: depth image -> points in the world frame; it has no memory."""

    name = "point_cloud"
    stage = Stage.PERCEPTION
    reads = ("sensor.depth",)
    writes = ("perception.point_cloud",)
    not_memory = ("_config",)

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self._depth = new_state("sensor.depth")

    def receive(self, state: State, time_us: int) -> bool:
        """A depth image makes a step due."""
        del time_us
        self._depth = state
        return True

    def step(self, time_us: int) -> list[State]:
        """Back-project the image that `receive` took; returns the point cloud."""
        del time_us
        pose = floats(self._depth.header, 7)
        ranges = np.ascontiguousarray(self._depth.elements["range"])
        count = min(len(ranges), len(self._config.directions))
        cloud = new_state("perception.point_cloud", count)
        points = cloud.elements.view(np.float32).reshape(count, 3)
        rotation = np.empty((3, 3))
        rotation_matrix(pose[3:7], rotation)
        self._config.functions.back_project(
            ranges[:count], self._config.directions, rotation, pose[:3], self._config.camera.range, points
        )
        floats(cloud.header, 3)[:] = pose[:3]
        return [cloud]

    def mark(self) -> None:
        """Nothing to do: the kernel has no memory."""

    def rollback(self) -> None:
        """Nothing to do: the kernel has no memory."""


class OctoMap:
    """Kernel `octomap`, on a dense array, an octree or a map of the user's, as the configuration says.

    Attributes:
        grid: Geometry.
        frame: The grid among OctoMap's keys.
        map: Occupancy of the voxels.
    """

    name = "octomap"
    stage = Stage.PERCEPTION
    reads = ("perception.point_cloud",)
    writes = ("perception.map_update",)
    not_memory = ("grid", "frame")

    def __init__(self, config: PipelineConfig) -> None:
        self.grid = grid = map_grid(config)
        rule = config.map
        # half a voxel: OctoMap's voxel borders are multiples of the resolution, ours lie between them
        half = 0.5 * rule.resolution
        kx, ky, kz = (round((corner + half) / rule.resolution) for corner in (grid.x0, grid.y0, grid.z0))
        self.frame = KeyFrame(rule.resolution, half, half, half, kx, ky, kz, grid.nx, grid.ny, grid.nz)
        update_rule = octomap.UpdateRule(
            *(octomap.log_odds(p) for p in (rule.hit, rule.miss, rule.clamp_min, rule.clamp_max))
        )
        self.map = make_map(
            rule.kind, self.frame, update_rule, config.camera.range, config.functions, config.rewindable
        )
        self._scan = 0
        self._marked_scan = 0
        self._cloud = new_state("perception.point_cloud")

    def receive(self, state: State, time_us: int) -> bool:
        """A point cloud makes a step due."""
        del time_us
        self._cloud = state
        return True

    def step(self, time_us: int) -> list[State]:
        """Integrate the cloud that `receive` took; returns the map update."""
        del time_us
        self._scan += 1
        points = self._cloud.elements.view(np.float32).reshape(-1, 3)
        voxels, log_odds = self.map.insert(points, floats(self._cloud.header, 3))
        update = new_state("perception.map_update", len(voxels))
        update.header["scan"] = self._scan
        update.elements["voxel"] = voxels
        update.elements["log_odds"] = log_odds
        return [update]

    def mark(self) -> None:
        """Remember the map as it is, and the number of the scan."""
        self.map.mark()
        self._marked_scan = self._scan

    def rollback(self) -> None:
        """Take the scan since the last mark back."""
        self.map.rollback()
        self._scan = self._marked_scan


class CollisionCheck:
    """Kernel `collision_check`: one-shot alarm by sequence numbers, or a check of every map.

    The counter of collisions lives in the last published status, as in the published code, where the message is kept
    and sent again: counting continues from the received value, corrupted or not.
    """

    name = "collision_check"
    stage = Stage.PERCEPTION
    writes = ("perception.collision_status",)
    quiet = ("planning.waypoint", "sensor.odometry", "perception.collision_status", "control.tracking")
    not_memory = ("_config", "_every_map", "_reach")

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self.reads = (
            "perception.map_update", "planning.trajectory", "planning.waypoint", config.odometry,
            "perception.collision_status", "control.tracking",
        )  # fmt: skip
        self._every_map = config.stack.replanning == "every_map"
        # not beyond the planner's clearance, or a path along a wall would always see the unknown inside of the wall
        self._reach = max(1, math.ceil(config.plan_radius / config.map.resolution))
        self.room = Room(config, config.functions.apply_updates)
        self._trajectories: dict[int, State] = {}
        self._waypoint: State | None = None
        self._position = np.zeros(3)
        self._remaining = 0.0
        self._published = new_state("perception.collision_status")
        self._escaping_seq = -1
        self._used = self._inputs()
        self._stepped = False
        self._rolled_back = False
        self._again = False

    def receive(self, state: State, time_us: int) -> bool:
        """A map update makes a step due; where every map is checked, a new trajectory does too."""
        del time_us
        name = state.spec.name
        if name == "perception.map_update":
            self.room.apply(state)
            self._again = self._rolled_back
            return True
        if name == self._config.odometry:
            self._position = floats(state.header, 3)
        elif name == "planning.waypoint":
            self._waypoint = state
        elif name == "control.tracking":
            self._remaining = float(state.header["remaining"][0])
        elif name == "perception.collision_status":
            self._published = state
        else:
            return self._take_trajectory(state)
        return False

    def _take_trajectory(self, state: State) -> bool:
        if self._every_map and len(state.elements) == 0:
            return False  # no plan was found: the present trajectory stays in force
        # a new trajectory is in force some ticks after it was sent: the one before is still wanted
        self._trajectories[int(state.header["trajectory_seq"][0])] = state
        while len(self._trajectories) > 2:
            del self._trajectories[next(iter(self._trajectories))]
        if len(state.elements) == 0:
            return False
        points = floats(state.elements, 11).reshape(-1, 11)
        voxel = voxel_of(self.room.grid, points[0, 0], points[0, 1], points[0, 2])
        if voxel >= 0 and self.room.narrow[voxel] > 0:
            self._escaping_seq = int(state.header["trajectory_seq"][0])
        return self._every_map

    def _inputs(self) -> tuple[State | None, int, int, np.ndarray, float]:
        """Inputs of a step other than the map."""
        return (*self._in_force(), self._position, self._remaining)

    def _in_force(self) -> tuple[State | None, int, int]:
        """Trajectory in force, index of its point, and its sequence number."""
        if self._every_map and self._trajectories:
            newest = next(reversed(self._trajectories))
            if self._waypoint is None or int(self._waypoint.header["trajectory_seq"][0]) != newest:
                trajectory = self._trajectories[newest]
                return trajectory, 0, int(trajectory.header["future_collision_seq"][0])
        if self._waypoint is None:
            return None, -1, 0
        header = self._waypoint.header[0]
        return (
            self._trajectories.get(int(header["trajectory_seq"])), int(header["index"]),
            int(header["future_collision_seq"]),
        )  # fmt: skip

    def step(self, time_us: int) -> list[State]:
        """Check the rest of the trajectory in force on the present map."""
        del time_us
        self._stepped = True
        seq = int(self._published.header["future_collision_seq"][0])
        status = State(STATES[self.writes[0]], np.zeros(1, self._published.header.dtype), self._published.elements)
        status.header[0] = (collision_check.NO_COLLISION, np.inf, np.inf, seq, -1, False)
        if self._again:
            self._again = self._rolled_back = False  # a recomputation works on the inputs of the first time
        else:
            self._used = self._inputs()
        trajectory, index, epoch, position, remaining = self._used
        if trajectory is None or index < 0 or index >= len(trajectory.elements):
            return [status]
        if epoch < seq and not self._every_map:
            return [status]  # one-shot: the consumers have not answered the last alarm yet
        points = floats(trajectory.elements, 11).reshape(-1, 11)
        config = self._config
        time = config.functions.time_to_collision(
            self.room.narrow, self.room.grid, position, points, index, remaining, config.stack.geofence
        )
        header = status.header[0]
        if self._every_map:
            number = int(trajectory.header["trajectory_seq"][0])
            blocked, unknown = config.functions.known_free_distance(
                self.room.narrow, self.room.cells, self.room.grid, points, index, _UNKNOWN_HORIZON, self._reach,
                self._still_escaping(number, points[index]),
            )  # fmt: skip
            header["trajectory_seq"] = number
            header["distance_to_blocked"], header["distance_to_unknown"] = blocked, unknown
            time = max(time, 0.0) if blocked < np.inf else -1.0
        if time >= 0.0:
            header["time_to_collision"] = time
            header["future_collision_seq"] = np.int32((seq + 1 + 2**31) % 2**32 - 2**31)
            header["collision"] = True
        return [status]

    def _still_escaping(self, number: int, point: np.ndarray) -> bool:
        """Whether the trajectory started too near to an obstacle and the reference has not left that zone yet."""
        if number != self._escaping_seq:
            return False
        voxel = voxel_of(self.room.grid, point[0], point[1], point[2])
        if voxel >= 0 and self.room.narrow[voxel] > 0:
            return True
        self._escaping_seq = -1
        return False

    def mark(self) -> None:
        """Remember the map as it is."""
        self.room.mark()
        self._stepped = False

    def rollback(self) -> None:
        """Take the map updates since the last mark back; a step since then is repeated with the inputs that it had."""
        self.room.rollback()
        self._rolled_back = self._stepped
