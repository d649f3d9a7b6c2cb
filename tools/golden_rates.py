"""Flies golden missions in all settings and writes docs/generated/golden-rates.md.

    N=60 HARD_N=100 SCAN_N=20 WORKERS=1 ONLY=clutter python -m tools.golden_rates

N: flights per setting with a bar of 300 (300); HARD_N: per other setting (100); SCAN_N: per setting in the scanned
corridor (20); ONLY: flies only rows whose command contains this word (other rows keep the values of
out/golden-rates.json; a word without matches rewrites the page without flying); RESUME=1: keeps rows that have as many
flights of the same versions.  Results are saved after each row.
"""

import json
import os
import sys
import time
from collections.abc import Iterable
from dataclasses import asdict
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mavfi.mission import MissionSpec
from mavfi.reports.text import markdown_grid
from tools.build_fault_map import FAULT_MAP, key_lines
from tools.golden import EVALUATION_SEED, Bar, GoldenFlight, Row, Setting, fly_row
from tools.markers import GENERATED, ROOT, banner, between

PAGE = GENERATED / "golden-rates.md"
RECORD = ROOT / "out" / "golden-rates.json"
"""All flights of all rows, so that rows can be flown separately."""
SCAN = "../shared/data/geb079.bt"
"""A scanned corridor, relative to the root of the repository; without it, its rows are omitted."""
_ENDS = (-5.0, 0.0, 1.2), (27.0, 0.0, 1.2)
_WORLDS = ("factory", "farm", "sparse", "dense")
PLANNERS = ("rrt_connect", "rrt_star", "rrt")
_PAPER = (100, 100, 95, 85)
"""Success rates of the paper's golden flights (%)."""

PAPER = [
    *(
        Setting.of(world, "published", planner=planner, least=least)
        for planner in PLANNERS
        for world, least in zip(_WORLDS, _PAPER, strict=True)
    ),
    *(
        Setting.of(
            world, "hardened", planner=planner, least=100 if planner != "rrt" else None, quality=planner != "rrt"
        )
        for planner in PLANNERS
        for world in _WORLDS
    ),
]
HARD = [
    Setting.of("clutter", "hardened", v_max=5.0, least=97),
    Setting.of("dense30", "hardened", v_max=5.0, least=99),
    Setting.of("dense", "hardened", platform="cortex-a57", least=99),
]
REPORTED = [
    Setting.of("dense", "hardened", depth_noise=0.02),
    Setting.of("dense", "hardened", map_resolution=0.25),
    *(Setting.of("dense", autopilot, wind=3.0) for autopilot in ("published", "hardened")),
    *(Setting.of("dense", autopilot, localization="estimator") for autopilot in ("published", "hardened")),
]
CORRIDOR = [
    Setting.of(SCAN, autopilot, v_max=0.6, start=start, goal=goal)
    for autopilot in ("published", "hardened")
    for start, goal in (_ENDS, _ENDS[::-1])
]

HEAD = """# Golden rates

Error-free flights: how often they arrive, and how well they fly. `make golden-rates` flies them (N=... flights of each
setting with a bar of 300, HARD_N=... of the other settings, SCAN_N=... in the scanned corridor). Seeds
follow each other from {seed} on; none is left out. Autopilot profiles are tuned on seeds below
10000.

- *closest*: smallest distance between the vehicle (collision radius 0.35 m, in the corridor 0.06 m) and the nearest
  true obstacle or the ground, over all flights; below 0 is a contact.
- *replans*: plans after the first, median and largest. *alarms*: collisions that the check predicted, median.
- *off reference*: largest distance between vehicle and reference. *speed*: largest, as a share of v_max.
- Intervals: Wilson, 95 %. Flight times: of flights that arrived.
"""
FAULTS = """## What faults do to the same code

A change of a rule that makes golden flights better by hiding faults would show here: rows of the
[fault map](fault-map.md), which `make fault-map` flies again after each change.

<!-- faults:begin -->
<!-- faults:end -->
"""
BLIND = """In the corridor the way back (x 27 → -5 m) starts 0.2 m above an obstacle that lies 68° below the horizontal.
The camera sees down to 37°, so the obstacle is not in the map, and planners take unknown space for free: a path that
descends at once touches it, or passes it by centimetres, at any seed.
"""
COLUMNS = (
    "environment", "autopilot", "planner", "platform", "v_max", "arrived", "95 %", "wanted", "flight time (s): median",
    "p95", "max", "limit (s)", "closest (m)", "replans", "failed plans", "alarms", "off reference (m)", "speed",
    "warnings",
)  # fmt: skip


