"""The motion planner: request -> path (MAVFI section III-A); time parameterization is in `trajectories`.

The motion planner decides when to plan and from which point, under one of two policies.  `event`: on a newly predicted
collision, and when no trajectory is flown (the published code).  `every_map`: whenever the current trajectory is
blocked, ends short of the goal or makes no progress, from a junction at which the vehicle can still stop.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mavfi.kernels.planning import path as paths
from mavfi.kernels.planning import waypoint as setpoint
from mavfi.kernels.planning.trajectory import POINT_WIDTH
from mavfi.numerics.vectors import length
from mavfi.numerics.voxels import segment_free
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.memory import Memory, Remembers, zeros
from mavfi.pipeline.routes import PLANNING_ACCELERATION, Routes
from mavfi.pipeline.trajectories import BRAKING
from mavfi.states import Stage, State, floats, new_state, rows

_RETRY_US = 500_000
"""Time from a plan to the next one without a trajectory (us)."""
_ADOPTION_US = 3_000_000
"""Time within which a trajectory is expected to be adopted (us)."""
_MARGIN = 0.3
"""Distance along the trajectory: progress, and clearance of a junction from a blocked point (m)."""
_STUCK_US = 4_000_000
"""Time without progress along the trajectory after which another plan is made (us)."""
_BACKTRACK_AFTER = 3
"""Consecutive failures between two attempts to backtrack."""
_BACKTRACK_UNTIL = 12
"""Number of consecutive failures after which backtracking is abandoned: no path exists."""
_BACKTRACK_LENGTH = 4.0
"""Length of the flown path that is flown back (m)."""
_CRUMB = 0.5
"""Distance between stored positions of the flown path (m)."""
_EMERGENCY_STOP_TIME = 0.6
"""v_max / a_max of the published code (s)."""


@dataclass(slots=True)
class _Decisions(Memory):
    """Decision variables of the planner, which a rollback restores.

    Attributes:
        acted_seq: Sequence number of the last collision alarm that was acted on.
        alarm: Time to collision of an alarm that is to be acted on (s); -1 = none.
        retry_us: Instant before which no plan follows the last one without a trajectory (us).
        settled_us: Instant until which the last plan is in transit (us).
        failures: Consecutive failed plans.
        best_distance: Smallest distance from the goal so far (m).
        best_us: When it was last reduced by 1 m (us).
        progress: Arc length reached on the trajectory (m).
        progress_us: When it last increased (us).
    """

    acted_seq: int = 0
    alarm: float = -1.0
    retry_us: int = 0
    settled_us: int = 0
    failures: int = 0
    best_distance: float = np.inf
    best_us: int = 0
    progress: float = -np.inf
    progress_us: int = 0


@dataclass(slots=True)
class _PlannerMemory(Memory):
    """Inputs, positions flown, decision variables, and those of the last mark with the generator's state."""

    marked: tuple[_Decisions, np.ndarray]
    status: State | None = None
    odometry: np.ndarray = zeros(13)
    waypoint: State | None = None
    trajectory: State | None = None
    arc: np.ndarray = zeros(0)
    crumbs: list[np.ndarray] = field(default_factory=list)
    decisions: _Decisions = field(default_factory=_Decisions)


