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
from mavfi.pipeline.memory import Memory, Remembers, zeros
from mavfi.pipeline.routes import PLANNING_ACCELERATION
from mavfi.states import Stage, State, floats, new_state, rows

_EMERGENCY_STOP_TIME = 0.6
"""v_max / a_max of the published code (s)."""
_STANDING = 0.4
"""Speed up to which a stopping vehicle counts as standing (m/s)."""
_SPEED_STEP = 1.0
"""Excess of the vehicle's speed over the first point's up to which a trajectory is adopted (m/s)."""
_HOLD_TURN = 0.6
"""Turn while no path exists, to look around (rad)."""
_CREEP_SHARE = 1.0 / 3.0
"""Largest speed of the reference at unknown space / v_max."""
_CREEP_STEP = 0.3
"""Largest distance of the reference between two maps at unknown space (m)."""
_ADOPTION_WINDOW = 50
"""Leading points of a spliced trajectory among which its start is searched for."""

# Tolerances of the plausibility checks: correct trajectories keep well within them.
_SPEED_FACTOR = 1.5
"""Largest speed / v_max."""
_BOX_MARGIN = 2.0
"""Largest distance from the flight box (m)."""
_STEP_MARGIN = 0.3
"""Largest excess of the distance of two points over that flown at the largest speed (m)."""
_MAX_POINT_DURATION = 1.0
"""Largest duration of a point (s)."""


