"""A mission, and everything that decides its golden flight: `Scenario`.  Its ends: `MissionStatus`."""

import hashlib
import json
from enum import Enum
from typing import Any

from mavfi.config import (
    CameraConfig,
    Config,
    EnvironmentConfig,
    LocalizationConfig,
    MapConfig,
    PlannerConfig,
    PlatformConfig,
    StackConfig,
    Vector,
    VehicleConfig,
    WindConfig,
)

ARRIVAL_RADIUS = 2.0
"""Distance from the goal that counts as arrival (m)."""
FLY_AWAY_MARGIN = 30.0
"""Distance outside of the arena that ends a flight (m)."""
TIME_LIMIT_FACTOR = 4.5
"""Time limit / (course / v_max)."""


class MissionStatus(Enum):
    """How a flight ended; the value is a sentence for people."""

    SUCCESS = "Reached the goal."
    COLLISION = "Touched an obstacle or the ground."
    FLY_AWAY = "Left the arena."
    TIMEOUT = "Did not reach the goal in time."
    NO_PATH = "Found no path to the goal."
    INVALID_STATE = "The state of the vehicle is not finite."

    @property
    def label(self) -> str:
        """Lower-case name, as in tables and JSON."""
        return self.name.lower()


_OPTIONS = ("wind", "localization")


class Scenario(Config):
    """Everything that decides a golden flight; a flight is a pure function of it (and of a fault and a detector)."""

    environment: EnvironmentConfig
    seed: int
    stack: StackConfig
    vehicle: VehicleConfig
    platform: PlatformConfig
    planner: PlannerConfig = PlannerConfig()
    camera: CameraConfig = CameraConfig()
    map: MapConfig = MapConfig()
    v_max: float = 3.0
    a_max: float = 5.0
    start: Vector | None = None
    goal: Vector | None = None
    wind: WindConfig = WindConfig()
    localization: LocalizationConfig = LocalizationConfig()

    def to_json(self) -> dict[str, Any]:
        """Plain data; options that are off are left out, so that a mission without them keeps its key."""
        data = self.model_dump(mode="json")
        for name in _OPTIONS:
            if getattr(self, name) == Scenario.model_fields[name].default:
                del data[name]
        return data

    def key(self) -> str:
        """Hash that identifies the scenario."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()


def time_limit(course: float, v_max: float, platform: PlatformConfig) -> float:
    """Longest flight before it counts as `timeout` (s): 4.5 x course / v_max x the platform's factor.

    Args:
        course: Straight distance from start to goal (m).
        v_max: Speed limit (m/s).
        platform: The modelled computer.
    """
    return TIME_LIMIT_FACTOR * course / v_max * platform.time_limit_factor
