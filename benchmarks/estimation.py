"""Flies golden missions with the state estimator, and prints the errors of its estimates.

    N=20 FIRST_SEED=10000 python benchmarks/estimation.py

Errors are evaluated at the control periods.  "NEES" is the normalized estimation error squared of the final position,
averaged over flights: 3 for a consistent filter.
"""

import os
import sys

import numpy as np

from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.states import ODOMETRY, State, floats

SETTINGS = [(environment, autopilot) for environment in ("sparse", "dense") for autopilot in ("published", "hardened")]
WIDTH = 10


def fly_one(environment: str, autopilot: str, seed: int) -> tuple[MissionStatus, np.ndarray, float]:
    """Status, position errors at the control periods (m), and NEES of the final position."""
    estimates: dict[int, np.ndarray] = {}

    def note(state: State, time_us: int) -> None:
        if state.spec.name == ODOMETRY["estimator"]:
            estimates[time_us] = floats(state.header, WIDTH).copy()

    spec = MissionSpec(environment=environment, seed=seed, autopilot=autopilot, localization="estimator")
    flight = fly(resolve(spec), recorders=[note])
    log = flight.log
    times = np.round(1e6 * log.column("time")).astype(int)
    truth = log.columns("x", "y", "z")[: len(times) - 1]  # the last period only evaluates the status
    errors = np.array([estimates[time][:3] for time in times[:-1]]) - truth
    covariance = flight.pipeline["state_estimation"].memory.filter.covariance[:3, :3]
    return log.status, np.linalg.norm(errors, axis=1), float(errors[-1] @ np.linalg.solve(covariance, errors[-1]))


def main() -> None:
    """Fly and print."""
    count, first = int(os.environ.get("N", "20")), int(os.environ.get("FIRST_SEED", "10000"))
    sys.stdout.write("| environment | autopilot | arrived | RMS (m) | max (m) | NEES |\n|---|---|---|---|---|---|\n")
    for environment, autopilot in SETTINGS:
        flights = [fly_one(environment, autopilot, seed) for seed in range(first, first + count)]
        arrived = sum(status is MissionStatus.SUCCESS for status, _, _ in flights)
        errors = np.concatenate([errors for _, errors, _ in flights])
        sys.stdout.write(
            f"| {environment} | {autopilot} | {arrived}/{count} | {np.sqrt(np.mean(errors**2)):.3f} | "
            f"{errors.max():.3f} | {np.mean([nees for _, _, nees in flights]):.1f} |\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