@dataclass(frozen=True, slots=True)
class _InForce(Memory):
    """The trajectory in force and the pending one; replaced, never modified, so that a mark is a reference.

    Attributes:
        trajectory: The one in force; None = none.
        index: Its current point; -1 = none, the vehicle holds.
        waiting: The pending one, adopted when the vehicle is slow enough; None = none.
        last_seq: Sequence number of the last accepted trajectory; -1 = none yet.
        epoch: Sequence number of the alarm that it answers.
        seen_seq: Sequence number of the last alarm.
        stop_us: When the vehicle shall stop (us); -1 = not.
        stopping: Whether it has stopped, or is about to.
        rejected_since: Since when trajectories have been rejected (us); -1 = the last one was accepted.
        clock: Reading of the reference clock (points), its rate and the change of the rate, see `advance_clock`.
    """

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
    """Trajectory in force with its arc lengths, inputs, limits of the known space, and the marks.

    Attributes:
        now: Trajectories and sequence numbers.
        inbox: Trajectories and collision statuses received since the last step.
        odometry: See `Simulator.odometry`. Shape (13,).
        remaining: Remaining time of the point in force (s).
        limits: Distances along the trajectory to blocked and to unknown space (m), and its sequence number.
        points: Points of the trajectory in force. Shape (n, POINT_WIDTH).
        arc: Their arc lengths (m). Shape (n,).
        published: The way-point in force; None = none yet.
        marked: `now` at the last mark.
        marked_inputs: `inbox`, `remaining` and `published` at the last mark.
    """

    now: _InForce = field(default_factory=_InForce)
    inbox: list[State] = field(default_factory=list)
    odometry: np.ndarray = zeros(13)
    remaining: float = 0.0
    limits: tuple[float, float, int] = (np.inf, np.inf, -1)
    points: np.ndarray = zeros(0, POINT_WIDTH)
    arc: np.ndarray = zeros(0)
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
        self._is_interpolated = config.autopilot.sampling == "interpolated"
        self.memory = _SetpointMemory()
        self._creep = min(_CREEP_SHARE * config.v_max, _CREEP_STEP / max(config.map_latency, 1e-3))

    def receive(self, state: State, time_us: int) -> bool:
        """Store an input; steps are due only at the control period."""
        name = state.spec.name
        if name == self._config.odometry:
            self.memory.odometry = floats(state.header, 13)
        elif name == "control.tracking":
            self.memory.remaining = state.value("remaining")
        else:
            self.memory.inbox.append(state)
        return False

    def step(self, time_us: int) -> list[State]:
        """Select the point in force; no output if it is unchanged."""
        inbox = self.memory.inbox
        self.memory.inbox = []
        for state in inbox:
            if state.spec.name == "planning.trajectory":
                self._take_trajectory(state, time_us)
            else:
                self._take_status(state, time_us)
        self._monitor_deviation(time_us)

        # The first that applies: stop, adopt or await a trajectory, hold, or follow the one in force.
        now = self.memory.now
        if 0 <= now.stop_us <= time_us:
            return [self._brake()]
        if now.waiting is not None:
            if self._slow_enough(now.waiting):
                return [self._adopt(now.waiting)]
            if not now.stopping:
                return [self._brake()]
        if self.memory.published is None:
            return [self._hold()]
        if now.trajectory is None:
            return []  # no trajectory: the point in force remains
        if self._is_interpolated:
            return self._interpolated_point()
        return self._held_point()

    def abandon(self, time_us: int) -> list[State]:
        """Skip from the way-point in force to the next one; before any trajectory there is the initial hold only."""
        now = self.memory.now
        if now.trajectory is None:
            published = self.step(time_us)
            if not published and now.last_seq < 0:  # nothing may have been received yet
                published = [self._hold()]
            return published
        if self._is_interpolated:
            position, rate, change = now.clock
            self._set(clock=(position + 1.0, rate, change))
            return self._interpolated_point()
        self.memory.remaining = 0.0
        return self._held_point()

    def stop(self) -> list[State]:
        """Abandon the trajectory and hold position; the planner then replans."""
        self._set(waiting=None)
        return [self._brake()]

    def mark(self) -> None:
        """Save the memory for `rollback`."""
        memory = self.memory
        memory.marked = memory.now
        memory.marked_inputs = (list(memory.inbox), memory.remaining, memory.published)

    def rollback(self) -> None:
        """Restore the memory of the mark, and the inputs that the step consumed."""
        memory = self.memory
        memory.now = memory.marked
        inbox, memory.remaining, memory.published = memory.marked_inputs
        memory.inbox = inbox + memory.inbox
        self._load(memory.now.trajectory)

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """Restore the way-point in force, its sequence numbers and, if it belongs to the last one, its trajectory.

        While the vehicle holds, a trajectory is received again only if it answers a later alarm than the hold does,
        as it may otherwise be the abandoned one.  A planner whose trajectory is not adopted plans again.
        """
        waypoint = last.get("planning.waypoint")
        trajectory = last.get("planning.trajectory")
        if waypoint is None:
            return ()
        last_seq = waypoint.value("trajectory_seq")
        alarm_seq = waypoint.value("future_collision_seq")
        index = waypoint.value("index")
        is_holding = index < 0

        # Whether the last trajectory is known to this node: if so, it is not received again.
        is_known = False
        if trajectory is not None:
            seq = trajectory.value("trajectory_seq")
            if is_holding:
                is_known = trajectory.value("future_collision_seq") <= alarm_seq
            else:
                is_known = seq == last_seq
            if is_known:
                last_seq = seq

        # Continue to fly it; a vehicle that holds continues to hold.
        flown = None
        flown_index = -1
        if is_known and not is_holding:
            flown = trajectory
            flown_index = index
        self.memory.published = waypoint
        self._set(
            trajectory=flown,
            index=flown_index,
            last_seq=last_seq,
            epoch=alarm_seq,
            seen_seq=alarm_seq,
            stopping=is_holding,
            clock=(float(max(index, 0)), 1.0, 0.0),
        )
        self._load(flown)
        if is_known:
            return ("planning.trajectory",)
        return ()

    # ---- sequence numbers -------------------------------------------------------------------------------------------
    def _set(self, **changes: object) -> None:
        """Replace attributes of the trajectories and sequence numbers."""
        self.memory.now = replace(self.memory.now, **changes)  # type: ignore[arg-type]

    def _take_trajectory(self, state: State, time_us: int) -> None:
        """Accept or reject a trajectory by its sequence numbers."""
        now = self.memory.now
        autopilot = self._config.autopilot
        seq = state.value("trajectory_seq")
        alarm_seq = state.value("future_collision_seq")
        # An outdated one is rejected, unless all have been rejected for so long that the numbers must be corrupted.
        if seq < now.last_seq or alarm_seq < now.epoch:
            since = now.rejected_since
            if since < 0:
                since = time_us
            patience = autopilot.epoch_liveness
            if not (patience > 0.0 and time_us - since > 1e6 * patience):
                self._set(rejected_since=since)
                return
        if autopilot.consumer_check and not self._is_plausible(state):
            self._set(stop_us=time_us)
            return
        seen_seq = max(now.seen_seq, alarm_seq)
        self._set(waiting=state, last_seq=seq, epoch=alarm_seq, seen_seq=seen_seq, rejected_since=-1)

    def _take_status(self, state: State, time_us: int) -> None:
        """Respond to a collision status: stop at once, or after the grace period if time permits."""
        if self._is_interpolated:
            blocked = state.value("distance_to_blocked")
            unknown = state.value("distance_to_unknown")
            self.memory.limits = (blocked, unknown, state.value("trajectory_seq"))
            return
        seq = state.value("future_collision_seq")
        now = self.memory.now
        if not state.value("collision") or seq <= now.seen_seq:
            return
        grace = self._config.autopilot.grace
        stop_us = time_us
        if state.value("time_to_collision") > grace + _EMERGENCY_STOP_TIME:
            stop_us += int(1e6 * grace)
        if now.stop_us >= 0:  # an earlier stop is due
            stop_us = min(stop_us, now.stop_us)
        self._set(seen_seq=seq, stop_us=stop_us)

    def _monitor_deviation(self, time_us: int) -> None:
        """Deviation monitor: stop and replan if too far from the reference."""
        limit = self._config.autopilot.deviation_limit
        memory = self.memory
        if limit <= 0.0 or memory.now.trajectory is None or memory.published is None:
            return
        if not length(floats(memory.published.header, 3) - memory.odometry[:3]) < limit:
            self._set(stop_us=time_us)

    def _is_plausible(self, state: State) -> bool:
        """Whether a trajectory passes the plausibility checks, which require no map."""
        points = rows(state.elements, POINT_WIDTH)
        if len(points) == 0:
            return True
        max_speed = _SPEED_FACTOR * self._config.v_max
        lower = self._config.flight_lower - _BOX_MARGIN
        upper = self._config.flight_upper + _BOX_MARGIN
        duration = points[:, 10]
        with np.errstate(over="ignore", invalid="ignore"):
            steps = np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1)
            return bool(
                np.isfinite(points).all()
                and ((duration > 0.0) & (duration <= _MAX_POINT_DURATION)).all()
                and (np.linalg.norm(points[:, 4:7], axis=1) <= max_speed).all()
                and (steps <= max_speed * duration[1:] + _STEP_MARGIN).all()
                and ((points[:, :3] >= lower) & (points[:, :3] <= upper)).all()
            )

    # ---- publications -----------------------------------------------------------------------------------------------
    def _load(self, trajectory: State | None) -> None:
        """Set the points of the trajectory in force and their arc lengths; None changes nothing."""
        if trajectory is None:
            return
        points = rows(trajectory.elements, POINT_WIDTH)
        self.memory.points = points
        self.memory.arc = np.zeros(len(points))
        if len(points):
            setpoint.arc_lengths(points, self.memory.arc)

    def _slow_enough(self, waiting: State) -> bool:
        """Whether a trajectory may be adopted at the current speed."""
        if self._is_interpolated or len(waiting.elements) == 0:
            return True
        speed = length(self.memory.odometry[3:6])
        if self.memory.now.stopping:
            return not speed > _STANDING
        first = length(rows(waiting.elements, POINT_WIDTH)[0, 4:7])
        return not speed > first + _SPEED_STEP

    def _brake(self) -> State:
        """Give the trajectory up, and hold."""
        self._set(trajectory=None, index=-1, stop_us=-1, stopping=True)
        return self._hold()

    def _adopt(self, trajectory: State) -> State:
        """Put the pending trajectory in force, and publish its first point; an empty one usually means to hold."""
        memory = self.memory
        if len(trajectory.elements) == 0:
            if self._is_interpolated and memory.now.trajectory is not None and memory.now.clock[1] > 0.0:
                self._set(waiting=None)  # the current trajectory still leads to a safe stopping point
                return self._interpolated_point()[0]
            self._set(trajectory=None, index=-1, waiting=None)
            return self._hold(turn=_HOLD_TURN)
        self._load(trajectory)
        self._set(trajectory=trajectory, waiting=None, stopping=False, stop_us=-1, index=0, clock=(0.0, 1.0, 0.0))
        if not self._is_interpolated:
            return self._publish(0, memory.points[0])
        start = self._nearest_start()
        self._set(clock=(float(start), 1.0, 0.0), index=start)
        return self._reference(np.array(memory.now.clock))

    def _nearest_start(self) -> int:
        """Point of a spliced trajectory nearest to the reference in force, which has advanced since planning."""
        published = self.memory.published
        if published is None:
            return 0
        window = self.memory.points[:_ADOPTION_WINDOW, :3]
        return int(np.argmin(((window - floats(published.header, 3)) ** 2).sum(1)))

    def _held_point(self) -> list[State]:
        """Publish the next point of the trajectory, once the time of the one in force is over."""
        memory = self.memory
        waypoint = np.zeros(POINT_WIDTH)
        index = setpoint.advance_index(memory.points, memory.now.index, memory.remaining, waypoint)
        if index == memory.now.index:
            return []
        if index >= len(memory.points):
            self._set(trajectory=None, index=-1)
            return [self._hold()]
        self._set(index=index)
        memory.remaining = np.inf  # until the tracker reports on the new point
        return [self._publish(index, waypoint)]

    def _interpolated_point(self) -> list[State]:
        """Advance the reference clock, slower near blocked and unknown space, and publish the point at its reading."""
        memory = self.memory
        config = self._config
        clock = np.array(memory.now.clock)
        blocked, unknown, seq = memory.limits
        trajectory = memory.now.trajectory
        is_outdated = trajectory is not None and seq != trajectory.value("trajectory_seq")
        if is_outdated or not config.autopilot.known_space_limit:
            blocked = unknown = np.inf
        setpoint.advance_clock(
            clock,
            memory.points,
            memory.arc,
            1e-6 * config.control_period_us,
            blocked,
            unknown,
            PLANNING_ACCELERATION,
            self._creep,
            1.0 / config.tracker_slowdown,
        )
        self._set(clock=tuple(clock), index=int(clock[0]))
        return [self._reference(clock)]

    def _reference(self, clock: np.ndarray) -> State:
        """Publish the point of the trajectory at a reading of the reference clock."""
        waypoint = np.zeros(POINT_WIDTH)
        setpoint.reference(clock, self.memory.points, waypoint)
        return self._publish(int(clock[0]), waypoint)

    def _publish(self, index: int, waypoint: np.ndarray) -> State:
        """The way-point with its sequence numbers, which is in force from now on."""
        state = new_state("planning.waypoint")
        now = self.memory.now
        floats(state.header, POINT_WIDTH)[:] = waypoint
        state.header["index"] = index
        state.header["future_collision_seq"] = now.epoch
        if now.trajectory is not None:
            state.header["trajectory_seq"] = now.trajectory.header["trajectory_seq"]
        self.memory.published = state
        return state

    def _hold(self, turn: float = 0.0) -> State:
        """Hold at the predicted rest position; `turn`: yaw offset to look around (rad)."""
        waypoint = np.zeros(POINT_WIDTH)
        odometry = self.memory.odometry
        lag = self._config.velocity_lag
        if self._is_interpolated:
            lag = 0.0
        waypoint[:3] = odometry[:3] + lag * odometry[3:6]
        waypoint[3] = yaw_of(odometry[6:10]) + turn
        waypoint[10] = self._config.autopilot.point_period
        return self._publish(-1, waypoint)
