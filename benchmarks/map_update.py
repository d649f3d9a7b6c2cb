"""Speed of a map update: both map kinds against OctoMap's own library, on the point clouds of one golden flight."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.rows import Row
from mavfi.config import MapConfig
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.kernels.perception import octomap
from mavfi.mission import MissionSpec
from mavfi.pipeline.maps import MAPS
from mavfi.states import State, floats

Insert = Callable[[np.ndarray, np.ndarray], Any]
TARGETS = {0.5: 7.0, 0.25: 15.0}
"""Target speed-up of the dense map over the library, by resolution (m)."""
REPEATS = 3
LIBRARY = "octomap-python (one thread)"


def recorded(resolution: float) -> tuple[Any, Any, list[tuple[np.ndarray, np.ndarray]]]:
    """Scenario of a flight, the key frame of its map, and its scans."""
    scenario = resolve(MissionSpec(environment="dense", seed=1, map_resolution=resolution))
    scans: list[tuple[np.ndarray, np.ndarray]] = []

    def watch(state: State, _time_us: int) -> None:
        if state.spec.name == "perception.point_cloud":
            points = state.elements.view(np.float32).reshape(-1, 3).copy()
            scans.append((points, floats(state.header, 3).copy()))

    flight: Any = fly(scenario, recorders=[watch])
    return scenario, flight.pipeline["octomap"].frame, scans


def library_insert(rule: MapConfig, max_range: float) -> Insert | None:
    """The library's scan insertion, with coordinates shifted to its grid; None = not installed."""
    try:
        import octomap as library
    except ImportError:
        return None
    tree = library.OcTree(rule.resolution)
    tree.setProbHit(rule.hit)
    tree.setProbMiss(rule.miss)
    tree.setClampingThresMin(rule.clamp_min)
    tree.setClampingThresMax(rule.clamp_max)
    half = 0.5 * rule.resolution

    def insert(points: np.ndarray, origin: np.ndarray) -> None:
        tree.insertPointCloud(points.astype(float) + half, origin + half, max_range)

    return insert


def binding_cost(rule: MapConfig, max_range: float, scans: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Cost of the library's binding per scan (s): the same calls with all points at the sensor, i.e. without rays."""
    insert = library_insert(rule, max_range)
    if insert is None:
        return np.inf
    at_sensor = [(np.broadcast_to(origin, points.shape), origin) for points, origin in scans]
    return min(per_scan(insert, at_sensor) for _ in range(REPEATS))


def per_scan(insert: Insert, scans: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Mean wall time per scan of a flight (s)."""
    start = time.perf_counter()
    for points, origin in scans:
        insert(points, origin)
    return (time.perf_counter() - start) / len(scans)


def rule_of(config: MapConfig) -> octomap.UpdateRule:
    """The update rule of a configuration."""
    chances = config.hit, config.miss, config.clamp_min, config.clamp_max
    return octomap.UpdateRule(*(octomap.log_odds(chance) for chance in chances))


def measured(resolution: float) -> tuple[dict[str, float], float, int]:
    """Wall time per scan by map kind (s), inf = not installed; the library's binding cost; and number of scans."""
    scenario, frame, scans = recorded(resolution)
    reach, rule = scenario.camera.range, rule_of(scenario.map)
    best = dict.fromkeys((*MAPS, LIBRARY), np.inf)
    for repeat in range(1 + REPEATS):  # repeat 0 compiles
        for name in best:
            insert = library_insert(scenario.map, reach) if name == LIBRARY else MAPS[name](frame, rule, reach).insert
            if insert is not None:
                wall = per_scan(insert, scans if repeat else scans[:1])
                best[name] = min(best[name], wall) if repeat else np.inf
    return best, binding_cost(scenario.map, reach, scans), len(scans)


def map_rows() -> list[Row]:
    """Rows of the speed table."""
    rows = []
    for resolution, target in TARGETS.items():
        best, binding, scans = measured(resolution)
        for name, seconds in best.items():
            value = f"{1e3 * seconds:.2f} ms" if seconds < np.inf else "not installed"
            ratio = best[LIBRARY] / seconds if name != LIBRARY and best[LIBRARY] < np.inf else None
            if ratio is not None:
                value += f", {ratio:.1f} x as fast as {LIBRARY}"
            elif seconds < np.inf:
                value += f", of which {1e3 * binding:.2f} ms to hand the points over"
            what = f"map update, {name}, {resolution} m, mean of {scans} scans"
            rows.append(Row(what, value, ratio, target if name == "dense" else None))
    return rows
