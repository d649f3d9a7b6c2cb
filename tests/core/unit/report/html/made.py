"""Flights and worlds made by hand."""

import numpy as np

from mavfi.mission import MissionStatus
from mavfi.record import COLUMNS, FlightLog
from mavfi.sim.environments import World


def straight(rows=3000, status=MissionStatus.SUCCESS, **more):
    """Along x at 1 m/s, with a logged speed of 5 m/s."""
    values = np.zeros((rows, len(COLUMNS)))
    values[:, 0] = 0.02 * np.arange(rows)
    values[:, 1] = values[:, 0]
    values[:, 4:8] = 3.0, 4.0, 0.0, 1.0
    return FlightLog(values, status, **more)


def scene(**more):
    return World(
        np.zeros(3),
        np.array([50.0, 0, 5]),
        np.array([0.0, -30, 0]),
        np.array([60.0, 30, 12]),
        np.array([0.0, -30, 0]),
        np.array([60.0, 30, 12]),
        **more,
    )
