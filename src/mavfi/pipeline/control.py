"""Control: the tracker (MAVFI section III-A, kernel "PID")."""

import numpy as np

from mavfi.kernels.control import pid
from mavfi.kernels.planning.trajectory import POINT_WIDTH
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.states import Stage, State, floats, new_state

MAX_YAW_RATE = 1.5707963267948966
"""90 deg/s, as the published code (rad/s)."""


class Tracker:
    """Kernel `pid`; stepped at the control period."""

    name = "pid"
    stage = Stage.CONTROL
    writes = ("control.command", "control.tracking")
    not_memory = ("_dt", "_slowdown", "_gains", "_track")

    def __init__(self, config: PipelineConfig) -> None:
        self.reads = ("planning.waypoint", config.odometry)
        stack = config.stack
        self._track = config.functions.track
        self._dt = 1e-6 * config.control_period_us
        self._slowdown = config.tracker_slowdown
        held = stack.sampling == "held"
        self._gains = pid.Gains(
            np.array(stack.gain_p), np.array(stack.gain_i), np.array(stack.gain_d), stack.integral_limit,
            stack.velocity_feed_forward / (config.tracker_slowdown if held else 1.0), stack.acceleration_feed_forward,
            stack.command_limit * config.v_max, stack.slowdown_cap, MAX_YAW_RATE,
        )  # fmt: skip
        self._memory = np.zeros(pid.MEMORY_WIDTH)
        self._remaining = 0.0
        self._waypoint: np.ndarray | None = None
        self._fresh = False
        self._marked: tuple[np.ndarray, float, bool, np.ndarray | None] = (self._memory.copy(), 0.0, False, None)
        self._odometry = np.zeros(13)

    def receive(self, state: State, time_us: int) -> bool:
        """Note an input; steps are due at the control period only."""
        del time_us
        if state.spec.name == "planning.waypoint":
            self._waypoint = floats(state.header, POINT_WIDTH)
            self._fresh = True
        else:
            self._odometry = floats(state.header, 13)
        return False

    def step(self, time_us: int) -> list[State]:
        """Command that brings the vehicle to the way-point in force."""
        del time_us
        command, tracking = new_state("control.command"), new_state("control.tracking")
        values = floats(command.header, 5)
        values[4] = self._dt
        if self._waypoint is None:
            return [command, tracking]
        if self._fresh:
            # the overrun of the last point is subtracted from this one
            carry = self._remaining if -self._dt <= self._remaining <= 0.0 else 0.0
            self._remaining = float(self._waypoint[10]) + carry
            self._fresh = False
        slowdown = self._track(self._waypoint, self._odometry, self._memory, self._gains, self._dt, values[:4])
        self._remaining -= self._dt / (slowdown * self._slowdown)
        tracking.header["remaining"] = self._remaining
        return [command, tracking]

    def mark(self) -> None:
        """Remember the memory as it is."""
        self._marked = (self._memory.copy(), self._remaining, self._fresh, self._waypoint)

    def rollback(self) -> None:
        """Restore the memory; a way-point that came since is new to it."""
        memory, self._remaining, fresh, waypoint = self._marked
        self._fresh = fresh or self._waypoint is not waypoint
        self._memory[:] = memory