def wanted_flights() -> dict[str, int]:
    """Number of flights by kind of setting, from environment variables."""
    return {name: int(os.environ.get(name, default)) for name, default in (("N", 300), ("HARD_N", 100), ("SCAN_N", 20))}


def settings(scan: bool) -> Iterable[tuple[Setting, str]]:
    """All rows, each with the variable that gives its number of flights.

    Args:
        scan: Whether the scanned corridor is available.
    """
    kinds = [("N", PAPER), ("HARD_N", [*HARD, *REPORTED]), ("SCAN_N", CORRIDOR if scan else [])]
    return [(setting, kind) for kind, own in kinds for setting in own]


def median(values: list[int]) -> str:
    """Median, without a decimal if it is an integer."""
    ordered = sorted(values)
    middle = (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2
    return f"{middle:g}"


def name_of(setting: Setting) -> str:
    """The environment, and all deviations from defaults."""
    mission = setting.mission
    parts = [Path(mission.environment).stem]
    if mission.depth_noise:
        parts.append(f"depth noise {100 * mission.depth_noise:g} %")
    if mission.map_resolution:
        parts.append(f"map of {mission.map_resolution:g} m")
    if mission.wind:
        parts.append(f"wind gusts of {mission.wind:g} m/s")
    if mission.localization != "truth":
        parts.append(f"{mission.localization} on")
    if mission.start and mission.goal:
        parts.append(f"x {mission.start[0]:g} → {mission.goal[0]:g} m")
    return ", ".join(parts)


def cells(row: Row) -> list[str]:
    """One line of the table."""
    setting, flights, rate = row.setting, row.flights, row.success
    mission = setting.mission
    times = row.flight_times()
    return [
        name_of(setting), mission.autopilot, mission.planner, mission.platform, f"{mission.v_max:g}",
        f"{rate.successes}/{rate.n}",
        f"{100 * (rate.low or 0.0):.1f}–{100 * (rate.high or 0.0):.1f}",
        "—" if setting.least is None else f"≥ {setting.least:g} %",
        *(["—"] * 3 if times is None else (f"{t:.1f}" for t in times)),
        f"{max(f.limit_s for f in flights):.0f}", f"{min(f.clearance_m for f in flights):.2f}",
        f"{median([max(f.plans - 1, 0) for f in flights])} / {max(f.plans for f in flights) - 1}",
        str(sum(f.failed_plans for f in flights)), median([f.alarms for f in flights]),
        f"{max(f.tracking_m for f in flights):.2f}", f"{max(f.speed_share for f in flights):.3f}",
        str(sum(f.warnings for f in flights)),
    ]  # fmt: skip


def bar_lines(rows: list[Row]) -> list[str]:
    """The requirements by row, each with its measured value and verdict."""
    found = [(row, {bar.name: bar for bar in row.bars()}) for row in rows if row.bars()]
    every = [bar for _, own in found for bar in own.values()]
    names = list(dict.fromkeys(bar.name for bar in every))
    lines = []
    for row, own in found:
        mission = row.setting.mission
        first = (name_of(row.setting), mission.autopilot, mission.planner)
        lines.append((*first, *(_verdict(own.get(n)) for n in names)))
    grid = markdown_grid(("environment", "autopilot", "planner", *names), lines)
    return [f"{sum(bar.met for bar in every)} of {len(every)} bars are met.", "", grid]


def _verdict(bar: Bar | None) -> str:
    if bar is None:
        return "—"
    return f"{bar.measured} ({bar.wanted}): {'met' if bar.met else '**not met**'}"


def failure(row: Row, flight: GoldenFlight) -> str:
    """Description of one failed flight."""
    x, y, z = flight.position
    mission = row.setting.mission
    return (
        f"- {name_of(row.setting)}, {mission.autopilot}, {mission.planner}, seed {flight.seed}: "
        f"**{flight.status}** after {flight.time_s:.1f} s at ({x:g}, {y:g}, {z:g}) m; {flight.cause}; "
        f"{flight.plans} plans, {flight.failed_plans} failed, closest {flight.clearance_m:.2f} m; "
        f"last: {flight.events}. `{row.setting.command(flight.seed)}`"
    )


def page(stored: list[dict[str, Any]], faults: str) -> str:
    """The page from the stored measurements.

    Args:
        stored: Rows with their flights, as in the record file.
        faults: Key lines of the fault map.
    """
    rows = [as_row(entry) for entry in stored]
    runs = sorted({f"{entry['date']} ({entry['versions']})" for entry in stored})
    parts = [banner("make golden-rates") + HEAD.format(seed=EVALUATION_SEED), "Measured: " + "; ".join(runs) + ".", ""]
    parts += [markdown_grid(COLUMNS, map(cells, rows)), ""]
    scanned = any(row.setting.mission.environment == SCAN for row in rows)
    if not scanned:
        parts += ["The scanned corridor was not there; its rows are left out.", ""]
    parts += ["## Bars", "", *bar_lines(rows), "", between(FAULTS, "faults", faults)]
    lost = [failure(row, flight) for row in rows for flight in row.failures()]
    parts += ["## Flights that did not arrive", "", *([BLIND] if scanned else []), *(lost or ["None."]), ""]
    return "\n".join(parts)


def plain(setting: Setting) -> Any:
    """A setting in JSON form."""
    return {"mission": setting.mission.model_dump(mode="json"), "least": setting.least, "quality": setting.quality}


def as_row(entry: dict[str, Any]) -> Row:
    """Inverse of the stored form of a row."""
    kept = entry["setting"]
    setting = Setting(MissionSpec.model_validate(kept["mission"]), kept["least"], kept["quality"])
    return Row(
        setting, tuple(GoldenFlight(**flight | {"position": tuple(flight["position"])}) for flight in entry["flights"])
    )


def versions() -> str:
    """Versions that determine the bits of a flight."""
    return ", ".join(f"{name} {version(name)}" for name in ("mavfi", "numba", "numpy", "mujoco-core"))


def fly_all(names: str, resume: bool, workers: int, scan: bool) -> list[dict[str, Any]]:
    """Fly the selected rows; the others keep their stored measurements.

    Args:
        names: Word that the command of a selected row contains.
        resume: Whether complete rows are kept.
        workers: Number of processes.
        scan: Whether the scanned corridor is available.
    """
    before = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.is_file() else []
    counts, here = wanted_flights(), versions()
    stored: list[dict[str, Any]] = []
    rows = list(settings(scan))
    for place, (setting, kind) in enumerate(rows):
        old = next((entry for entry in before if entry["setting"] == plain(setting)), None)
        complete = old is not None and len(old["flights"]) >= counts[kind] and old["versions"] == here
        if names not in setting.command(0) or (resume and complete):
            stored += [old] if old is not None else []
            continue
        stored.append(fly_one(setting, counts[kind], workers) | {"versions": here})
        later = [entry for entry in before if entry["setting"] in [plain(other) for other, _ in rows[place + 1 :]]]
        RECORD.parent.mkdir(exist_ok=True)
        RECORD.write_text(json.dumps([*stored, *later]) + "\n", encoding="utf-8")
    return stored


def fly_one(setting: Setting, count: int, workers: int) -> dict[str, Any]:
    """Fly one row, and print its result."""
    start = time.perf_counter()
    row = fly_row(setting, count, workers)
    sys.stdout.write(f"{' | '.join(cells(row))}  {time.perf_counter() - start:.0f} s\n")
    for bar in row.bars():
        sys.stdout.write(f"  {bar.name} {bar.wanted}: {bar.measured}: {'met' if bar.met else 'NOT MET'}\n")
    for flight in row.failures():
        sys.stdout.write(f"  {failure(row, flight)}\n")
    sys.stdout.flush()
    flights = [asdict(flight) for flight in row.flights]
    return {"setting": plain(setting), "flights": flights, "date": date.today().isoformat()}


def main() -> int:
    """Fly, print, write; returns the exit code."""
    os.chdir(ROOT)  # the scan's path in commands is relative to the root
    scan = Path(SCAN).is_file()
    if not scan:
        sys.stdout.write(f"{SCAN}: not there; the rows of the scanned corridor are left out\n")
    workers = int(os.environ.get("WORKERS", str(os.cpu_count() or 1)))
    try:
        stored = fly_all(os.environ.get("ONLY", ""), os.environ.get("RESUME", "") == "1", workers, scan)
    except KeyboardInterrupt:
        sys.stderr.write("Stopped. Rows that are done are kept; RESUME=1 continues.\n")
        return 130
    faults = key_lines(FAULT_MAP.read_text(encoding="utf-8"))
    sys.stdout.write(f"\nWhat faults do (docs/generated/fault-map.md):\n\n{faults}\n\n")
    PAGE.write_text(page(stored, faults), encoding="utf-8")
    sys.stdout.write(f"wrote {PAGE.relative_to(ROOT)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
