"""Scaling of a golden mission's wall time with world, map and camera, and of throughput with workers; with figure."""

import os
import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from benchmarks.depth import posts
from benchmarks.rows import Row
from mavfi.campaign.executors.executor import map_each
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.config import CameraConfig, MapConfig
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec
from mavfi.report.style import BLUE, GREY, ORANGE, house_style
from tools.results import RESULTS

FIGURE = RESULTS / "growth.png"
SEEDS = range(3)
BOXES = (10, 30, 100, 300, 1000)
RESOLUTIONS = (1.0, 0.5, 0.35, 0.25, 0.2)
WIDTHS = (32, 64, 96, 128, 160)
FLIGHTS = 40


class Point(NamedTuple):
    """One point of a curve: the varied parameter, wall time and flight time (s)."""

    x: float
    wall: float
    flown: float


def curve(values: tuple[Any, ...], change: Callable[[Any], dict[str, Any]]) -> list[Point]:
    """Golden missions in `sparse`, profile `published`, with one varied parameter; medians over seeds."""
    points = []
    for value in values:
        walls, flown = [], []
        for seed in SEEDS:
            scenario = resolve(MissionSpec(environment="sparse", seed=seed)).model_copy(update=change(value))
            start = time.perf_counter()
            log = fly(scenario).log
            walls.append(time.perf_counter() - start)
            flown.append(float(log.rows[-1, 0]))
        points.append(Point(float(value), statistics.median(walls), statistics.median(flown)))
    return points


def curves() -> dict[str, list[Point]]:
    """The three curves of a single mission, by varied parameter."""
    return {
        "boxes": curve(BOXES, lambda count: {"environment": posts(count)}),
        "map resolution (m)": curve(RESOLUTIONS, lambda edge: {"map": MapConfig(resolution=edge)}),
        "pixels across": curve(WIDTHS, lambda width: {"camera": CameraConfig(width=width, height=3 * width // 4)}),
    }


def fly_seed(seed: int) -> str:
    """One mission of the worker pool."""
    return fly(resolve(MissionSpec(environment="sparse", seed=seed))).log.digest()


def spin(_: int) -> int:
    """Pure computation, to measure the machine's own scaling limit."""
    total = 0
    for i in range(3_000_000):
        total += i
    return total


def rate(workers: int, job: Callable[[int], Any], count: int) -> float:
    """Throughput of a worker pool (jobs/s)."""
    start = time.perf_counter()
    done = list(map_each(LocalExecutor(workers), job, range(count)))
    return len(done) / (time.perf_counter() - start)


def scaling() -> list[tuple[int, float, float]]:
    """Number of workers, missions per second, and throughput of pure computations relative to one worker."""
    found, alone = [], 0.0
    for workers in range(1, (os.cpu_count() or 1) + 1):
        spins = rate(workers, spin, FLIGHTS)  # the same number of jobs, for the same share of pool start-up
        alone = alone or spins
        found.append((workers, rate(workers, fly_seed, FLIGHTS), spins / alone))
    return found


def draw(single: dict[str, list[Point]], pool: list[tuple[int, float, float]]) -> None:
    """Write the figure."""
    with house_style():
        figure = Figure(figsize=(11.5, 2.9), layout="constrained")
        panels = figure.subplots(1, 4)
        for axes, (name, points) in zip(panels, single.items(), strict=False):
            axes.plot([p.x for p in points], [1e3 * p.wall for p in points], "o-", color=BLUE, markersize=4)
            axes.set(xscale="log", ylim=(0, None), xlabel=name, xticks=[p.x for p in points])
            axes.set_xticklabels([f"{p.x:g}" for p in points], fontsize=8)
            axes.minorticks_off()
            axes.grid(axis="y")
        boxes = single["boxes"]
        level = [1e3 * p.wall * boxes[0].flown / p.flown for p in boxes]
        panels[0].plot([p.x for p in boxes], level, "--", color=GREY, label="per same time flown")
        panels[0].legend(labelcolor=GREY, loc="upper left")
        panels[0].set(ylabel="wall time of a mission (ms)", title="Obstacles")
        panels[1].set(title="Map")
        panels[1].invert_xaxis()
        panels[2].set(title="Camera")
        workers = [n for n, _, _ in pool]
        panels[3].plot(workers, [r for _, r, _ in pool], "o-", color=BLUE, markersize=4, label="missions")
        panels[3].plot(
            workers, [pool[0][1] * share for _, _, share in pool], "--", color=ORANGE, label="this machine's ceiling"
        )
        panels[3].set(title="Workers", xlabel="workers", ylabel="missions / s", ylim=(0, None), xticks=workers)
        panels[3].legend(labelcolor=GREY, loc="lower right")
        panels[3].grid(axis="y")
        figure.savefig(FIGURE, dpi=160)


def growth_rows() -> list[Row]:
    """Rows of the speed table; also writes the figure."""
    single, pool = curves(), scaling()
    draw(single, pool)
    rows = [
        Row(
            f"mission against {name}",
            ", ".join(f"{p.x:g}: {1e3 * p.wall:.0f} ms ({p.flown:.0f} s flown)" for p in points),
        )
        for name, points in single.items()
    ]
    one = pool[0][1]
    text = ", ".join(
        f"{n}: {missions:.1f} ({missions / one:.2f} x; pure computation {share:.2f} x)" for n, missions, share in pool
    )
    return [*rows, Row(f"missions per second against workers, {FLIGHTS} in sparse", text)]
