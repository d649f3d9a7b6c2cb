"""Evaluation of the mission's status at every control period."""

import math

from mavfi.flight.plant import Plant
from mavfi.mission import ARRIVAL_RADIUS, FLY_AWAY_MARGIN, MissionStatus, Scenario, time_limit
from mavfi.sim.environments import World


class Judge:
    """Termination conditions: goal, collision, arena, consecutive failed plans, and the time limit `limit_us` (us)."""

    def __init__(self, scenario: Scenario, world: World) -> None:
        self._goal = world.goal.tolist()
        self._lower, self._upper = world.arena_lower.tolist(), world.arena_upper.tolist()
        self._max_failed_plans = scenario.autopilot.max_failed_plans
        self.limit_us = int(1e6 * time_limit(world.course, scenario.v_max, scenario.platform))

    def status(self, plant: Plant, failed_plans: int, now: int) -> MissionStatus | None:
        """The final status; None = the mission continues."""
        state = plant.odometry.tolist()  # at 13 elements, NumPy's call overhead exceeds the computation
        if not all(map(math.isfinite, state)):
            return MissionStatus.INVALID_STATE
        if plant.collided:
            return MissionStatus.COLLISION
        if math.dist(state[:3], self._goal) < ARRIVAL_RADIUS:
            return MissionStatus.SUCCESS
        for low, value, high in zip(self._lower, state, self._upper, strict=False):  # x, y, z
            if low - value > FLY_AWAY_MARGIN or value - high > FLY_AWAY_MARGIN:
                return MissionStatus.FLY_AWAY
        if failed_plans > self._max_failed_plans:
            return MissionStatus.NO_PATH
        return MissionStatus.TIMEOUT if now >= self.limit_us else None
