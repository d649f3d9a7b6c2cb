"""Draw docs/kernels/pid.png, vehicle.png and waypoint.png: responses of tracker, vehicle and setpoint generator.

Run as `make results NAME=pictures`.
"""

from collections.abc import Callable

import matplotlib.pyplot as plt
import numpy as np
from examples.pictures import drawing

from mavfi.flight.compose import resolve
from mavfi.kernels.control import pid
from mavfi.mission import MissionSpec
from mavfi.pipeline.control import MAX_YAW_RATE
from mavfi.report import style
from mavfi.sim.environments.generated import arena_world
from mavfi.sim.simulator import Simulator
from mavfi.states import floats

DT_US = 20_000
START = np.array([10.0, 0.0, 5.0])
RAMP_SPEED, RAMP = 2.0, (1.0, 6.0)

Reference = Callable[[float], tuple[float, float]]
"""Time (s) -> position along x from the start (m), and velocity (m/s)."""


def open_air() -> Simulator:
    """The default vehicle in a world without obstacles."""
    nothing = np.zeros((0, 3))
    world = arena_world(nothing, nothing, START, START + (80.0, 0.0, 0.0))
    return Simulator(world, resolve(MissionSpec(environment="dense", seed=0)))


def gains(p: float, feed_forward: float, limit: float, integral: float = 0.0) -> pid.Gains:
    """Gains equal on all axes."""
    ones = np.ones(3)
    return pid.Gains(p * ones, integral * ones, 0.0 * ones, 1.0, feed_forward, 0.0, limit, 1.0, MAX_YAW_RATE)


def track(wanted: Reference, chosen: pid.Gains, seconds: float) -> np.ndarray:
    """Time, reference and vehicle position along x while tracking a reference. Shape (n, 3)."""
    sim, memory, command = open_air(), np.zeros(pid.MEMORY_WIDTH), np.zeros(4)
    rows = []
    for tick in range(round(seconds / (1e-6 * DT_US))):
        time = 1e-6 * DT_US * tick
        position, speed = wanted(time)
        waypoint = np.zeros(11)
        waypoint[:3] = START + (position, 0.0, 0.0)
        waypoint[4] = speed
        pid.track(waypoint, sim.odometry, memory, chosen, 1e-6 * DT_US, command)
        sim.command(command, 1e-6 * DT_US)
        rows.append((time, position, sim.odometry[0] - START[0]))
        sim.advance(DT_US * (tick + 1))
    return np.array(rows)


def step(time: float) -> tuple[float, float]:
    """Position step of 2 m at 1 s."""
    return (2.0, 0.0) if time >= 1.0 else (0.0, 0.0)


def ramp(time: float) -> tuple[float, float]:
    """Constant reference speed between two instants."""
    first, last = RAMP
    return RAMP_SPEED * (min(max(time, first), last) - first), RAMP_SPEED if first <= time < last else 0.0


