"""Measures speed, prints a table, writes docs/results/speed.md and growth.png (`make results NAME=speed`).

Ratios are measured within one run on one machine.  Targets are listed with the measurements; missing one is no error,
as times depend on the machine and its load.
"""

import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from datetime import date
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

from benchmarks.depth import depth_rows
from benchmarks.elementary import elementary_rows
from benchmarks.growth import FIGURE, growth_rows
from benchmarks.instruction import instruction_rows
from benchmarks.map_update import map_rows
from benchmarks.planners import nearest_rows, search_rows
from benchmarks.rows import Row
from benchmarks.start import start_rows
from mavfi.analysis.table import Table
from mavfi.campaign.fingerprint import processor
from mavfi.flight.compose import new_loop, resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec, Scenario
from mavfi.pipeline.ppc import build_pipeline
from mavfi.sim.simulator import Simulator
from tools import results

SEEDS = range(20)
MODULES = {"mujoco-core": "mujoco", "octomap-python": "octomap"}
"""Packages whose module name differs."""
PHYSICS, CAMERA = "physics", "camera"
TARGETS = {"sparse": 0.20, "dense": 0.30}
"""Target wall time of a golden mission on one core, profile `published` (s)."""

TEXT = (
    "A mission of half a minute flies in a fifth of a second, 130 to 190 times as fast as real time on one core: "
    "the map is updated 19 times, an image rendered 10 times, a path planned 9 times as fast as by the field's "
    "libraries. Ratios are measured within one run on one machine."
)
SHOWN = (
    "golden sparse, published",
    "golden dense, published",
    "mavfi fly, ",
    "the same with",
    "mavfi fly --fault",
    "mavfi --help",
    "slowest help",
    "map update, dense, 0.5 m",
    "depth image, 200 boxes",
    "rrt_connect, dense, median of 60, OMPL checks segments",
    "nearest of 5000",
    "golden flight / flight",
    "fork, empty report",
    "missions per second against workers",
)
"""Rows of the page; the table has all."""


def timed(action: Callable[[], Any]) -> tuple[float, Any]:
    """Wall time of one call (s), and its result."""
    start = time.perf_counter()
    result = action()
    return time.perf_counter() - start, result


def golden(environment: str, autopilot: str) -> tuple[float, float]:
    """Median wall time of a golden mission (s), and speed relative to real time."""
    walls, flown = [], 0.0
    for seed in SEEDS:
        scenario = resolve(MissionSpec(environment=environment, seed=seed, autopilot=autopilot))
        wall, flight = timed(partial(fly, scenario))
        walls.append(wall)
        flown += float(flight.log.rows[-1, 0])
    return statistics.median(walls), flown / sum(walls)


def part_seconds(scenario: Scenario) -> tuple[float, dict[str, float]]:
    """Wall time of a golden flight, and of each kernel's steps, physics and camera within it (s)."""
    spent: dict[str, float] = {}

    def build_timed(config: Any) -> Any:
        kernels = build_pipeline(config)
        for kernel in kernels.values():
            for name in ("step", "receive"):
                _time_method(kernel, name, kernel.name, spent)
        return kernels

    def simulator_timed(*arguments: Any) -> Any:
        made = Simulator(*arguments)
        _time_method(made, "advance", PHYSICS, spent)
        _time_method(made, "depth", CAMERA, spent)
        return made

    wall, _ = timed(lambda: new_loop(scenario, make_plant=simulator_timed, make_kernels=build_timed).fly())
    return wall, spent


def _time_method(owner: Any, name: str, part: str, spent: dict[str, float]) -> None:
    method = getattr(owner, name)

    def wrapped(*arguments: Any) -> Any:
        start = time.perf_counter()
        try:
            return method(*arguments)
        finally:
            spent[part] = spent.get(part, 0.0) + time.perf_counter() - start

    setattr(owner, name, wrapped)


def share_rows() -> list[Row]:
    """Breakdown of the wall time of a golden mission."""
    rows = []
    for environment in TARGETS:
        for autopilot in ("published", "hardened"):
            scenario = resolve(MissionSpec(environment=environment, seed=7, autopilot=autopilot))
            wall, spent = min((part_seconds(scenario) for _ in range(5)), key=lambda t: t[0])
            spent["host and start"] = wall - sum(spent.values())
            order = sorted(spent, key=spent.__getitem__, reverse=True)
            shares = ", ".join(f"{name} {100 * spent[name] / wall:.0f} %" for name in order)
            rows.append(
                Row(f"share of wall time, {environment}, {autopilot}", f"{shares} (of {wall:.3f} s, with timers)")
            )
    return rows


def measure() -> list[Row]:
    """All rows of the speed table."""
    fly(resolve(MissionSpec(environment="sparse", seed=0)))  # compiles, or loads the cache
    injected = [Row(name, value) for name, value in instruction_rows()]  # first: fork cost grows with process memory
    rows: list[Row] = []
    for environment in ("sparse", "dense", "factory", "farm"):
        for autopilot in ("published", "hardened"):
            wall, factor = golden(environment, autopilot)
            value = f"{wall:.3f} s, {factor:.0f} x real time, {3600 / wall:.0f} missions per core-hour"
            target = TARGETS.get(environment) if autopilot == "published" else None
            rows.append(
                Row(f"golden {environment}, {autopilot}, median of {len(SEEDS)}", value, wall, target, at_most=True)
            )
    rows += start_rows()
    rows += share_rows() + map_rows() + depth_rows() + search_rows() + nearest_rows()
    rows += elementary_rows()
    return rows + injected + growth_rows()


def write_page(rows: Sequence[Row], about: Sequence[str]) -> None:
    """Write the page."""
    cells = [(row.what, row.value, row.verdict) for row in rows]
    full = Table.of_text("All measurements", ("what", "value", "target"), cells, [])
    shown = results.Excerpt("speed", lambda row: row["what"].startswith(SHOWN))
    text = f"{TEXT}\n\n![Growth of wall time]({FIGURE.name})"
    results.write("speed", "Speed", text, {"speed": full}, [shown], about)


def main() -> None:
    """Measure, print, write."""
    start = time.perf_counter()
    rows = measure()
    took = time.perf_counter() - start
    packages = ("mavfi", "numba", "numpy", "mujoco-core", "octomap-python", "ompl")
    versions = ", ".join(f"{name} {version(name)}" for name in packages if find_spec(MODULES.get(name, name)))
    head = f"{date.today()} · {processor()}, {os.cpu_count()} cores · Python {platform.python_version()} · {versions}"
    load = ", ".join(f"{value:.2f}" for value in os.getloadavg())
    about = [f"{head}; measured in {took:.0f} s, load at the end: {load}"]
    write_page(rows, about)
    for row in rows:
        sys.stdout.write(f"{row.what:60s} {row.value}  {row.verdict}\n")
    sys.stdout.write(f"load {load}\n")


if __name__ == "__main__":
    main()
