"""The trajectory generator: path -> timed trajectory (MAVFI section III-A); for set-points see `waypoints`."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mavfi.kernels.planning import knots, minimum_snap, time_allocation
from mavfi.kernels.planning import path as paths
from mavfi.kernels.planning import trajectory as timing
from mavfi.kernels.planning import waypoint as setpoint
from mavfi.kernels.planning.trajectory import POINT_WIDTH
from mavfi.numerics.vectors import length
from mavfi.pipeline.clearance_map import ClearanceMap
from mavfi.pipeline.control import MAX_YAW_RATE
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.memory import Memory, Remembers
from mavfi.pipeline.planners import MOST_VERTICES
from mavfi.pipeline.routes import BLEND, LATERAL_SHARE, NOMINAL_SPEED, PLANNING_ACCELERATION, TIGHT_SPEED
from mavfi.states import Stage, State, floats, new_state, rows

BRAKING = 4.0
"""Maximum planned deceleration (m/s^2)."""
_STANDING = 0.3
"""Speed up to which the vehicle counts as standing (m/s)."""
_CLOSE_BLEND = 2.0
"""Maximum distance of a corner blend from its corner at the nominal speed, if the path is followed closely (m)."""
_CLOSE = 0.2
"""Innermost control point of a blend close to the corner."""
_ROUND = 1.0 / 3.0
"""Innermost control point of a blend of minimum curvature, and thus maximum speed."""
_LOOK = 3.0
"""Look-ahead distance of the yaw reference at the nominal speed (m)."""

_ACCELERATION_SHARE = 0.9
"""Maximum acceleration of a polynomial / a_max."""
_ENTRY_SHARE = 0.8
"""Maximum initial acceleration of a polynomial / its limit."""
_REACH_SHARE = 0.7
"""Reach of a polynomial at a corner / that of a blend with the same depth of cut."""
_KNOT_TIME = 0.5
"""Knot spacing on a straight leg / v_max (s)."""
_HELD_SPEED_SHARE = 0.97
"""Top speed / v_max where points are held: their tracking lags a little, and the vehicle must not fall behind."""
_VERTEX_SPACING = 0.7
"""Least distance of the vertices along the trajectory in force (m)."""
_JUNCTION_SPACING = 0.5
"""Least distance of the last of them from the junction (m)."""


@dataclass(frozen=True, slots=True)
class _Motion:
    """Initial motion of a trajectory; velocity None = along the path, yaw NaN = unknown."""

    speed: float
    velocity: np.ndarray | None = None
    acceleration: np.ndarray = field(default_factory=lambda: np.zeros(3))
    yaw: float = math.nan


@dataclass(slots=True)
class _GeneratorMemory(Memory):
    """The last path, way-point and trajectory, the trajectory's number, and that at the mark."""

    path: State
    waypoint: State | None = None
    flown: State | None = None
    seq: int = 0
    marked_seq: int = 0


