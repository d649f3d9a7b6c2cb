"""A pipeline without a simulator: configuration and hand-made states."""

import numpy as np

from mavfi.config import AutopilotConfig, CameraConfig, MapConfig, PlannerConfig, shipped
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.states import floats, new_state, rows

AUTOPILOTS = ("published", "hardened")


def config(autopilot="published", *, planner="rrt_connect", tracker_slowdown=1.0, **rules):
    """A small arena; `rules` replace those of the autopilot profile."""
    profile = shipped("autopilots", AutopilotConfig, autopilot).model_copy(update=rules)
    return PipelineConfig(
        autopilot=profile,
        planner=PlannerConfig(name=planner, restarts=2, shortcuts=20),
        map=MapConfig(),
        camera=CameraConfig(),
        directions=np.array([[1.0, 0.0, 0.0], [0.8, 0.6, 0.0], [0.8, -0.6, 0.0]]),
        arena_lower=np.zeros(3),
        arena_upper=np.array([20.0, 10.0, 6.0]),
        flight_lower=np.ones(3),
        flight_upper=np.array([19.0, 9.0, 5.0]),
        goal=np.array([17.0, 5.0, 3.0]),
        seed=3,
        v_max=3.0,
        a_max=5.0,
        plan_radius=profile.plan_radius,
        check_radius=profile.check_radius,
        control_period_us=20_000,
        tracker_slowdown=tracker_slowdown,
        map_latency=0.289,
        plan_latency=0.083,
        velocity_lag=0.4,
    )


def odometry(position=(2.0, 5.0, 3.0), velocity=(0.0, 0.0, 0.0)):
    state = new_state("sensor.odometry")
    floats(state.header, 13)[:] = [*position, *velocity, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    return state


def trajectory(seq=1, epoch=0, count=10, start=(2.0, 5.0, 3.0), speed=2.0, period=0.5):
    state = new_state("planning.trajectory", count)
    state.header["trajectory_seq"], state.header["future_collision_seq"] = seq, epoch
    points = rows(state.elements, 11)
    points[:, :3] = start
    points[:, 0] += speed * period * np.arange(count)
    points[:, 4], points[:, 10] = speed, period
    return state


def status(seq=0, time=30.0, collision=False, blocked=np.inf, trajectory_seq=-1):
    state = new_state("perception.collision_status")
    state.header[0] = (time, blocked, np.inf, seq, trajectory_seq, collision)
    return state


def tracking(remaining):
    state = new_state("control.tracking")
    state.header["remaining"] = remaining
    return state


def map_update(voxels, log_odds=1.0):
    state = new_state("perception.map_update", len(voxels))
    state.elements["voxel"], state.elements["log_odds"] = voxels, log_odds
    return state


def waypoint(position=(2.0, 5.0, 3.0), velocity=(0.0, 0.0, 0.0), duration=0.5, index=0):
    state = new_state("planning.waypoint")
    floats(state.header, 11)[:] = [*position, 0.0, *velocity, 0.0, 0.0, 0.0, duration]
    state.header["index"] = index
    return state


def same(first, second):
    return len(first) == len(second) and all(a.same_bits(b) for a, b in zip(first, second, strict=True))
