"""Setpoint generator: selects the trajectory point that control follows, and decides when the vehicle stops.

Trajectories and collision messages carry sequence numbers; numbers below the last one are rejected, as in the published
code.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mavfi.kernels.planning import waypoint as setpoint
from mavfi.kernels.planning.trajectory import POINT_WIDTH
from mavfi.numerics.rotations import yaw_of
from mavfi.numerics.vectors import length
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.memory import Memory, Remembers
from mavfi.pipeline.routes import PLANNING_ACCELERATION
from mavfi.states import Stage, State, floats, new_state

_EMERGENCY_STOP_TIME = 0.6
_STANDING = 0.4
_SPEED_STEP = 1.0
_HOLD_TURN = 0.6
_CREEP_SHARE = 1.0 / 3.0
_CREEP_STEP = 0.3
_ADOPTION_WINDOW = 50


@dataclass(frozen=True, slots=True)
class _InForce(Memory):
    """The trajectory in force and the pending one; replaced, never modified, so that a mark is a reference."""

    trajectory: State | None = None
    index: int = -1
    waiting: State | None = None
    last_seq: int = -1
    epoch: int = 0
    seen_seq: int = 0
    stop_us: int = -1
    stopping: bool = False
    rejected_since: int = -1
    clock: tuple[float, float, float] = (0.0, 1.0, 0.0)


@dataclass(slots=True)
class _SetpointMemory(Memory):
    """Trajectory in force with its arc lengths, inputs, limits of the known space, and the marks."""

    now: _InForce = field(default_factory=_InForce)
    inbox: list[State] = field(default_factory=list)
    odometry: np.ndarray = field(default_factory=lambda: np.zeros(13))
    remaining: float = 0.0
    limits: tuple[float, float, int] = (np.inf, np.inf, -1)
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, POINT_WIDTH)))
    arc: np.ndarray = field(default_factory=lambda: np.zeros(0))
    published: State | None = None
    marked: _InForce = field(default_factory=_InForce)
    marked_inputs: tuple[list[State], float, State | None] = field(default_factory=lambda: ([], 0.0, None))


class SetpointGenerator(Remembers):
    """Kernel `waypoint`; stepped at the control period, publishes only when the point in force changes."""

    name = "waypoint"
    stage = Stage.PLANNING
    writes = ("planning.waypoint",)
    memory: _SetpointMemory

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self.reads = ("planning.trajectory", "perception.collision_status", config.odometry, "control.tracking")
        self._governed = config.autopilot.sampling == "interpolated"
        self.memory = _SetpointMemory()
        self._creep = min(_CREEP_SHARE * config.v_max, _CREEP_STEP / max(config.map_latency, 1e-3))

    def receive(self, state: State, time_us: int) -> bool:
        """Store an input; steps are due only at the control period."""
        del time_us
        name = state.spec.name
        if name == self._config.odometry:
            self.memory.odometry = floats(state.header, 13)
        elif name == "control.tracking":
            self.memory.remaining = float(state.header["remaining"][0])
        else:
            self.memory.inbox.append(state)
        return False

    def step(self, time_us: int) -> list[State]:
        """Select the point in force; no output if it is unchanged."""
        inbox, self.memory.inbox = self.memory.inbox, []
        for state in inbox:
            if state.spec.name == "planning.trajectory":
                self._offer(state, time_us)
            else:
                self._warn(state, time_us)
        self._watch(time_us)
        memory = self.memory.now
        if memory.stop_us >= 0 and time_us >= memory.stop_us:
            return [self._brake()]
        waiting = memory.waiting
        if waiting is not None and self._slow_enough(waiting):
            return [self._adopt(waiting)]
        if waiting is not None and not memory.stopping:
            return [self._brake()]
        if self.memory.published is None:
            return [self._hold()]
        if memory.trajectory is None:
            return []  # no trajectory: the point in force remains
        return self._governed_point() if self._governed else self._held_point()

    def abandon(self, time_us: int) -> list[State]:
        """Skip from the way-point in force to the next one; before any trajectory there is the initial hold only."""
        if self.memory.now.trajectory is None:
            first = self.memory.now.last_seq < 0  # nothing may have been received yet
            return self.step(time_us) or ([self._hold()] if first else [])
        if self._governed:
            position, rate, change = self.memory.now.clock
            self._set(clock=(position + 1.0, rate, change))
            return self._governed_point()
        self.memory.remaining = 0.0
        return self._held_point()

    def stop(self) -> list[State]:
        """Abandon the trajectory and hold position; the planner then replans."""
        self._set(waiting=None)
        return [self._brake()]

    def mark(self) -> None:
        """Save the memory for `rollback`."""
        self.memory.marked = self.memory.now
        self.memory.marked_inputs = (list(self.memory.inbox), self.memory.remaining, self.memory.published)

    def rollback(self) -> None:
        """Restore the memory of the mark, and the inputs that the step consumed."""
        self.memory.now = self.memory.marked
        inbox, self.memory.remaining, self.memory.published = self.memory.marked_inputs
        self.memory.inbox = inbox + self.memory.inbox
        self._load(self.memory.now.trajectory)

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """Restore the way-point in force, its sequence numbers and, if it belongs to the last one, its trajectory.

        While the vehicle holds, a trajectory is received again only if it answers a later alarm than the hold does,
        as it may otherwise be the abandoned one.  A planner whose trajectory is not adopted plans again.
        """
        del time_us
        waypoint, trajectory = last.get("planning.waypoint"), last.get("planning.trajectory")
        if waypoint is None:
            return ()
        number, alarm_seq, index = (
            int(waypoint.header[name][0]) for name in ("trajectory_seq", "future_collision_seq", "index")
        )
        taken = False
        if trajectory is not None:
            offered = int(trajectory.header["trajectory_seq"][0])
            taken = offered == number if index >= 0 else int(trajectory.header["future_collision_seq"][0]) <= alarm_seq
            number = offered if taken else number
        flown = trajectory if taken and index >= 0 else None
        self.memory.published = waypoint
        self._set(
            trajectory=flown, index=-1 if flown is None else index, last_seq=number, epoch=alarm_seq,
            seen_seq=alarm_seq, stopping=index < 0, clock=(float(max(index, 0)), 1.0, 0.0),
        )  # fmt: skip
        self._load(flown)
        return ("planning.trajectory",) if taken else ()

    # ---- sequence numbers -------------------------------------------------------------------------------------------
    def _set(self, **changes: object) -> None:
        self.memory.now = replace(self.memory.now, **changes)  # type: ignore[arg-type]

    def _offer(self, state: State, time_us: int) -> None:
        """Accept or reject a trajectory by its sequence numbers."""
        memory = self.memory.now
        seq = int(state.header["trajectory_seq"][0])
        alarm_seq = int(state.header["future_collision_seq"][0])
        if seq < memory.last_seq or alarm_seq < memory.epoch:
            since = memory.rejected_since if memory.rejected_since >= 0 else time_us
            patience = self._config.autopilot.epoch_liveness
            if not (patience > 0.0 and time_us - since > 1e6 * patience):
                self._set(rejected_since=since)
                return
        if self._config.autopilot.consumer_check and not self._sane(state):
            self._set(stop_us=time_us)
            return
        self._set(
            waiting=state, last_seq=seq, epoch=alarm_seq, seen_seq=max(memory.seen_seq, alarm_seq), rejected_since=-1
        )  # fmt: skip

    def _warn(self, state: State, time_us: int) -> None:
        """Respond to a collision status: stop at once, or after the grace period if time permits."""
        header = state.header[0]
        if self._governed:
            self.memory.limits = (
                float(header["distance_to_blocked"]), float(header["distance_to_unknown"]),
                int(header["trajectory_seq"]),
            )  # fmt: skip
            return
        seq = int(header["future_collision_seq"])
        memory = self.memory.now
        if not bool(header["collision"]) or seq <= memory.seen_seq:
            return
        grace = self._config.autopilot.grace
        enough = float(header["time_to_collision"]) > grace + _EMERGENCY_STOP_TIME
        due = time_us + (int(1e6 * grace) if enough else 0)
        self._set(seen_seq=seq, stop_us=due if memory.stop_us < 0 else min(due, memory.stop_us))

    def _watch(self, time_us: int) -> None:
        """Deviation monitor: stop and replan if too far from the reference."""
        limit = self._config.autopilot.deviation_limit
        if limit <= 0.0 or self.memory.now.trajectory is None or self.memory.published is None:
            return
        reference = floats(self.memory.published.header, POINT_WIDTH)[:3]
        if not length(reference - self.memory.odometry[:3]) < limit:
            self._set(stop_us=time_us)

    def _sane(self, state: State) -> bool:
        """Plausibility checks of a trajectory that require no map."""
        points = floats(state.elements, POINT_WIDTH).reshape(-1, POINT_WIDTH)
        if len(points) == 0:
            return True
        v_max = 1.5 * self._config.v_max
        lower, upper = self._config.flight_lower - 2.0, self._config.flight_upper + 2.0
        with np.errstate(over="ignore", invalid="ignore"):
            steps = np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1)
            return bool(
                np.isfinite(points).all()
                and ((points[:, 10] > 0.0) & (points[:, 10] <= 1.0)).all()
                and (np.linalg.norm(points[:, 4:7], axis=1) <= v_max).all()
                and (steps <= v_max * points[1:, 10] + 0.3).all()
                and ((points[:, :3] >= lower) & (points[:, :3] <= upper)).all()
            )

    # ---- publications -----------------------------------------------------------------------------------------------
    def _load(self, trajectory: State | None) -> None:
        if trajectory is None:
            return
        self.memory.points = floats(trajectory.elements, POINT_WIDTH).reshape(-1, POINT_WIDTH)
        self.memory.arc = np.zeros(len(self.memory.points))
        if len(self.memory.points):
            setpoint.arc_lengths(self.memory.points, self.memory.arc)

    def _slow_enough(self, waiting: State) -> bool:
        """Whether a trajectory may be adopted at the current speed."""
        if self._governed or len(waiting.elements) == 0:
            return True
        speed = length(self.memory.odometry[3:6])
        if self.memory.now.stopping:
            return not speed > _STANDING
        first = length(floats(waiting.elements, POINT_WIDTH).reshape(-1, POINT_WIDTH)[0, 4:7])
        return not speed > first + _SPEED_STEP

    def _brake(self) -> State:
        self._set(trajectory=None, index=-1, stop_us=-1, stopping=True)
        return self._hold()

    def _adopt(self, trajectory: State) -> State:
        if len(trajectory.elements) == 0:
            if self._governed and self.memory.now.trajectory is not None and self.memory.now.clock[1] > 0.0:
                self._set(waiting=None)  # the current trajectory still leads to a safe stopping point
                return self._governed_point()[0]
            self._set(trajectory=None, index=-1, waiting=None)
            return self._hold(turn=_HOLD_TURN)
        self._load(trajectory)
        self._set(trajectory=trajectory, waiting=None, stopping=False, stop_us=-1, index=0, clock=(0.0, 1.0, 0.0))
        if not self._governed:
            return self._publish(0, self.memory.points[0])
        start = self._nearest_start()
        self._set(clock=(float(start), 1.0, 0.0), index=start)
        waypoint = np.zeros(POINT_WIDTH)
        setpoint.reference(np.array(self.memory.now.clock), self.memory.points, waypoint)
        return self._publish(start, waypoint)

    def _nearest_start(self) -> int:
        """Point of a spliced trajectory nearest to the reference in force, which has advanced since planning."""
        if self.memory.published is None:
            return 0
        reference = floats(self.memory.published.header, POINT_WIDTH)[:3]
        window = self.memory.points[:_ADOPTION_WINDOW, :3]
        return int(np.argmin(((window - reference) ** 2).sum(1)))

    def _held_point(self) -> list[State]:
        waypoint = np.zeros(POINT_WIDTH)
        index = setpoint.advance_index(self.memory.points, self.memory.now.index, self.memory.remaining, waypoint)
        if index == self.memory.now.index:
            return []
        if index >= len(self.memory.points):
            self._set(trajectory=None, index=-1)
            return [self._hold()]
        self._set(index=index)
        self.memory.remaining = np.inf  # until the tracker reports on the new point
        return [self._publish(index, waypoint)]

    def _governed_point(self) -> list[State]:
        clock = np.array(self.memory.now.clock)
        blocked, unknown, seq = self.memory.limits
        trajectory = self.memory.now.trajectory
        if not self._config.autopilot.known_space_limit or (
            trajectory is not None and seq != int(trajectory.header["trajectory_seq"][0])
        ):
            blocked = unknown = np.inf
        setpoint.advance_clock(
            clock, self.memory.points, self.memory.arc, 1e-6 * self._config.control_period_us, blocked, unknown,
            PLANNING_ACCELERATION, self._creep, 1.0 / self._config.tracker_slowdown,
        )  # fmt: skip
        self._set(clock=tuple(clock), index=int(clock[0]))
        waypoint = np.zeros(POINT_WIDTH)
        setpoint.reference(clock, self.memory.points, waypoint)
        return [self._publish(int(clock[0]), waypoint)]

    def _publish(self, index: int, waypoint: np.ndarray) -> State:
        state = new_state("planning.waypoint")
        floats(state.header, POINT_WIDTH)[:] = waypoint
        trajectory = self.memory.now.trajectory
        state.header["index"] = index
        state.header["future_collision_seq"] = self.memory.now.epoch
        if trajectory is not None:
            state.header["trajectory_seq"] = trajectory.header["trajectory_seq"]
        self.memory.published = state
        return state

    def _hold(self, turn: float = 0.0) -> State:
        """Hold at the predicted rest position; `turn`: yaw offset to look around (rad)."""
        waypoint = np.zeros(POINT_WIDTH)
        lag = self._config.velocity_lag if not self._governed else 0.0
        waypoint[:3] = self.memory.odometry[:3] + lag * self.memory.odometry[3:6]
        waypoint[3] = yaw_of(self.memory.odometry[6:10]) + turn
        waypoint[10] = self._config.autopilot.point_period
        return self._publish(-1, waypoint)
