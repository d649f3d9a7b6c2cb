"""The detector of a mission, by name: it must have been trained for what is flown."""

from pathlib import Path

from mavfi.detectors.detector import Detector
from mavfi.detectors.registry import load_detector
from mavfi.mission import Scenario
from mavfi.sim.environments import build_world


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
        "arena": (world.arena_lower.tolist(), world.arena_upper.tolist()),
    }
    return load_detector(name, profile, models_dir, fits)
