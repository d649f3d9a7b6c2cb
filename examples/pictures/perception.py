"""Draw docs/kernels/point_cloud.png and collision_check.png: a depth image with its points, and the map at an alarm.

Run as `make results NAME=pictures`.
"""

import matplotlib.pyplot as plt
import numpy as np
from examples.pictures import drawing
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.typing import MarkerType

from mavfi.flight.compose import resolve
from mavfi.flight.host import Flight
from mavfi.kernels.perception.clearance import OCCUPIED
from mavfi.mission import MissionSpec, Scenario
from mavfi.report import style
from mavfi.states import State, floats

SEED = 7
ALARM = 6
"""Index of the predicted collision shown."""
IMAGE_US = 12_000_000
"""Instant of the depth image shown (us)."""
NEAR = "#EBDCC8"
_BEYOND = "#999999"


def latest(tape: drawing.Tape, name: str, time_us: int) -> State:
    """The last publication of a state at or before an instant."""
    return next(state for when, state in reversed(tape) if when <= time_us and state.spec.name == name)


def draw_point_cloud(scenario: Scenario, flight: Flight, tape: drawing.Tape, time_us: int) -> None:
    """Draw a depth image and its point cloud."""
    cloud = latest(tape, "perception.point_cloud", time_us)
    images = [state for when, state in tape if when <= time_us and state.spec.name == "sensor.depth"]
    origin = floats(cloud.header, 3)
    image = next(state for state in reversed(images) if np.array_equal(floats(state.header, 7)[:3], origin))
    camera = scenario.camera
    ranges = image.elements["range"].reshape(camera.height, camera.width)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.9), layout="constrained", width_ratios=(1.15, 1))
    shown = left.imshow(np.where(np.isfinite(ranges), ranges, np.nan), cmap="viridis_r", vmin=0.0, vmax=camera.range)
    left.set(title="depth image; white: nothing within range", xlabel="column", ylabel="row")
    figure.colorbar(shown, ax=left, label="m", shrink=0.9)
    points = np.stack([cloud.elements[axis] for axis in "xyz"], axis=1)
    beyond = np.linalg.norm(points - origin, axis=1) > camera.range + 0.01
    drawing.draw_boxes(right, flight.world)
    right.plot(*points[beyond][:, :2].T, ".", color=_BEYOND, markersize=3, label="no return: 1.25 × range", zorder=3)
    right.plot(*points[~beyond][:, :2].T, ".", color=style.ORANGE, markersize=3, label="return", zorder=4)
    right.plot(*origin[:2], "o", color=style.INK, markersize=6, label="camera", zorder=5)
    middle = 0.5 * (np.minimum(points[:, :2].min(axis=0), origin[:2]) + points[:, :2].max(axis=0))
    drawing.from_above(right, (middle[0] - 20, middle[0] + 20), (middle[1] - 20, middle[1] + 20))
    right.set_title("the points from above")
    figure.legend(loc="outside lower right", fontsize=8.5, ncols=3)
    drawing.save(figure, "point_cloud.png")


def draw_collision_check(scenario: Scenario, flight: Flight, tape: drawing.Tape, time_us: int, status: State) -> None:
    """Draw the remaining trajectory on the map at the instant of an alarm."""
    clearance = drawing.clearance_map_at(scenario, flight, tape, time_us)
    position = floats(latest(tape, "sensor.odometry", time_us).header, 3)
    waypoint = latest(tape, "planning.waypoint", time_us)
    elements = latest(tape, "planning.trajectory", time_us).elements
    points = np.stack([elements[axis] for axis in "xyz"], axis=1)
    index = int(waypoint.header["index"][0])
    figure, axes = plt.subplots(figsize=(7.6, 5.2), layout="constrained")
    layer = drawing.layer_of(clearance.grid, position[2])
    drawing.draw_boxes(axes, flight.world)
    drawing.shade(axes, clearance.grid, drawing.cube(clearance.narrow, clearance.grid)[:, :, layer] > 0, NEAR)
    occupied = drawing.cube(clearance.cells, clearance.grid)[:, :, layer] == OCCUPIED
    drawing.shade(axes, clearance.grid, occupied, style.OCCUPIED, order=2.1)
    axes.plot(*points[:, :2].T, ".-", color=style.GREEN, linewidth=1.2, markersize=5, zorder=4)
    axes.plot(*points[index, :2], "o", color=style.BLUE, markersize=8, zorder=6)
    axes.plot(*position[:2], marker=(3, 0, -90), color=style.INK, markersize=11, zorder=7)
    ahead = float(status.header["time_to_collision"][0])
    hit = _point_at(waypoint, elements, tape, time_us, ahead)
    axes.plot(*points[hit, :2], "X", color=style.ORANGE, markersize=11, markeredgecolor="white", zorder=8)
    centre = 0.5 * (position + points[hit])
    drawing.from_above(axes, (centre[0] - 16, centre[0] + 16), (centre[1] - 9, centre[1] + 9))
    axes.set_title(f"{1e-6 * time_us:.1f} s: time_to_collision = {ahead:.1f} s")
    figure.legend(handles=_legend(clearance.grid.resolution), loc="outside lower center", ncols=3, fontsize=8.5)
    drawing.save(figure, "collision_check.png")


def _point_at(waypoint: State, elements: np.ndarray, tape: drawing.Tape, time_us: int, ahead: float) -> int:
    """Index of the first point of the colliding segment."""
    left = float(latest(tape, "control.tracking", time_us).header["remaining"][0])
    index = int(waypoint.header["index"][0])
    while left < ahead - 1e-9 and index < len(elements) - 1:
        index += 1
        left += float(elements["duration"][index])
    return index


def _legend(resolution: float) -> list[Line2D | Patch]:
    marks: tuple[tuple[str, str, MarkerType], ...] = (
        ("vehicle", style.INK, (3, 0, -90)),
        ("point in force", style.BLUE, "o"),
        ("trajectory, a point per 0.5 s", style.GREEN, "."),
        ("the segment from here on collides", style.ORANGE, "X"),
    )
    return [
        *(Line2D([], [], label=name, color=colour, marker=marker, linestyle="") for name, colour, marker in marks),
        Patch(facecolor=style.OCCUPIED, label=f"occupied voxel ({resolution:g} m)"),
        Patch(facecolor=NEAR, label="nearer than the checker's radius"),
        Patch(label="obstacle", **style.OBSTACLE_LOOK),
    ]


def alarms(tape: drawing.Tape) -> list[tuple[int, State]]:
    """All predicted collisions with their instants (us)."""
    statuses = ((when, state) for when, state in tape if state.spec.name == "perception.collision_status")
    return [(when, state) for when, state in statuses if bool(state.header["collision"][0])]


def main() -> None:
    """Fly and draw."""
    scenario = resolve(MissionSpec(environment="dense", seed=SEED))
    flight, tape = drawing.record(scenario)
    time_us, status = alarms(tape)[ALARM]
    with style.house_style():
        draw_point_cloud(scenario, flight, tape, IMAGE_US)
        draw_collision_check(scenario, flight, tape, time_us, status)


if __name__ == "__main__":
    main()
