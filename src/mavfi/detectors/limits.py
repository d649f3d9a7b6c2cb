"""Mission-dependent limits for the rules of physics and protocol."""

from dataclasses import dataclass

import numpy as np

from mavfi.detectors.gate import SPEED_MARGIN, UNKNOWN_ARENA

Corner = tuple[float, ...]
"""Corner of a box (m)."""

BOX_MARGIN = 2.0
"""Distance beyond the flight box at which a plan may start: a mission's start, or a vehicle pushed out (m)."""
NEAR = 4.0
"""Smallest bound on the distance between vehicle and start of a plan, or goal and its end (m): the planner searches for
free space within 3 m."""
_ROUNDING = 1.001
"""Largest commanded speed / its limit: the limit is computed with rounding."""
_CURVE_ERROR = 0.1
"""Position error of a trajectory point at constant velocity, since curves are sampled (m)."""
_ACCELERATION_MARGIN = 1.2
"""Largest acceleration between points of a trajectory / a_max."""
_SHARPEST = 0.2
"""Length within which an interpolated trajectory may reverse: a plan entered at speed leaves its first corner as sharp
as the available space requires (m)."""
_CLOCK_MARGIN = 1.5
"""Largest acceleration due to a change of the reference clock's rate / a_max."""
_SHORTEST_ALARM = 30.0
"""`time_to_collision` without a collision (s); others lie within the camera range, flown at a quarter of v_max."""
_SLOW = 0.25
"""Speed at which the camera range is flown / v_max."""
_TRAVEL_MARGIN = 1.5
"""Largest speed while a plan is made / v_max."""
_ENTRY_TIME = 0.1
"""Time in addition to the latency of planning in which the speed at the entry of a path may change (s)."""
_LEAST_ENTRY = 1.0
"""Smallest bound on that change (m/s)."""

# Names of the numbers in the record: scalars, points (m) and flags.
_SCALARS = (
    "speed",
    "command",
    "command_step",
    "acceleration",
    "clock",
    "point_period",
    "control_period",
    "longest_time",
    "near",
    "entry",
    "step",
    "change",
    "lag",
    "hold",
    "slowest",
    "fastest",
)
"""Numbers of the record, see `MissionLimits.numbers`."""
_PLACES = ("lower", "upper", "goal")
"""Points of the record (m)."""
_FLAGS = ("held", "every_map", "repeated")
"""Flags of the record."""
NUMBERS = np.dtype(
    [*((name, "f8") for name in _SCALARS), *((name, "f8", (3,)) for name in _PLACES), *((name, "?") for name in _FLAGS)]
)
"""Type of the record read by compiled rules."""


@dataclass(frozen=True, slots=True)
class MissionLimits:
    """Limits of one mission, from its scenario and world.

    Attributes:
        v_max: Speed limit (m/s).
        a_max: Acceleration limit (m/s^2).
        arena: Lower and upper corner of the mapped volume (m).
        flight: Lower and upper corner of the box that bounds paths (m).
        goal: Position of the goal (m).
        held: Whether way-points are points of the trajectory, each in force for its duration; if not, they are
            interpolated in every control period.
        every_map: Whether plans are checked and made for every map; if not, on each newly predicted collision.
        point_period: Time between trajectory points (s).
        control_period: Time between commands (s).
        look_ahead: Look-ahead of a point's velocity (s).
        planner_latency: Least time from request to path (s).
        plan_latency: Longest time from request to trajectory (s).
        velocity_lag: Time constant of the vehicle's velocity loop (s).
        command_limit: Largest command / v_max.
        command_step: Largest change of the command between periods under the same way-point (m/s).
        slowdown_cap: Largest slow-down of the reference time under a saturated command.
        tracker_slowdown: Loop time of the tracker / reference time that it advances.
        camera_range: Range of the camera (m).
        repeated: Whether the collision check repeats alarms until they are answered.
        fix_noise: Standard deviations of a fix (m, rad), as the estimator assumes them; None = the odometry is the
            truth.
    """

    v_max: float
    a_max: float
    flight: tuple[Corner, Corner]
    goal: Corner
    held: bool
    every_map: bool
    point_period: float
    control_period: float
    look_ahead: float
    planner_latency: float
    plan_latency: float
    velocity_lag: float
    command_limit: float = 1.0
    command_step: float = 0.3
    slowdown_cap: float = 1.0
    tracker_slowdown: float = 1.0
    camera_range: float = 20.0
    repeated: bool = False
    arena: tuple[Corner, Corner] = UNKNOWN_ARENA
    fix_noise: tuple[float, float] | None = None

    def numbers(self) -> np.ndarray:
        """Limits as the record read by compiled rules. Shape (1,)."""
        record = np.zeros(1, NUMBERS)
        # What the vehicle flies while a plan is made (m), and how much a velocity changes between points (m/s).
        travel = _TRAVEL_MARGIN * self.v_max * (self.velocity_lag + 2.0 * self.plan_latency)
        change = _ACCELERATION_MARGIN * self.a_max * self.point_period
        if not self.held:
            change += 2.0 * self.v_max * min(1.0, self.v_max * self.point_period / _SHARPEST)
        # A hold is at the place where the vehicle comes to rest, which only the profile of held points predicts (s).
        lag = 0.0
        if self.held:
            lag = self.velocity_lag
        values = {
            "speed": SPEED_MARGIN * self.v_max,
            "command": _ROUNDING * self.command_limit * self.v_max,
            "acceleration": change / self.point_period,
            "clock": _CLOCK_MARGIN * self.a_max,
            "lower": np.array(self.flight[0]) - BOX_MARGIN,
            "upper": np.array(self.flight[1]) + BOX_MARGIN,
            "longest_time": max(_SHORTEST_ALARM, self.camera_range / (_SLOW * self.v_max)),
            "near": max(NEAR, travel),
            "entry": max(_LEAST_ENTRY, self.a_max * (self.plan_latency + _ENTRY_TIME)),
            "step": self.a_max * self.look_ahead * self.point_period + _CURVE_ERROR,
            "change": change,
            "lag": lag,
            "hold": SPEED_MARGIN * self.v_max * self.control_period,
            "slowest": self.control_period / (self.slowdown_cap * self.tracker_slowdown),
            "fastest": self.control_period / self.tracker_slowdown,
        }
        for name in NUMBERS.names or ():  # the others are attributes
            if name in values:
                record[name] = values[name]
            else:
                record[name] = getattr(self, name)
        return record