class MotionPlanner(Remembers):
    """Kernel `planner`: request -> path, on the node's clearance map."""

    name = "planner"
    stage = Stage.PLANNING
    writes = ("planning.path",)
    quiet = ("perception.map_update", "planning.waypoint", "planning.trajectory")
    memory: _PlannerMemory

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self.reads = (
            "perception.map_update",
            "perception.collision_status",
            config.odometry,
            "planning.waypoint",
            "planning.trajectory",
        )
        self._every_map = config.autopilot.replanning == "every_map"
        self.routes = Routes(config)
        self.clearance_map = self.routes.clearance_map
        self.keepers = (self.clearance_map, self.routes.keeper)
        self.scratch = self.routes.scratch
        self.memory = _PlannerMemory((_Decisions(), self.routes.random.copy()))

    # ---- inputs -----------------------------------------------------------------------------------------------------
    def receive(self, state: State, time_us: int) -> bool:
        """Store an input; a step is due when the policy requests a plan."""
        name = state.spec.name
        if name == "perception.map_update":
            self.clearance_map.apply(state)
            self.clearance_map.mark()  # updates carry absolute values and are never rolled back here
        elif name == "perception.collision_status":
            self._take_status(state)
            if self._every_map:
                return self._wants_new_plan(time_us)
        elif name == "planning.waypoint":
            self.memory.waypoint = state
        elif name == "planning.trajectory":
            self._take_trajectory(state, time_us)
        else:
            return self._take_odometry(state, time_us)
        return False

    def _take_status(self, state: State) -> None:
        """Store a collision status; a new alarm waits for the next step."""
        self.memory.status = state
        decisions = self.memory.decisions
        seq = state.value("future_collision_seq")
        if state.value("collision") and seq > decisions.acted_seq:
            decisions.acted_seq = seq
            decisions.alarm = state.value("time_to_collision")

    def _take_trajectory(self, state: State, time_us: int) -> None:
        """Store a published trajectory and its arc lengths; progress along it restarts at zero."""
        if self._every_map and len(state.elements) == 0:
            return  # planning failed: the current trajectory remains in force
        memory = self.memory
        memory.trajectory = state
        if len(state.elements):
            memory.arc = np.zeros(len(state.elements))
            setpoint.arc_lengths(rows(state.elements, POINT_WIDTH), memory.arc)
        memory.decisions.progress = -np.inf
        memory.decisions.progress_us = time_us

    def _take_odometry(self, state: State, time_us: int) -> bool:
        """Store the odometry and the flown path; whether a plan is wanted under the policy `event`."""
        memory = self.memory
        memory.odometry = floats(state.header, 13)
        position = memory.odometry[:3]
        if not memory.crumbs or paths.distance(memory.crumbs[-1], position) > _CRUMB:
            memory.crumbs.append(position.copy())
        if self._every_map:
            return False
        if memory.decisions.alarm >= 0.0:
            return True
        return self._idle() and time_us >= memory.decisions.retry_us and not self._adoption_pending(time_us)

    def _idle(self) -> bool:
        """Whether no trajectory is flown although a map is available."""
        waypoint = self.memory.waypoint
        return waypoint is not None and self.clearance_map.updates != 0 and waypoint.value("index") < 0

    def _adoption_pending(self, time_us: int) -> bool:
        """Whether the last trajectory is about to be adopted, e.g. once the vehicle is at rest."""
        if not self._has_points() or self._same_trajectory(self.memory.waypoint):
            return False
        return time_us - self.memory.decisions.progress_us < _ADOPTION_US

    def _on_trajectory(self) -> tuple[int, float]:
        """Index of the way-point on the last trajectory, and its arc length (m); (-1, 0) if none is flown."""
        waypoint = self.memory.waypoint
        arc = self.memory.arc
        if waypoint is None or waypoint.value("index") < 0:
            return -1, 0.0
        if not self._has_points() or not self._same_trajectory(waypoint):
            return -1, 0.0
        index = min(waypoint.value("index"), len(arc) - 1)
        return index, float(arc[index])

    def _has_points(self) -> bool:
        """Whether a trajectory was published, and the last one is not empty."""
        trajectory = self.memory.trajectory
        return trajectory is not None and len(trajectory.elements) > 0

    def _same_trajectory(self, state: State | None) -> bool:
        """Whether a state refers to the last published trajectory."""
        trajectory = self.memory.trajectory
        if trajectory is None or state is None:
            return False
        return bool(state.value("trajectory_seq") == trajectory.value("trajectory_seq"))

    def _wants_new_plan(self, time_us: int) -> bool:
        """Policy `every_map`: no trajectory, blocked, ended short of the goal, or no progress."""
        memory = self.memory
        decisions = self.memory.decisions
        if memory.status is None:
            return False
        if time_us < decisions.settled_us:
            return False  # the last plan is still in transit
        index, along = self._on_trajectory()
        to_goal = paths.distance(memory.odometry[:3], self._config.goal)
        if to_goal < decisions.best_distance - 1.0:
            decisions.best_distance = to_goal
            decisions.best_us = time_us
        if index < 0 or along - decisions.progress > _MARGIN:
            decisions.progress = along
            decisions.progress_us = time_us
        if index < 0:
            return time_us >= decisions.retry_us
        if memory.status.value("collision") and self._same_trajectory(memory.status):
            return True
        stuck = time_us - decisions.progress_us > _STUCK_US
        patience = self._config.autopilot.progress_timeout
        lost = patience > 0.0 and time_us - decisions.best_us > 1e6 * patience
        if stuck or lost:
            decisions.progress_us = time_us
            decisions.best_us = time_us
        return stuck or lost or index >= len(memory.arc) - 1

    # ---- planning ---------------------------------------------------------------------------------------------------
    def step(self, time_us: int) -> list[State]:
        """Plan once; an empty path reports failure."""
        decisions = self.memory.decisions
        config = self._config
        if self._every_map:
            path = self._plan_from_junction()
        else:
            alarm = decisions.alarm
            decisions.alarm = -1.0
            path = None
            if alarm >= 0.0:
                path = self._plan_in_flight(alarm)
            if path is None:
                path = self._plan_from_rest()
        decisions.retry_us = time_us + _RETRY_US
        decisions.settled_us = time_us + int(1e6 * config.plan_latency) + 2 * config.control_period_us
        if path is None:
            decisions.failures += 1
            path = self._backtrack() or new_state("planning.path")
        else:
            decisions.failures = 0
        path.header["future_collision_seq"] = decisions.acted_seq
        return [path]

    def _path(self, vertices: np.ndarray, entry_speed: float, junction: int = -1) -> State:
        """A path, entered at a speed (m/s) from a point of the trajectory in force; -1 = from none of them."""
        path = new_state("planning.path", len(vertices))
        rows(path.elements, 3)[:] = vertices
        path.header["entry_speed"] = entry_speed
        path.header["junction"] = junction
        return path

    def _plan_from_rest(self) -> State | None:
        """Plan from the predicted rest position; with the checker's radius if the planner's does not fit."""
        config = self._config
        position = self.memory.odometry[:3]
        velocity = self.memory.odometry[3:6]
        is_plausible = length(velocity) < 2.0 * config.v_max
        if is_plausible:
            stop = position + velocity * config.velocity_lag
        else:
            stop = position.copy()
        vertices = self.routes.first_found(stop)
        if vertices is None:
            return None
        return self._path(vertices, 0.0)

    def _plan_in_flight(self, alarm: float) -> State | None:
        """Plan a replacement without stopping, if the predicted collision is late enough."""
        config = self._config
        clearance = self.clearance_map
        velocity = self.memory.odometry[3:6]
        speed = length(velocity)
        is_late_enough = alarm > config.autopilot.grace + _EMERGENCY_STOP_TIME
        if not is_late_enough or self._idle() or not speed < 2.0 * config.v_max:
            return None
        start = self.memory.odometry[:3] + velocity * config.plan_latency
        lead = start + velocity * (speed / (2.0 * PLANNING_ACCELERATION))
        if not segment_free(clearance.narrow, clearance.grid, start, lead):
            return None
        vertices = self.routes.between(lead, clearance.wide)
        if vertices is None:
            return None
        leading = [start]
        if not speed < 0.2:
            leading.append(lead)
        if paths.distance(vertices[0], leading[-1]) < 1e-6:
            leading.pop()
        return self._path(np.vstack([*leading, vertices]), speed)

    def _plan_from_junction(self) -> State | None:
        """Plan from the point of the current trajectory at which the vehicle can be when the plan arrives."""
        memory = self.memory
        latency = self._config.plan_latency
        index, along = self._on_trajectory()
        if index < 0:
            return self._fastest_path(self._standing_point(), np.zeros(3), speed=0.0, junction=-1)
        assert memory.waypoint is not None and memory.trajectory is not None  # it is on this trajectory
        assert memory.status is not None  # no plan is wanted before the first one

        # Arc length of the junction: ahead of the vehicle by one and a half latencies and the distance to stop gently,
        # short of the blocked part, but not before it can stop at all.
        speed = length(floats(memory.waypoint.header, 7)[4:])
        distance = along
        if speed > 0.1:
            distance += 1.5 * speed * latency + speed * speed / (2.0 * PLANNING_ACCELERATION) + 0.2
        blocked = memory.status.value("distance_to_blocked")
        soonest = along + speed * latency + speed * speed / (2.0 * BRAKING)
        distance = max(min(distance, blocked - _MARGIN), soonest)

        # Plan from that point, at its velocity.
        junction = min(int(np.searchsorted(memory.arc, distance)), len(memory.arc) - 1)
        point = rows(memory.trajectory.elements, POINT_WIDTH)[junction]
        return self._fastest_path(point[:3].copy(), point[4:7].copy(), speed=speed, junction=junction)

    def _fastest_path(self, start: np.ndarray, velocity: np.ndarray, *, speed: float, junction: int) -> State | None:
        """The fastest path to the goal from a point of the trajectory (-1 = none), at a velocity (m/s); None = none.

        `speed` is the vehicle's current speed (m/s), with which the trajectory begins.
        """
        vertices = self.routes.fastest(start, velocity)
        if vertices is None:
            return None
        return self._path(vertices, speed, junction)

    def _standing_point(self) -> np.ndarray:
        """Reference position while no trajectory is flown."""
        waypoint = self.memory.waypoint
        if waypoint is None:
            return self.memory.odometry[:3].copy()
        return floats(waypoint.header, 3).copy()

    def _backtrack(self) -> State | None:
        """After repeated failures: return along the flown path into known free space (policy `every_map`)."""
        failures = self.memory.decisions.failures
        if not self._every_map or failures % _BACKTRACK_AFTER or failures > _BACKTRACK_UNTIL:
            return None
        vertices = [self._standing_point()]
        flown = 0.0
        for crumb in reversed(self.memory.crumbs):
            step = paths.distance(vertices[-1], crumb)
            if step < _CRUMB:
                continue
            vertices.append(crumb)
            flown += step
            if flown > _BACKTRACK_LENGTH:
                return self._path(np.array(vertices), 0.0)
        return None

    # ---- recomputation ----------------------------------------------------------------------------------------------
    def mark(self) -> None:
        """Save decisions and random state; the map is not rolled back, as updates carry absolute values."""
        self.memory.marked = (self.memory.decisions.copy(), self.routes.random.copy())

    def rollback(self) -> None:
        """Restore decisions and random state of the mark."""
        decisions, random = self.memory.marked
        self.memory.decisions = decisions.copy()
        self.routes.random[:] = random

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """Restore the node's last trajectory, whose sequence number indicates the answered alarms."""
        trajectory = last.get("planning.trajectory")
        if trajectory is not None:
            self._take_trajectory(trajectory, time_us)
            self.memory.decisions.acted_seq = trajectory.value("future_collision_seq")
        return ()
