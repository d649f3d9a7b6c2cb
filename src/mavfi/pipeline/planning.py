"""The motion planner: request -> path (MAVFI section III-A); time parameterization is in `trajectories`.

The motion planner decides when to plan and from which point, under one of two policies.  `event`: on a newly predicted
collision, and when no trajectory is flown (the published code).  `every_map`: whenever the current trajectory is
blocked, ends short of the goal or makes no progress, from a junction at which the vehicle can still stop.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mavfi.kernels.planning import path as paths
from mavfi.kernels.planning import trajectory as timing
from mavfi.kernels.planning import waypoint as setpoint
from mavfi.numerics.vectors import length
from mavfi.numerics.voxels import segment_free
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.memory import Memory, Remembers
from mavfi.pipeline.routes import PLANNING_ACCELERATION, Routes
from mavfi.pipeline.trajectories import BRAKING
from mavfi.states import Stage, State, floats, new_state

_RETRY_US = 500_000
_ADOPTION_US = 3_000_000
_MARGIN = 0.3
_STUCK_US = 4_000_000
_BACKTRACK_AFTER = 3
_BACKTRACK_UNTIL = 12
"""Number of consecutive failures after which backtracking is abandoned: no path exists."""
_BACKTRACK_LENGTH = 4.0
_CRUMB = 0.5
_EMERGENCY_STOP_TIME = 0.6
"""v_max / a_max of the published code (s)."""


@dataclass(slots=True)
class _Decisions(Memory):
    """Decision variables of the planner, which a rollback restores."""

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
    odometry: np.ndarray = field(default_factory=lambda: np.zeros(13))
    waypoint: State | None = None
    trajectory: State | None = None
    arc: np.ndarray = field(default_factory=lambda: np.zeros(0))
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
            "perception.map_update", "perception.collision_status", config.odometry, "planning.waypoint",
            "planning.trajectory",
        )  # fmt: skip
        self._every_map = config.autopilot.replanning == "every_map"
        self.routes = Routes(config)
        self.clearance_map = self.routes.clearance_map
        self.keepers = (self.clearance_map, self.routes)
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
        self.memory.status = state
        seq = int(state.header["future_collision_seq"][0])
        if bool(state.header["collision"][0]) and seq > self.memory.decisions.acted_seq:
            self.memory.decisions.acted_seq = seq
            self.memory.decisions.alarm = float(state.header["time_to_collision"][0])

    def _take_trajectory(self, state: State, time_us: int) -> None:
        if self._every_map and len(state.elements) == 0:
            return  # planning failed: the current trajectory remains in force
        self.memory.trajectory = state
        if len(state.elements):
            self.memory.arc = np.zeros(len(state.elements))
            setpoint.arc_lengths(
                floats(state.elements, timing.POINT_WIDTH).reshape(-1, timing.POINT_WIDTH), self.memory.arc
            )
        self.memory.decisions.progress, self.memory.decisions.progress_us = -np.inf, time_us

    def _take_odometry(self, state: State, time_us: int) -> bool:
        self.memory.odometry = floats(state.header, 13)
        position = self.memory.odometry[:3]
        if not self.memory.crumbs or paths.distance(self.memory.crumbs[-1], position) > _CRUMB:
            self.memory.crumbs.append(position.copy())
        if self._every_map:
            return False
        if self.memory.decisions.alarm >= 0.0:
            return True
        return self._idle() and time_us >= self.memory.decisions.retry_us and not self._adoption_pending(time_us)

    def _idle(self) -> bool:
        """Whether no trajectory is flown although a map is available."""
        if self.memory.waypoint is None or self.clearance_map.updates == 0:
            return False
        return int(self.memory.waypoint.header["index"][0]) < 0

    def _adoption_pending(self, time_us: int) -> bool:
        """Whether the last trajectory is about to be adopted, e.g. once the vehicle is at rest."""
        if self.memory.trajectory is None or len(self.memory.trajectory.elements) == 0:
            return False
        new = self.memory.waypoint is None or not self._same_trajectory(self.memory.waypoint)
        return new and time_us - self.memory.decisions.progress_us < _ADOPTION_US

    def _on_trajectory(self) -> tuple[int, float]:
        """Index of the way-point on the last trajectory, and its arc length (m); (-1, 0) if none is flown."""
        if self.memory.waypoint is None or self.memory.trajectory is None or len(self.memory.trajectory.elements) == 0:
            return -1, 0.0
        index = int(self.memory.waypoint.header["index"][0])
        if index < 0 or not self._same_trajectory(self.memory.waypoint):
            return -1, 0.0
        index = min(index, len(self.memory.arc) - 1)
        return index, float(self.memory.arc[index])

    def _same_trajectory(self, state: State) -> bool:
        """Whether a state refers to the last published trajectory."""
        return self.memory.trajectory is not None and int(state.header["trajectory_seq"][0]) == int(
            self.memory.trajectory.header["trajectory_seq"][0]
        )

    def _wants_new_plan(self, time_us: int) -> bool:
        """Policy `every_map`: no trajectory, blocked, ended short of the goal, or no progress."""
        memory, config = self.memory.decisions, self._config
        if self.memory.status is None:
            return False
        if time_us < memory.settled_us:
            return False  # the last plan is still in transit
        index, along = self._on_trajectory()
        position = self.memory.odometry[:3]
        to_goal = paths.distance(position, config.goal)
        if to_goal < memory.best_distance - 1.0:
            memory.best_distance, memory.best_us = to_goal, time_us
        if index < 0 or along - memory.progress > _MARGIN:
            memory.progress, memory.progress_us = along, time_us
        if index < 0:
            return time_us >= memory.retry_us
        if bool(self.memory.status.header["collision"][0]) and self._same_trajectory(self.memory.status):
            return True
        stuck = time_us - memory.progress_us > _STUCK_US
        patience = config.autopilot.progress_timeout
        lost = patience > 0.0 and time_us - memory.best_us > 1e6 * patience
        if stuck or lost:
            memory.progress_us = memory.best_us = time_us
        return stuck or lost or index >= len(self.memory.arc) - 1

    # ---- planning ---------------------------------------------------------------------------------------------------
    def step(self, time_us: int) -> list[State]:
        """Plan once; an empty path reports failure."""
        memory = self.memory.decisions
        if self._every_map:
            path = self._plan_from_junction()
        else:
            alarm, memory.alarm = memory.alarm, -1.0
            path = self._plan_in_flight(alarm) if alarm >= 0.0 else None
            path = path or self._plan_from_rest()
        memory.retry_us = time_us + _RETRY_US
        memory.settled_us = time_us + int(1e6 * self._config.plan_latency) + 2 * self._config.control_period_us
        if path is None:
            memory.failures += 1
            path = self._backtrack() or new_state("planning.path")
        else:
            memory.failures = 0
        path.header["future_collision_seq"] = memory.acted_seq
        return [path]

    def _path(self, vertices: np.ndarray, entry_speed: float, junction: int = -1) -> State:
        path = new_state("planning.path", len(vertices))
        floats(path.elements, 3).reshape(-1, 3)[:] = vertices
        path.header["entry_speed"] = entry_speed
        path.header["junction"] = junction
        return path

    def _plan_from_rest(self) -> State | None:
        """Plan from the predicted rest position; with the checker's radius if the planner's does not fit."""
        position, velocity = self.memory.odometry[:3], self.memory.odometry[3:6]
        speed = length(velocity)
        stop = position + velocity * self._config.velocity_lag if speed < 2.0 * self._config.v_max else position.copy()
        found = self.routes.first_found(stop)
        return None if found is None else self._path(found, 0.0)

    def _plan_in_flight(self, alarm: float) -> State | None:
        """Plan a replacement without stopping, if the predicted collision is late enough."""
        autopilot = self._config.autopilot
        velocity = self.memory.odometry[3:6]
        speed = length(velocity)
        if not alarm > autopilot.grace + _EMERGENCY_STOP_TIME or self._idle() or not speed < 2.0 * self._config.v_max:
            return None
        start = self.memory.odometry[:3] + velocity * self._config.plan_latency
        lead = start + velocity * (speed / (2.0 * PLANNING_ACCELERATION))
        if not segment_free(self.clearance_map.narrow, self.clearance_map.grid, start, lead):
            return None
        found = self.routes.between(lead, self.clearance_map.wide)
        if found is None:
            return None
        leading = [start] if speed < 0.2 else [start, lead]
        if paths.distance(found[0], leading[-1]) < 1e-6:
            leading.pop()
        return self._path(np.vstack([*leading, found]), speed)

    def _plan_from_junction(self) -> State | None:
        """Plan from the point of the current trajectory at which the vehicle can be when the plan arrives."""
        config = self._config
        index, along = self._on_trajectory()
        if index < 0:
            junction, start, speed = -1, self._standing_point(), 0.0
            velocity = np.zeros(3)
        else:
            waypoint = floats(self.memory.waypoint.header, timing.POINT_WIDTH)  # type: ignore[union-attr]
            speed = length(waypoint[4:7])
            distance = along
            if speed > 0.1:
                distance += 1.5 * speed * config.plan_latency + speed * speed / (2.0 * PLANNING_ACCELERATION) + 0.2
            blocked = float(self.memory.status.header["distance_to_blocked"][0])  # type: ignore[union-attr]
            soonest = along + speed * config.plan_latency + speed * speed / (2.0 * BRAKING)
            distance = max(min(distance, blocked - _MARGIN), soonest)
            junction = min(int(np.searchsorted(self.memory.arc, distance)), len(self.memory.arc) - 1)
            points = floats(self.memory.trajectory.elements, timing.POINT_WIDTH)  # type: ignore[union-attr]
            point = points.reshape(-1, timing.POINT_WIDTH)[junction]
            start, velocity = point[:3].copy(), point[4:7].copy()
        found = self.routes.fastest(start, velocity)
        return None if found is None else self._path(found, speed, junction)

    def _standing_point(self) -> np.ndarray:
        """Reference position while no trajectory is flown."""
        if self.memory.waypoint is None:
            return self.memory.odometry[:3].copy()
        return floats(self.memory.waypoint.header, timing.POINT_WIDTH)[:3].copy()

    def _backtrack(self) -> State | None:
        """After repeated failures: return along the flown path into known free space (policy `every_map`)."""
        failures = self.memory.decisions.failures
        if not self._every_map or failures % _BACKTRACK_AFTER or failures > _BACKTRACK_UNTIL:
            return None
        vertices, flown = [self._standing_point()], 0.0
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
            self.memory.decisions.acted_seq = int(trajectory.header["future_collision_seq"][0])
        return ()
