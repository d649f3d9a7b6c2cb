"""What a server's world and vehicle are: our server reports it among its settings, and our pipeline compares it."""

import json
from typing import Any

from mavfi.mission import Scenario
from mavfi.sim.environments.world import World

KEY = "Mavfi"
"""Key of the report in the settings that `getSettingsString` returns; AirSim's own settings have none."""


def identity(scenario: Scenario, world: World, *, in_flight: bool = True) -> dict[str, Any]:
    """What must be the same for a flight on a server to be the flight without one.

    Args:
        scenario: The mission.
        world: Its world.
        in_flight: Whether the vehicle starts in the air; one on the ground has a height and a speed limit of its own.

    Returns:
        Environment and vehicle by name, seed, wind (m/s, amplitude of gusts), start (x, y, m), goal (m), height of the
        start (m), speed limit (m/s).
    """
    found = {
        "environment": scenario.environment.name, "seed": scenario.seed, "vehicle": scenario.vehicle.name,
        "wind": scenario.wind.gust, "start": world.start[:2].tolist(), "goal": world.goal.tolist(),
    }  # fmt: skip
    return {**found, "height": float(world.start[2]), "v_max": scenario.v_max} if in_flight else found


def reported(settings: Any) -> dict[str, Any]:  # noqa: ANN401 - a server's
    """The report in a server's settings (JSON); empty if there is none, as from AirSim itself."""
    try:
        found = json.loads(settings)[KEY]
    except (KeyError, TypeError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def difference(there: dict[str, Any], here: dict[str, Any]) -> str:
    """In what a server's report differs from the flight's identity, in words; "" = in nothing."""
    keys = [key for key in here if key in there and there[key] != here[key]]
    if not keys:
        return ""
    theirs, ours = (", ".join(f"{key} {_text(one[key])}" for key in keys) for one in (there, here))
    return f"it has {theirs}; this flight has {ours}"


def _text(value: Any) -> str:  # noqa: ANN401 - a server's
    """A name, a number, or a place."""
    if isinstance(value, list):
        return " ".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
