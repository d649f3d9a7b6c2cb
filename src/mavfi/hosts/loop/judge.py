"""The mission's status, judged at every control period."""

import math
from dataclasses import dataclass

from mavfi.hosts.loop.plant import Plant
from mavfi.mission import ARRIVAL_RADIUS, FLY_AWAY_MARGIN, MissionStatus, Scenario, time_limit
from mavfi.sim.environments import World


@dataclass(slots=True)
class Judge:
    """What ends a mission: goal, arena (world frame, m), failed plans in a row, and the longest flight (us)."""

    goal: list[float]
    lower: list[float]
    upper: list[float]
    max_failed_plans: int
    limit_us: int

    @staticmethod
    def of(scenario: Scenario, world: World) -> "Judge":
        """The limits of a mission."""
        limit = time_limit(world.course, scenario.v_max, scenario.platform)
        corners = world.arena_lower.tolist(), world.arena_upper.tolist()
        return Judge(world.goal.tolist(), *corners, scenario.stack.max_failed_plans, int(1e6 * limit))

    def status(self, plant: Plant, failed_plans: int, now: int) -> MissionStatus | None:
        """The final status; None = the mission continues."""
        state = plant.odometry.tolist()  # NumPy would take longer to start than to run, fifty times a second
        if not all(map(math.isfinite, state)):
            return MissionStatus.INVALID_STATE
        if plant.collided:
            return MissionStatus.COLLISION
        if math.dist(state[:3], self.goal) < ARRIVAL_RADIUS:
            return MissionStatus.SUCCESS
        if any(
            max(low - value, value - high) > FLY_AWAY_MARGIN
            for low, value, high in zip(self.lower, state[:3], self.upper, strict=True)
        ):
            return MissionStatus.FLY_AWAY
        if failed_plans > self.max_failed_plans:
            return MissionStatus.NO_PATH
        return MissionStatus.TIMEOUT if now >= self.limit_us else None
