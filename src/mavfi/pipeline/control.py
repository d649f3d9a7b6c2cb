"""Control: the tracker (MAVFI section III-A, kernel "PID")."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mavfi.kernels.control import pid
from mavfi.kernels.planning.trajectory import POINT_WIDTH
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.memory import Memory, Remembers, zeros
from mavfi.states import Stage, State, floats, new_state

MAX_YAW_RATE = 1.5707963267948966
"""90 deg/s, as the published code (rad/s)."""


@dataclass(slots=True)
class _TrackerMemory(Memory):
    """Controller memory, remaining time of the way-point in force, inputs, and their values at the mark."""

    law: np.ndarray = zeros(pid.MEMORY_WIDTH)
    remaining: float = 0.0
    waypoint: State | None = None
    fresh: bool = False
    odometry: np.ndarray = zeros(13)
    marked: tuple[np.ndarray, float, bool, State | None] = field(
        default_factory=lambda: (np.zeros(pid.MEMORY_WIDTH), 0.0, False, None)
    )


class Tracker(Remembers):
    """Kernel `pid`: the tracker, stepped at the control period."""

    name = "pid"
    stage = Stage.CONTROL
    writes = ("control.command", "control.tracking")
    memory: _TrackerMemory

    def __init__(self, config: PipelineConfig) -> None:
        self.reads = ("planning.waypoint", config.odometry)
        autopilot = config.autopilot
        self._track = config.functions.track
        self._dt = 1e-6 * config.control_period_us
        self._slowdown = config.tracker_slowdown
        feed_forward = autopilot.velocity_feed_forward
        if autopilot.sampling == "held":
            feed_forward /= config.tracker_slowdown  # the reference advances more slowly
        self._gains = pid.Gains(
            np.array(autopilot.gain_p),
            np.array(autopilot.gain_i),
            np.array(autopilot.gain_d),
            autopilot.integral_limit,
            feed_forward,
            autopilot.acceleration_feed_forward,
            autopilot.command_limit * config.v_max,
            autopilot.slowdown_cap,
            MAX_YAW_RATE,
        )
        self.memory = _TrackerMemory()

    def receive(self, state: State, time_us: int) -> bool:
        """Store an input; steps are due only at the control period."""
        if state.spec.name == "planning.waypoint":
            self.memory.waypoint = state
            self.memory.fresh = True
        else:
            self.memory.odometry = floats(state.header, 13)
        return False

    def step(self, time_us: int) -> list[State]:
        """Compute the command that steers the vehicle to the way-point in force."""
        command = new_state("control.command")
        tracking = new_state("control.tracking")
        values = floats(command.header, 5)
        values[4] = self._dt
        memory = self.memory
        if memory.waypoint is None:
            return [command, tracking]
        waypoint = floats(memory.waypoint.header, POINT_WIDTH)
        if memory.fresh:
            overrun = 0.0  # of the last point, subtracted from this one
            if -self._dt <= memory.remaining <= 0.0:
                overrun = memory.remaining
            memory.remaining = float(waypoint[10]) + overrun
            memory.fresh = False
        slowdown = self._track(waypoint, memory.odometry, memory.law, self._gains, self._dt, values[:4])
        memory.remaining -= self._dt / (slowdown * self._slowdown)
        tracking.header["remaining"] = memory.remaining
        return [command, tracking]

    def mark(self) -> None:
        """Save the current memory for `rollback`."""
        memory = self.memory
        memory.marked = (memory.law.copy(), memory.remaining, memory.fresh, memory.waypoint)

    def rollback(self) -> None:
        """Restore the memory of the mark; a way-point received since then counts as new."""
        memory = self.memory
        law, memory.remaining, fresh, waypoint = memory.marked
        memory.fresh = fresh or memory.waypoint is not waypoint
        memory.law[:] = law

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """Restore the remaining time of the way-point in force, which does not count as new."""
        tracking = last.get("control.tracking")
        waypoint = last.get("planning.waypoint")
        if tracking is None or waypoint is None:
            return ()
        self.receive(waypoint, time_us)
        self.memory.remaining = tracking.value("remaining")
        self.memory.fresh = False
        return ("planning.waypoint",)
