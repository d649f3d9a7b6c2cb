"""The detector of a mission, by name: it must have been trained for what is flown."""

from pathlib import Path

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.detectors.limits import MissionLimits
from mavfi.detectors.registry import load_detector, mission_keys
from mavfi.hosts.loop.scheduler import CONTROL_PERIOD_US
from mavfi.mission import MissionSpec, Scenario
from mavfi.platforms.compute import latency, stage_latency
from mavfi.sim.environments import World, build_world
from mavfi.states import Stage

_ERROR_STEP = 0.6
"""Largest change of the tracker's position error between two control periods (m)."""


def detector_for(
    scenario: Scenario, name: str, profile: str, models_dir: Path | None = None
) -> tuple[Detector, str]:  # fmt: skip
    """Load a detector for a mission.

    Args:
        scenario: The mission.
        name: Entry point of the group mavfi.detectors, or "package:Class".
        profile: "paper" or "tuned".
        models_dir: Folder of trained models; None = the shipped ones.

    Returns:
        The detector, and the sha256 of its trained model ("" where it has none).

    Raises:
        BadInputError: No such detector, profile or model.
        SpecMismatchError: The model was trained for something else.
    """
    world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
    fits = {
        "stack": scenario.stack.name,
        "platform": scenario.platform.name,
        "v_max": scenario.v_max,
        "planner": scenario.planner.name,
        "limits": limits_of(scenario, world),
        "seed": scenario.seed,
    }
    return load_detector(name, profile, models_dir, fits)


def with_keys_of(spec: MissionSpec, name: str) -> MissionSpec:
    """A mission with the keys that go with a detector, as far as they are not chosen."""
    fields = MissionSpec.model_fields
    keys = {key: value for key, value in mission_keys(name).items() if getattr(spec, key) == fields[key].default}
    return spec.model_copy(update=keys)


def limits_of(scenario: Scenario, world: World) -> MissionLimits:
    """What rules hold the publications of a mission to."""
    stack, platform = scenario.stack, scenario.platform
    period = 1e-6 * CONTROL_PERIOD_US
    p, i, d = (max(map(abs, gains)) for gains in (stack.gain_p, stack.gain_i, stack.gain_d))
    return MissionLimits(
        v_max=scenario.v_max, a_max=scenario.a_max, arena=(_corner(world.arena_lower), _corner(world.arena_upper)),
        flight=(_corner(world.flight_lower), _corner(world.flight_upper)), goal=_corner(world.goal),
        held=stack.sampling == "held", every_map=stack.replanning == "every_map", point_period=stack.point_period,
        control_period=period, look_ahead=stack.look_ahead, planner_latency=1e-6 * latency(platform, "planner"),
        plan_latency=1e-6 * stage_latency(platform, Stage.PLANNING), velocity_lag=1.0 / scenario.vehicle.velocity_gain,
        command_limit=stack.command_limit, command_step=_ERROR_STEP * (p + i * period + 2.0 * d / period),
        slowdown_cap=stack.slowdown_cap, tracker_slowdown=platform.tracker_slowdown, camera_range=scenario.camera.range,
        repeated=stack.alarm == "repeated",
    )  # fmt: skip


def _corner(values: np.ndarray) -> tuple[float, ...]:
    return tuple(map(float, values))