def draw_pid() -> None:
    """Draw the position step response, and the tracking error with and without feed-forward."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.4, 4.2), layout="constrained")
    kinds = ((0.2, style.BLUE, "K_p 0.2 /s (published)"), (2.0, style.ORANGE, "K_p 2 /s (hardened)"))
    for p, colour, label in kinds:
        found = track(step, gains(p, 0.0, 3.0), 12.0)
        left.plot(found[:, 0], found[:, 2], color=colour, label=label)
        for feed_forward, dashes in ((1.0, "-"), (0.0, "--")):
            found = track(ramp, gains(p, feed_forward, 3.0), 12.0)
            with_or_without = "with" if feed_forward else "without"
            name = f"{label}, {with_or_without} feed-forward"
            right.plot(found[:, 0], found[:, 1] - found[:, 2], dashes, color=colour, label=name)
    found = track(step, gains(0.2, 0.0, 3.0, integral=0.1), 12.0)
    left.plot(found[:, 0], found[:, 2], ":", color=style.GREEN, label="K_p 0.2 /s, K_i 0.1 /s²")
    left.plot(found[:, 0], found[:, 1], color=style.INK, linewidth=0.9, label="reference")
    left.set(title="a step of 2 m", xlabel="time (s)", ylabel="x (m)")
    first, last = RAMP
    right.set(
        title=f"reference at {RAMP_SPEED:g} m/s from {first:g} to {last:g} s",
        xlabel="time (s)",
        ylabel="behind the reference (m)",
    )
    for axes in (left, right):
        axes.grid(True)
    left.legend(loc="lower right", fontsize=8.5)
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, fontsize=8.5)
    drawing.save(figure, "pid.png")


def draw_vehicle() -> None:
    """Draw velocity set-points, the vehicle's response, and its tilt."""
    sim = open_air()
    rows = []
    for tick in range(350):
        time = 1e-6 * DT_US * tick
        setpoint = np.array([3.0 if 0.5 <= time < 3.5 else 0.0, 0.0, 1.5 if 4.5 <= time < 5.5 else 0.0, 0.0])
        sim.command(setpoint, 1e-6 * DT_US)
        w, x, y, z = sim.odometry[6:10]
        tilt = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)))
        rows.append((time, setpoint[0], sim.odometry[3], setpoint[2], sim.odometry[5], tilt))
        sim.advance(DT_US * (tick + 1))
    table = np.array(rows)
    figure, (above, below) = plt.subplots(2, 1, figsize=(7.2, 4.6), sharex=True, layout="constrained")
    for column, colour, name in ((1, style.BLUE, "v_x"), (3, style.ORANGE, "v_z")):
        above.step(table[:, 0], table[:, column], where="post", color=colour, linewidth=0.9, linestyle="--")
        above.plot(table[:, 0], table[:, column + 1], color=colour, label=name)
    above.plot([], [], "--", color=style.GREY, label="set-point")
    above.set(title="velocity steps", ylabel="m/s")
    above.legend(fontsize=8.5)
    below.plot(table[:, 0], table[:, 5], color=style.INK)
    below.set(title="tilt", ylabel="degrees", xlabel="time (s)")
    for axes in (above, below):
        axes.grid(True)
    drawing.save(figure, "vehicle.png")


def draw_waypoint() -> None:
    """Draw the speed of the way-point in force under both rules, and the alarms."""
    figure, rows = plt.subplots(2, 1, figsize=(8.2, 4.8), sharex=True, sharey=True, layout="constrained")
    for axes, profile, rule in zip(rows, ("published", "hardened"), ("held", "governed"), strict=True):
        flight, tape = drawing.record(resolve(MissionSpec(environment="dense", seed=7, autopilot=profile)))
        points = [(1e-6 * t, floats(s.header, 11)[4:7]) for t, s in tape if s.spec.name == "planning.waypoint"]
        times, speeds = [t for t, _ in points], [float(np.linalg.norm(v)) for _, v in points]
        actual = np.linalg.norm(flight.log.columns("vx", "vy", "vz"), axis=1)
        axes.plot(flight.log.column("time"), actual, color=style.SKY, linewidth=2.2, label="vehicle")
        axes.step(times, speeds, where="post", color=style.INK, linewidth=1.0, label="way-point in force")
        alarms = [1e-6 * e.time_us for e in flight.log.events if e.kind == "collision_predicted"]
        axes.plot(alarms, [3.45] * len(alarms), "v", color=style.ALARM, label="predicted collision")
        axes.set(title=f"{profile}: {rule}", ylabel="speed (m/s)", ylim=(0.0, 3.7))
        axes.grid(True)
    rows[1].set(xlabel="time (s)", xlim=(0.0, None))
    handles, labels = rows[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8.5)
    drawing.save(figure, "waypoint.png")


def main() -> None:
    """Draw all pictures."""
    with style.house_style():
        draw_pid()
        draw_vehicle()
        draw_waypoint()


if __name__ == "__main__":
    main()
