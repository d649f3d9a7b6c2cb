"""Fly error-free missions in all settings, and write docs/results/golden-rates.md: how often they arrive, and how well.

    N=60 HARD_N=100 make results NAME=golden-rates

N: flights per setting of the paper's worlds (300); HARD_N: per other setting (100).  Seeds follow each other from 10000
on, none is left out; autopilot profiles are tuned on lower seeds.
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from importlib.metadata import version
from typing import Any

import numpy as np

from mavfi.analysis.statistics import wilson
from mavfi.analysis.table import NUMBER, RATE, Column, Table
from mavfi.campaign.executors.executor import map_each
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec, MissionStatus
from tools import results
from tools.markers import ROOT

PAGE = "golden-rates"
FIRST_SEED = 10_000
WORLDS = ("factory", "farm", "sparse", "dense")
PLANNERS = ("rrt_connect", "rrt_star", "rrt")
PROFILES = ("published", "hardened")
TEXT = (
    "Without a fault, missions arrive: all of 300 in each of the paper's worlds, with each planner and either "
    "autopilot profile (the paper's: 95 and 85 % in sparse and dense). There `hardened` keeps within 0.7 m of its "
    "reference, `published` within 2.1 m; of the harder settings only `clutter` at 5 m/s is lost now and then."
)
COLUMNS = (
    Column("environment", "environment"),
    Column("autopilot", "autopilot"),
    Column("planner", "planner"),
    Column("platform", "platform"),
    Column("v_max", "v_max", "number g"),
    Column("arrived", "arrived, %", RATE),
    Column("time_median", "flight time (s), median", "number .1f"),
    Column("time_p95", "p95", "number .1f"),
    Column("time_max", "max", "number .1f"),
    Column("closest", "closest (m)", "number .2f"),
    Column("replans_median", "replans, median", "number g"),
    Column("replans_max", "replans, max", NUMBER),
    Column("failed_plans", "failed plans", NUMBER),
    Column("alarms", "alarms, median", "number g"),
    Column("off_reference", "off reference (m)", "number .2f"),
    Column("speed", "speed / v_max", "number .3f"),
    Column("warnings", "warnings", NUMBER),
    Column("lost_seeds", "seeds that did not arrive"),
)
NOTES = (
    "closest: smallest distance between the vehicle (collision radius 0.35 m) and the nearest true obstacle or the "
    "ground, over all flights; below 0 is a contact",
    "replans: plans after the first; alarms: collisions that the check predicted; off reference: largest distance "
    "between vehicle and reference; flight times: of flights that arrived; 95 % intervals: Wilson",
)
SHOWN = (
    "environment",
    "autopilot",
    "v_max",
    "arrived, %",
    "flight time (s), median",
    "closest (m)",
    "off reference (m)",
)


@dataclass(frozen=True, slots=True)
class GoldenFlight:
    """Summary of one flight; distances in m, times in s."""

    seed: int
    arrived: bool
    time_s: float
    clearance_m: float
    tracking_m: float
    speed_share: float
    plans: int
    failed_plans: int
    alarms: int
    warnings: int


def settings() -> list[tuple[str, MissionSpec]]:
    """All rows: the variable that gives the number of flights, and the mission without its seed."""
    paper = [
        {"environment": world, "autopilot": autopilot, "planner": planner}
        for autopilot in PROFILES
        for planner in PLANNERS
        for world in WORLDS
    ]
    hard: list[dict[str, Any]] = [
        {"environment": "clutter", "autopilot": "hardened", "v_max": 5.0},
        {"environment": "dense30", "autopilot": "hardened", "v_max": 5.0},
        {"environment": "dense", "autopilot": "hardened", "platform": "cortex-a57"},
        {"environment": "dense", "autopilot": "hardened", "depth_noise": 0.02},
        {"environment": "dense", "autopilot": "hardened", "map_resolution": 0.25},
        *({"environment": "dense", "autopilot": autopilot, "wind": 3.0} for autopilot in PROFILES),
        *({"environment": "dense", "autopilot": autopilot, "localization": "estimator"} for autopilot in PROFILES),
    ]
    rows = [("N", keys) for keys in paper] + [("HARD_N", keys) for keys in hard]
    return [(kind, MissionSpec.model_validate({"v_max": 3.0, **keys})) for kind, keys in rows]


def name_of(mission: MissionSpec) -> str:
    """The environment, and all deviations from defaults."""
    parts = [mission.environment]
    if mission.depth_noise:
        parts.append(f"depth noise {100 * mission.depth_noise:g} %")
    if mission.map_resolution:
        parts.append(f"map of {mission.map_resolution:g} m")
    if mission.wind:
        parts.append(f"wind gusts of {mission.wind:g} m/s")
    if mission.localization != "truth":
        parts.append(f"{mission.localization} on")
    return ", ".join(parts)


def measure(mission: MissionSpec) -> GoldenFlight:
    """Fly one error-free mission, and evaluate its quality against the true world."""
    scenario = resolve(mission)
    flight = fly(scenario)
    log = flight.log
    position = log.columns("x", "y", "z")
    reference = log.columns("reference_x", "reference_y", "reference_z")
    speed = np.linalg.norm(log.columns("vx", "vy", "vz"), axis=1)
    return GoldenFlight(
        seed=mission.seed,
        arrived=log.status is MissionStatus.SUCCESS,
        time_s=float(log.column("time")[-1]),
        clearance_m=float(flight.world.clearance(position).min()) - scenario.vehicle.collision_radius,
        tracking_m=float(np.linalg.norm(position - reference, axis=1).max()),
        speed_share=float(speed.max()) / scenario.v_max,
        plans=log.count("plan"),
        failed_plans=log.count("plan_failed"),
        alarms=log.count("collision_predicted"),
        warnings=log.count("warning"),
    )


def row(mission: MissionSpec, flights: Sequence[GoldenFlight]) -> tuple[Any, ...]:
    """The cells of a setting, in the order of `COLUMNS`."""
    # times are of flights that arrived; without any they are absent
    times = [flight.time_s for flight in flights if flight.arrived]
    lost = [flight.seed for flight in flights if not flight.arrived]
    replans = [max(flight.plans - 1, 0) for flight in flights]
    median_time = None
    percentile_time = None
    longest_time = None
    if times:
        median_time = float(np.median(times))
        percentile_time = float(np.percentile(times, 95))
        longest_time = max(times)

    # the setting, then what was measured, over all flights
    return (
        name_of(mission),
        mission.autopilot,
        mission.planner,
        mission.platform,
        mission.v_max,
        wilson(len(times), len(flights)),
        median_time,
        percentile_time,
        longest_time,
        min(flight.clearance_m for flight in flights),
        float(np.median(replans)),
        max(replans),
        sum(flight.failed_plans for flight in flights),
        float(np.median([flight.alarms for flight in flights])),
        max(flight.tracking_m for flight in flights),
        max(flight.speed_share for flight in flights),
        sum(flight.warnings for flight in flights),
        " ".join(map(str, lost)),
    )


def write_page(rows: Sequence[tuple[Any, ...]], about: Sequence[str]) -> None:
    """Write the page from the cells of all settings."""
    full = Table(PAGE, "Golden rates, all settings", COLUMNS, rows, keys=4, notes=NOTES)

    def is_shown(cells: results.Row) -> bool:
        is_default = cells["platform"] == "i9-9940x" and "," not in cells["environment"]
        return is_default and cells["planner"] == "rrt_connect"

    excerpt = results.Excerpt("settings", is_shown, SHOWN)
    page = results.write(PAGE, "Golden rates", TEXT, {"settings": full}, [excerpt], about)
    print(f"wrote {page.relative_to(ROOT)}")


def main() -> int:
    """Fly, print, write; returns the exit code."""
    counts = {"N": int(os.environ.get("N") or 300), "HARD_N": int(os.environ.get("HARD_N") or 100)}
    executor = LocalExecutor(os.cpu_count() or 1)
    rows = []
    for kind, mission in settings():
        missions = [mission.model_copy(update={"seed": seed}) for seed in range(FIRST_SEED, FIRST_SEED + counts[kind])]
        flights = [flight for _, flight in map_each(executor, measure, missions)]
        rows.append(row(mission, sorted(flights, key=lambda flight: flight.seed)))
        print(*rows[-1][:5], rows[-1][5], flush=True)
    versions = ", ".join(f"{name} {version(name)}" for name in ("mavfi", "numba", "numpy", "mujoco-core"))
    write_page(rows, [f"flown on {date.today()}: {versions}; seeds from {FIRST_SEED}"])
    return 0


if __name__ == "__main__":
    sys.exit(main())
