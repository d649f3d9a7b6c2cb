"""Worlds and scenarios that the simulator's tests share."""

import numpy as np

from mavfi.config import AutopilotConfig, CameraConfig, EnvironmentConfig, PlatformConfig, VehicleConfig, shipped
from mavfi.mission import Scenario
from mavfi.sim.environments.world import World
from mavfi.sim.simulator import Simulator

TICK_US = 20_000


def open_world(height=50.0, lower=(), upper=()):
    return World(
        start=np.array([0.0, 0.0, height]),
        goal=np.array([100.0, 0.0, height]),
        arena_lower=np.array([-500.0, -500.0, 0.0]),
        arena_upper=np.array([500.0, 500.0, 1000.0]),
        flight_lower=np.array([-500.0, -500.0, 0.0]),
        flight_upper=np.array([500.0, 500.0, 1000.0]),
        lower=np.array(lower, float).reshape(-1, 3),
        upper=np.array(upper, float).reshape(-1, 3),
    )


def room(cells=40, resolution=0.1):
    """A cube of free voxels with a solid shell; the vehicle starts in its middle."""
    occupied = np.ones((cells, cells, cells), bool)
    occupied[1:-1, 1:-1, 1:-1] = False
    edge = cells * resolution
    middle = np.full(3, 0.5 * edge)
    return World(
        start=middle,
        goal=middle + (1.0, 0.0, 0.0),
        arena_lower=np.zeros(3),
        arena_upper=np.full(3, edge),
        flight_lower=np.zeros(3),
        flight_upper=np.full(3, edge),
        occupied=occupied,
        origin=np.zeros(3),
        resolution=resolution,
    )


def scenario(vehicle="airsim_quad", seed=7, v_max=3.0, noise=0.0, **airframe):
    return Scenario(
        environment=shipped("environments", EnvironmentConfig, "sparse"),
        seed=seed,
        autopilot=shipped("autopilots", AutopilotConfig, "hardened"),
        vehicle=shipped("vehicles", VehicleConfig, vehicle).model_copy(update=airframe),
        platform=shipped("platforms", PlatformConfig, "i9-9940x"),
        camera=CameraConfig(noise=noise),
        v_max=v_max,
    )


def fly(simulator, command, seconds):
    """Odometry at each tick under a constant command. Shape (n, 13)."""
    rows = []
    first = simulator.time_us
    for tick in range(1, round(seconds * 1e6 / TICK_US) + 1):
        simulator.command(np.array(command, float), 0.1)
        simulator.advance(first + tick * TICK_US)
        rows.append(simulator.odometry.copy())
    return np.array(rows)


def simulator(world=None, **options):
    return Simulator(open_world() if world is None else world, scenario(**options))
