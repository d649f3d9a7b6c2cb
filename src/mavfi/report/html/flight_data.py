"""Content of a flight's page as compact plain data: world, paths, markers, time lines."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from mavfi.campaign.divergence import Publication
from mavfi.mission import MissionStatus
from mavfi.record import FlightLog
from mavfi.report.explain import around, published_field
from mavfi.report.html.page import encoded
from mavfi.report.html.time_lines import time_lines
from mavfi.sim.environments import World

GOLDEN, INJECTED, RECOVERED = "golden", "injected", "recovered"
"""Roles of flights on a page."""
SAMPLES = 400
"""Approximate maximum number of samples per path."""
MOST_ALARMS = 60
"""Maximum number of alarms marked per flight."""
NEAR = 8.0
"""Distance from the paths within which voxels of a scan are shown (m)."""
MOST_VOXELS = 20_000
_STEP = 5  # stride over the rows of a log: 10 Hz


@dataclass(frozen=True, slots=True)
class Course:
    """One of the flights of a page.

    Attributes:
        role: "golden", "injected" or "recovered".
        label: Label in the legend.
        log: The flight.
        published: Its publications, in order; empty = not recorded.
    """

    role: str
    label: str
    log: FlightLog
    published: Sequence[Publication] = ()


def flight_data(courses: Sequence[Course], world: World, site: str = "") -> dict[str, Any]:
    """World, paths and time lines of flights of one mission.

    Args:
        courses: The flights, with each role at most once; the golden run first.
        world: World of the mission.
        site: Site of the fault, as text; if it is a state field, it is the first time line.
    """
    paths = [course_data(course) for course in courses]
    at = next((path["fault"] for path in paths if path["fault"] is not None), None)
    return {
        "world": world_data(world, courses), "paths": paths, "fault": at,
        "lines": [] if at is None else time_lines(
            {course.role: course.published for course in courses}, at, site, _first_wrong(courses)
        ),
    }  # fmt: skip


def _first_wrong(courses: Sequence[Course]) -> str:
    """The first field that differs in the output of the injected kernel; "" = none, or no kernel was injected."""
    effects = [course.log.kernel for course in courses if course.log.kernel is not None]
    found = next((effect.first_difference for effect in effects if effect.first_difference), None)
    return "" if found is None else published_field(found)


def course_data(course: Course) -> dict[str, Any]:
    """Data of a flight: time, position and speed as float32, attitude as int8, end, fault, alarms."""
    log = course.log
    rows = log.rows[np.isfinite(log.columns("x", "y", "z", "vx", "vy", "vz")).all(axis=1)]
    step = max(_STEP, -(-len(rows) // SAMPLES))
    rows = rows[np.unique(np.append(np.arange(0, len(rows), step), len(rows) - 1))]
    speed = np.linalg.norm(rows[:, 4:7], axis=1)
    near, _ = around(log)
    near_times = {alarm.time_s for alarm in near}
    injected = [injection.time_s for injection in log.injections if injection.activated]
    return {
        "role": course.role, "label": course.label, "n": len(rows),
        "rows": encoded(np.column_stack([rows[:, :4], speed]), "f4"),
        "attitude": encoded(np.clip(127 * np.nan_to_num(rows[:, 7:11]), -127, 127).round(), "i1"),
        "success": log.status is MissionStatus.SUCCESS, "status": log.status.words,
        "end": round(float(log.column("time")[-1]), 3), "fault": injected[0] if injected else None,
        "alarms": [
            [round(alarm.time_s, 3), int(alarm.time_s in near_times), f"{alarm.source}: {alarm.action} {alarm.stage}"]
            for alarm in log.alarms[:MOST_ALARMS]
        ],
    }  # fmt: skip


def world_data(world: World, courses: Sequence[Course]) -> dict[str, Any]:
    """Data of a world: start, goal, arena, boxes as float32 corners; for scans, surface voxels as int16 indices."""
    data: dict[str, Any] = {
        "start": world.start.tolist(), "goal": world.goal.tolist(),
        "arena": [*world.arena_lower.tolist(), *world.arena_upper.tolist()],
        "boxes": encoded(np.hstack([world.lower, world.upper]), "f4"),
    }  # fmt: skip
    if world.is_voxels:
        cells = _surface_near(world, np.concatenate([course.log.columns("x", "y", "z") for course in courses]))
        data |= {"voxels": encoded(cells, "i2"), "origin": world.origin.tolist(), "edge": world.resolution}
    return data


def _surface_near(world: World, points: np.ndarray) -> np.ndarray:
    """Indices of solid voxels with a free neighbour, ordered by distance from the paths. Shape (n, 3)."""
    solid = np.pad(world.occupied, 1, constant_values=True)
    buried = np.ones_like(world.occupied)
    for axis in range(3):
        for shift in (-1, 1):
            buried &= np.roll(solid, shift, axis)[1:-1, 1:-1, 1:-1]
    cells = np.argwhere(world.occupied & ~buried)
    path = points[np.isfinite(points).all(axis=1)][::_STEP]
    distance = cKDTree(path).query(world.origin + (cells + 0.5) * world.resolution)[0]
    order = np.argsort(distance, kind="stable")[: int((distance < NEAR).sum())]
    found: np.ndarray = cells[order[:MOST_VOXELS]]
    return found