class TrajectoryGenerator(Remembers):
    """Kernel `trajectory`: smooths and times a path.  It runs in the planner's node, on the same clearance map.

    Attributes:
        fallbacks: Number of paths without a feasible polynomial, for which corners were blended instead.
    """

    name = "trajectory"
    stage = Stage.PLANNING
    reads = ("planning.path", "planning.waypoint", "planning.trajectory")
    writes = ("planning.trajectory",)
    quiet = ("planning.waypoint", "planning.trajectory")
    memory: _GeneratorMemory

    def __init__(self, config: PipelineConfig, clearance: ClearanceMap) -> None:
        self._config = config
        self._step = 1e-6 * config.control_period_us
        self._splices = config.autopilot.replanning == "every_map"
        if self._splices:
            self._blend = BLEND
            self._inner = _ROUND
        else:
            self._blend = _CLOSE_BLEND
            self._inner = _CLOSE
        self._clearance_map = clearance
        self.memory = _GeneratorMemory(new_state("planning.path"))
        self._corners = np.zeros((timing.CURVE_LIMIT, 3))
        self._curve = np.zeros((timing.CURVE_LIMIT, 3))
        self._arc = np.zeros(timing.CURVE_LIMIT)
        self._speed = np.zeros(timing.CURVE_LIMIT)
        self._dense = np.zeros((timing.POINT_LIMIT, POINT_WIDTH))
        self._held = np.zeros((timing.POINT_LIMIT, POINT_WIDTH))
        self._work = knots.new_work()
        self.fallbacks = 0

    def receive(self, state: State, time_us: int) -> bool:
        """A path makes a step due."""
        name = state.spec.name
        memory = self.memory
        if name == "planning.path":
            memory.path = state
            return True
        if name == "planning.waypoint":
            memory.waypoint = state
        elif len(state.elements) or not self._splices:
            memory.flown = state
        return False

    def step(self, time_us: int) -> list[State]:
        """Time the path; an empty path yields an empty trajectory, as in the published code."""
        memory = self.memory
        memory.seq += 1
        points = self._points()
        trajectory = new_state("planning.trajectory", len(points))
        trajectory.header["trajectory_seq"] = memory.seq
        trajectory.header["future_collision_seq"] = memory.path.header["future_collision_seq"]
        rows(trajectory.elements, POINT_WIDTH)[:] = points
        return [trajectory]

    def _points(self) -> np.ndarray:
        """Points of the trajectory along the stored path; none if there is no path, or it is too long."""
        config = self._config
        path = self.memory.path

        # The vertices, from the vehicle on.
        vertices = rows(path.elements, 3)
        motion = _Motion(path.value("entry_speed"))
        if len(vertices) and self._splices:
            vertices, motion = self._splice(vertices, motion.speed)
        vertices = _without_repeats(vertices)
        if len(vertices) < 2 or len(vertices) > MOST_VERTICES:
            return np.zeros((0, POINT_WIDTH))

        # Dense points, one per control period; corners are blended if no polynomial is feasible.
        n = 0
        if config.autopilot.smoothing == "minimum_snap":
            n = self._polynomials(vertices, motion)
        if n == 0:
            n = self._blends(vertices, motion.speed)

        # Each of the points that are published is held for several periods, unless the consumer interpolates.
        step = self._step
        if n == 0 or config.autopilot.sampling == "interpolated":
            return self._dense[:n]
        per_point = max(1, round(config.autopilot.point_period / step))
        n = timing.hold_points(self._dense, n, per_point, step, round(config.autopilot.look_ahead / step), self._held)
        return self._held[:n]

    def _limits(self) -> timing.Limits:
        """Limits of speed and acceleration for timing, by the autopilot profile."""
        config = self._config
        top_speed = _HELD_SPEED_SHARE * config.v_max
        tight_speed = top_speed
        if self._splices:
            top_speed = config.v_max
            tight_speed = min(TIGHT_SPEED, top_speed)
        scale = min(1.0, config.v_max / NOMINAL_SPEED)  # lengths scale with speed
        return timing.Limits(
            top_speed,
            tight_speed,
            LATERAL_SHARE * config.a_max,
            PLANNING_ACCELERATION,
            BRAKING,
            self._blend * scale,
            _LOOK * scale,
        )

    def _blends(self, vertices: np.ndarray, entry: float) -> int:
        """Sample blended corners with a speed profile; returns the number of dense points."""
        clearance = self._clearance_map
        limits = self._limits()
        count = timing.smooth(
            clearance.narrow,
            clearance.grid,
            vertices,
            len(vertices),
            limits.blend,
            self._inner,
            self._corners,
            self._curve,
        )
        if count < 2:
            return 0
        timing.speed_profile(clearance.wide, clearance.grid, self._curve, count, entry, limits, self._arc, self._speed)
        return timing.sample(self._curve, count, self._arc, self._speed, self._step, limits.look, 0.0, self._dense)

    def _polynomials(self, vertices: np.ndarray, motion: _Motion) -> int:
        """Sample a minimum-snap curve; returns the number of dense points, 0 = infeasible."""
        clearance = self._clearance_map
        limits = self._limits()
        # the limits of blends, for polynomials, which are rounder
        curve_limits = knots.CurveLimits(
            limits.speed,
            _ACCELERATION_SHARE * self._config.a_max,
            limits.tight_speed,
            limits.lateral,
            limits.tangential,
            limits.braking,
            _REACH_SHARE * limits.blend,
            _KNOT_TIME * limits.speed,
        )
        # the initial motion; a path may have been corrupted, and the current acceleration exceed the limit
        with np.errstate(over="ignore", invalid="ignore"):
            velocity = motion.velocity
            if velocity is None:
                velocity = motion.speed * (vertices[1] - vertices[0]) / paths.distance(vertices[1], vertices[0])
            size = paths.distance(motion.acceleration, np.zeros(3))
            acceleration = motion.acceleration * min(1.0, _ENTRY_SHARE * curve_limits.acceleration / max(size, 1e-9))
        n = time_allocation.fit(
            clearance.narrow,
            clearance.wide,
            clearance.grid,
            vertices,
            len(vertices),
            velocity,
            acceleration,
            curve_limits,
            self._work,
        )
        if n == 0:
            self.fallbacks += 1
            return 0
        return minimum_snap.sample(
            self._work.ends, self._work.times, n, self._step, limits.look, motion.yaw, MAX_YAW_RATE, self._dense
        )

    def _splice(self, vertices: np.ndarray, entry: float) -> tuple[np.ndarray, _Motion]:
        """Remaining trajectory in force up to the junction, then the new path; timed from the current speed."""
        memory = self.memory
        junction = memory.path.value("junction")
        if memory.waypoint is None or memory.flown is None or junction < 0:
            return vertices, _Motion(0.0)
        points = rows(memory.flown.elements, POINT_WIDTH)
        index = memory.waypoint.value("index")
        if not 0 <= index < len(points) or not junction < len(points):
            return vertices, _Motion(entry)

        # The junction must be one at which the vehicle can stand; else the path begins with a way back to it.
        arc = np.zeros(len(points))
        setpoint.arc_lengths(points, arc)
        waypoint = floats(memory.waypoint.header, POINT_WIDTH)
        speed = length(waypoint[4:7])
        stand = int(np.searchsorted(arc, arc[index] + speed * speed / (2.0 * BRAKING)))
        tail = vertices
        if stand > junction and speed > _STANDING:
            junction = min(stand, len(points) - 1)
            tail = np.vstack([points[junction, :3], vertices])

        # Vertices up to there.
        head = [waypoint[:3].copy()]
        last = arc[index]
        for k in range(index, junction):
            if arc[k] - last >= _VERTEX_SPACING and arc[junction] - arc[k] >= _JUNCTION_SPACING:
                head.append(points[k, :3])
                last = arc[k]
        motion = _Motion(speed, waypoint[4:7].copy(), waypoint[7:10].copy(), float(waypoint[3]))
        return np.vstack([*head, tail]), motion

    def mark(self) -> None:
        """Save the sequence number for `rollback`."""
        self.memory.marked_seq = self.memory.seq

    def rollback(self) -> None:
        """Restore the sequence number of the mark."""
        self.memory.seq = self.memory.marked_seq

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """Restore the last trajectory: its sequence number, and its points for splicing."""
        trajectory = last.get("planning.trajectory")
        if trajectory is not None:
            self.memory.seq = trajectory.value("trajectory_seq")
            self.receive(trajectory, time_us)
        return ()


def _without_repeats(vertices: np.ndarray) -> np.ndarray:
    """Vertices without consecutive duplicates."""
    distinct = [
        row for row in range(len(vertices)) if row == 0 or paths.distance(vertices[row], vertices[row - 1]) > 1e-3
    ]
    return np.ascontiguousarray(vertices[distinct])
