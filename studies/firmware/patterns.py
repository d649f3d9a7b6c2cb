"""Short flights of a firmware without the pipeline, hover and square, and what a register fault does to them."""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mavfi.extras.firmware.controller import BetaflightController
from mavfi.extras.firmware.injector import FirmwareInjector
from mavfi.extras.registers.classes import class_of, function_of
from mavfi.extras.registers.fault import RegisterFault
from mavfi.flight.compose import resolve
from mavfi.mission import MissionSpec
from mavfi.outcomes import LOST_TILT, ControlEffect
from mavfi.record import Injection
from mavfi.sim.environments import build_world
from mavfi.sim.scene import STEP_US
from mavfi.sim.simulator import Simulator

LENGTH_S = 10.0
"""Length of a flight (s)."""
FIRST_S = 2.0
LAST_S = 6.0
"""Faults are injected in between (s): after the vehicle has settled, early enough to see what follows."""
LEG_S = 2.0
"""Time on each side of the square (s)."""
TURN_S = 0.5
"""Time after a corner that counts as turning (s)."""
SLIGHT_M = 0.02
"""Distance from the golden flight up to which the effect is slight (m)."""
LOST_M = 5.0
"""Distance from the golden flight beyond which control counts as lost (m), as beyond `LOST_TILT`."""
_SIDES = ((3.0, 0.0, 0.0, 0.0), (0.0, 3.0, 0.0, 0.5), (-3.0, 0.0, 1.0, 0.0), (0.0, -3.0, -1.0, -0.5))
PATTERNS = {"hover": ((0.0, 0.0, 0.0, 0.0),), "square": _SIDES}
"""Commands of each pattern, one after the other: velocity (m/s) and yaw rate (rad/s)."""
_MISSION = MissionSpec(environment="farm", seed=1, start=(5.0, 0.0, 8.0), flight_controller="betaflight")
OUTCOMES = tuple(effect.value for effect in ControlEffect)
"""What a fault does to a flight, from harmless to worst."""
_IDENTICAL, _SLIGHT, _DEGRADED, _LOST, _ENDS, _HANGS = OUTCOMES


@dataclass(frozen=True, slots=True)
class PatternFlight:
    """A flight.

    Attributes:
        positions: Every 4 ms (m); shorter if it ended early. Shape (n, 3).
        largest_tilt: Largest angle between the body's and the world's z axis (rad).
        touched: Whether it touched the ground or an obstacle, or is not finite.
        firmware_end: Effect and detail of the end of the firmware; "" = it runs.
        digest: SHA-256 of all states.
        injection: The injection; None = no fault.
    """

    positions: np.ndarray
    largest_tilt: float
    touched: bool
    firmware_end: tuple[str, str]
    digest: str
    injection: Injection | None


def fly(pattern: str, fault: RegisterFault | None = None) -> PatternFlight:
    """Fly a pattern for `LENGTH_S`, or until the vehicle touches the ground or the firmware is lost."""
    scenario = resolve(_MISSION)
    plant = Simulator(build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal), scenario)
    controller = plant.controller
    assert isinstance(controller, BetaflightController)  # as the mission says
    injector = None
    if fault is not None:
        injector = FirmwareInjector(fault)
    controller.injector = injector

    # fly until the pattern, the vehicle or the firmware ends
    states = []
    try:
        for state in _states(plant, pattern):
            states.append(state)
            if controller.loss is not None:
                break
    finally:
        plant.close()

    # what the flight was like
    rows = np.array(states)
    firmware_end = ("", "")
    if controller.loss is not None:
        firmware_end = (controller.loss.effect, controller.loss.detail)
    injection = None
    if injector is not None:
        injection = injector.finish()[0]
    up = 1.0 - 2.0 * (rows[:, 7] ** 2 + rows[:, 8] ** 2)  # z component of the body's z axis
    tilt = float(np.arccos(np.clip(np.nan_to_num(up, nan=-1.0), -1.0, 1.0)).max())
    return PatternFlight(
        rows[:, :3],
        tilt,
        plant.collided or not np.isfinite(rows).all(),
        firmware_end,
        hashlib.sha256(rows.tobytes()).hexdigest(),
        injection,
    )


def _states(plant: Simulator, pattern: str) -> Iterator[np.ndarray]:
    """State of the vehicle every 4 ms."""
    commands = PATTERNS[pattern]
    leg_us = round(1e6 * LEG_S)
    for time_us in range(0, round(1e6 * LENGTH_S), STEP_US):
        if time_us % leg_us == 0:
            plant.command(np.array(commands[time_us // leg_us % len(commands)]), 2.0 * LEG_S)
        plant.advance(time_us + STEP_US)
        yield plant.odometry.copy()
        if plant.collided or not np.isfinite(plant.odometry).all():
            return


def outcome(golden: PatternFlight, flight: PatternFlight) -> str:
    """What the fault did to a flight, one of `OUTCOMES`."""
    effect_on_firmware, _ = flight.firmware_end
    if effect_on_firmware == "hang":
        return _HANGS
    if effect_on_firmware:
        return _ENDS
    if flight.digest == golden.digest:
        return _IDENTICAL
    deviation_m = distance(golden, flight)
    if flight.touched or deviation_m > LOST_M or flight.largest_tilt > LOST_TILT:
        return _LOST
    if deviation_m <= SLIGHT_M:
        return _SLIGHT
    return _DEGRADED


def distance(golden: PatternFlight, flight: PatternFlight) -> float:
    """Largest distance from the golden flight at the same instant (m)."""
    count = min(len(golden.positions), len(flight.positions))
    return float(np.linalg.norm(golden.positions[:count] - flight.positions[:count], axis=1).max())


def phase(pattern: str, injection: Injection) -> str:
    """Phase of the flight at the injection: hover; turning after a corner, or straight."""
    if len(PATTERNS[pattern]) == 1:
        return pattern
    if injection.time_s % LEG_S < TURN_S:
        return "turning"
    return "straight"


def to_json(pattern: str, golden: PatternFlight, flight: PatternFlight) -> dict[str, Any]:
    """The row of a ledger."""
    assert flight.injection is not None  # a flight with a fault
    injection = flight.injection
    return {
        "pattern": pattern,
        "outcome": outcome(golden, flight),
        "activated": injection.activated,
        "distance_m": distance(golden, flight),
        "tilt_deg": math.degrees(flight.largest_tilt),
        "lost": flight.firmware_end,
        "digest": flight.digest,
        "register_class": class_of(injection.site),
        "function": function_of(str(injection.details.get("symbol", ""))),
        "phase": phase(pattern, injection),
        "injection": asdict(injection),
    }
