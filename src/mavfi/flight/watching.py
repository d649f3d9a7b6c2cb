"""Loading of a mission's detector by name, with a check that its model was trained for this mission."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.config import parse
from mavfi.detectors.detector import Detector
from mavfi.detectors.limits import MissionLimits
from mavfi.detectors.registry import Loaded, load_detector, mission_keys
from mavfi.flight.compose import noise_of
from mavfi.flight.compute import latency, stage_latency
from mavfi.flight.loop import CONTROL_PERIOD_US
from mavfi.mission import MissionSpec, Scenario
from mavfi.sim.environments import World, build_world
from mavfi.states import Stage

_ERROR_STEP = 0.6
"""Largest change of the tracker's position error between two control periods (m)."""


def detector_for(
    scenario: Scenario, name: str, profile: str, models_dir: Path | None = None, trained_for: str = "",
    options: Mapping[str, Any] | None = None,
) -> Loaded:  # fmt: skip
    """Load a detector for a mission.

    Args:
        scenario: The mission.
        name: Entry point of the group mavfi.detectors, or "package:Class".
        profile: "paper" or "tuned".
        models_dir: Folder of trained models; None = the shipped models.
        trained_for: "autopilot/platform" whose model is used though it was not trained for this mission; "" = the
            mission's own, which must fit.
        options: Options of the detector, over those of its file and profile.

    Raises:
        BadInputError: The detector, profile or model does not exist.
        SpecMismatchError: The model was trained for a different configuration.
    """
    world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
    mission = {
        "stack": scenario.autopilot.name,
        "platform": scenario.platform.name,
        "v_max": scenario.v_max,
        "planner": scenario.planner.name,
        "limits": limits_of(scenario, world),
        "seed": scenario.seed,
    }
    return load_detector(name, profile, models_dir, mission, options=options, trained_for=trained_for)


def with_keys_of(spec: MissionSpec, detector: str | Detector) -> MissionSpec:
    """The mission with the detector's recommended keys, apart from those that the user has set.

    Raises:
        BadInputError: A value of these is not allowed.
    """
    given = {key: getattr(spec, key) for key in spec.model_fields_set}
    name = detector if isinstance(detector, str) else type(detector).__name__
    return parse(MissionSpec, {**mission_keys(detector), **given}, f"detector {name!r}: recovery")


def limits_of(scenario: Scenario, world: World) -> MissionLimits:
    """Limits of a mission's publications, as rule-based detectors check them."""
    autopilot, platform = scenario.autopilot, scenario.platform
    period = 1e-6 * CONTROL_PERIOD_US
    noise = noise_of(scenario.localization)
    p, i, d = (max(map(abs, gains)) for gains in (autopilot.gain_p, autopilot.gain_i, autopilot.gain_d))
    return MissionLimits(
        v_max=scenario.v_max, a_max=scenario.a_max, arena=(_corner(world.arena_lower), _corner(world.arena_upper)),
        flight=(_corner(world.flight_lower), _corner(world.flight_upper)), goal=_corner(world.goal),
        held=autopilot.sampling == "held", every_map=autopilot.replanning == "every_map",
        point_period=autopilot.point_period, control_period=period, look_ahead=autopilot.look_ahead,
        planner_latency=1e-6 * latency(platform, "planner"),
        plan_latency=1e-6 * stage_latency(platform, Stage.PLANNING), velocity_lag=1.0 / scenario.vehicle.velocity_gain,
        command_limit=autopilot.command_limit, command_step=_ERROR_STEP * (p + i * period + 2.0 * d / period),
        slowdown_cap=autopilot.slowdown_cap, tracker_slowdown=platform.tracker_slowdown,
        camera_range=scenario.camera.range, repeated=autopilot.alarm == "repeated",
        fix_noise=None if noise is None else (noise.position, noise.heading),
    )  # fmt: skip


def _corner(values: np.ndarray) -> tuple[float, ...]:
    return tuple(map(float, values))
