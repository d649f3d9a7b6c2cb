"""Measures speed, prints a table, writes benchmarks/results.md.  Ratios are taken within one run on one machine."""

import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from map_update import map_rows
from mavfi.campaign.executors.local import LocalPool
from mavfi.detectors import load_detector
from mavfi.hosts.compose import make_scenario
from mavfi.hosts.inprocess import Flight, fly
from mavfi.states import State
from planners import nearest_rows, search_rows

SEEDS = range(20)
POOL_FLIGHTS = 60
FITS = {"stack": "published", "platform": "i9-9940x", "v_max": 3.0, "planner": "rrt_connect"}
Row = tuple[str, str]


def timed(action: Callable[[], Any]) -> tuple[float, Any]:
    """Wall time of one call (s), and its result."""
    start = time.perf_counter()
    result = action()
    return time.perf_counter() - start, result


def golden(environment: str, stack: str) -> tuple[float, float]:
    """Median wall time of a golden mission (s), and how many times faster than real time."""
    walls, flown = [], 0.0
    for seed in SEEDS:
        scenario = make_scenario(environment, seed, stack=stack)
        wall, flight = timed(lambda scenario=scenario: fly(scenario))
        walls.append(wall)
        flown += float(flight.log.rows[-1, 0])
    return statistics.median(walls), flown / sum(walls)


def fly_seed(seed: int) -> str:
    """One mission of the pool benchmark."""
    return fly(make_scenario("sparse", seed)).log.digest()


def pool(workers: int) -> float:
    """Missions per second of a pool."""
    wall, _ = timed(lambda: list(LocalPool(workers).run(fly_seed, range(POOL_FLIGHTS))))
    return POOL_FLIGHTS / wall


def spin(_: int) -> int:
    """Pure computation, for the machine's own ceiling."""
    total = 0
    for i in range(3_000_000):
        total += i
    return total


def ceiling() -> float:
    """How much faster two processes compute than one on this machine, whatever they compute."""
    one, _ = timed(lambda: list(LocalPool(1).run(spin, range(8))))
    two, _ = timed(lambda: list(LocalPool(2).run(spin, range(8))))
    return one / two


def prompt_to_prompt() -> float:
    """Wall time of `mavfi fly` with a warm cache (s)."""
    command = [str(Path(sys.executable).with_name("mavfi")), "fly", "--environment", "sparse", "--seed", "7", "--json"]
    return min(timed(lambda: subprocess.run(command, check=True, capture_output=True))[0] for _ in range(3))


class Stopwatch:
    """A detector around another that adds up the time it takes."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner
        self.seconds = 0.0

    def start(self) -> None:
        """Passed on."""
        self._inner.start()

    def check(self, state: State, time_us: int) -> Any:
        """Passed on, timed."""
        wall, alarm = timed(lambda: self._inner.check(state, time_us))
        self.seconds += wall
        return alarm

    def accept(self, state: State, time_us: int) -> None:
        """Passed on, timed."""
        self.seconds += timed(lambda: self._inner.accept(state, time_us))[0]


def kernel_seconds(flight: Callable[[], Flight]) -> tuple[float, dict[str, float]]:
    """Wall time of a flight, and of each kernel's steps in it (s)."""
    from mavfi.hosts import inprocess

    spent: dict[str, float] = {}
    build = inprocess.build_pipeline

    def build_timed(config: Any) -> Any:
        kernels = build(config)
        for kernel in kernels.values():
            for name in ("step", "receive"):
                _time_method(kernel, name, spent)
        return kernels

    inprocess.build_pipeline = build_timed
    try:
        wall, _ = timed(flight)
    finally:
        inprocess.build_pipeline = build
    return wall, spent


def _time_method(kernel: Any, name: str, spent: dict[str, float]) -> None:
    method = getattr(kernel, name)

    def wrapped(*arguments: Any) -> Any:
        start = time.perf_counter()
        try:
            return method(*arguments)
        finally:
            spent[kernel.name] = spent.get(kernel.name, 0.0) + time.perf_counter() - start

    setattr(kernel, name, wrapped)


def detection_rows() -> list[Row]:
    """Time of detection against the time of the kernels, both measured here."""
    scenario = make_scenario("sparse", 7)
    rows = []
    _, spent = kernel_seconds(lambda: fly(scenario))
    kernels = sum(spent.values())
    for name in ("gaussian", "autoencoder"):
        watch = Stopwatch(load_detector(name, "paper", None, FITS)[0])
        fly(scenario, None, watch)
        share = 100.0 * watch.seconds / kernels
        rows.append((f"detection, {name} / kernels, both measured", f"{share:.1f} % ({1e3 * watch.seconds:.0f} ms)"))
    order = sorted(spent, key=spent.__getitem__, reverse=True)
    shares = ", ".join(f"{name} {100 * spent[name] / kernels:.0f} %" for name in order)
    return [("share of kernel time", shares), *rows]


def measure() -> list[Row]:
    """All rows."""
    fly(make_scenario("sparse", 0))  # compiles, or reads the cache
    rows: list[Row] = []
    for environment in ("sparse", "dense", "factory", "farm"):
        for stack in ("published", "hardened"):
            wall, factor = golden(environment, stack)
            rows.append(
                (f"golden {environment}, {stack}, median of {len(SEEDS)}", f"{wall:.3f} s, {factor:.0f} x real time")
            )
    one, two = pool(1), pool(2)
    rows.append(
        (f"missions per hour, 1 worker / 2 workers ({POOL_FLIGHTS} sparse)", f"{3600 * one:.0f} / {3600 * two:.0f}")
    )
    rows.append(("two workers / one", f"{two / one:.2f} (the machine's own ceiling: {ceiling():.2f})"))
    rows.append(("mavfi fly, prompt to prompt, warm cache", f"{prompt_to_prompt():.2f} s"))
    return rows + map_rows() + search_rows() + nearest_rows() + detection_rows()


def processor() -> str:
    """Name of the processor, as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def main() -> None:
    """Measure, print, write."""
    rows = measure()
    versions = ", ".join(f"{name} {version(name)}" for name in ("mavfi", "numba", "numpy", "mujoco-core"))
    head = f"{date.today()} · {processor()}, {os.cpu_count()} cores · Python {platform.python_version()} · {versions}"
    lines = [f"| {what} | {value} |" for what, value in rows]
    page = "\n".join(
        ["# Speed", "", f"Measured by `make bench`: {head}.", "", "| what | value |", "|---|---|", *lines, ""]
    )
    Path(__file__).with_name("results.md").write_text(page, encoding="utf-8")
    for what, value in rows:
        sys.stdout.write(f"{what:60s} {value}\n")
    sys.stdout.write(json.dumps({"load": np.round(os.getloadavg(), 2).tolist()}) + "\n")


if __name__ == "__main__":
    main()
