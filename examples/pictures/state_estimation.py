"""Draw docs/images/state_estimation.png: errors of the state estimator in a golden flight, and its 3-sigma bounds.

Run as `python -m examples.pictures.state_estimation`.
"""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from examples.pictures import drawing

from mavfi.flight.compose import pipeline_config, resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec
from mavfi.pipeline.estimation import StateEstimator
from mavfi.report import style
from mavfi.states import State, floats

PARTS = (
    ("position error (m)", ("x", "y", "z"), 0, 0.22),
    ("velocity error (m/s)", ("vx", "vy", "vz"), 3, 0.12),
)
WIDTH = 10


def replayed(published: list[tuple[int, State]], noise: Any) -> dict[int, np.ndarray]:
    """Estimates and standard deviations by instant, from the sensors' publications. Shape (2, 6) each."""
    kernel = StateEstimator(noise)
    found = {}
    for time_us, state in published:
        if kernel.receive(state, time_us):
            (estimate,) = kernel.step(time_us)
            deviations = np.sqrt(np.diag(kernel.memory.filter.covariance)[:6])
            found[time_us] = np.array([floats(estimate.header, WIDTH)[:6], deviations])
    return found


def draw(path: Path) -> None:
    """Fly, replay the recorded sensor values through the estimator, and draw."""
    scenario = resolve(MissionSpec(environment="dense", seed=7, autopilot="hardened", localization="estimator"))
    published: list[tuple[int, State]] = []

    def note(state: State, time_us: int) -> None:
        if state.spec.name in StateEstimator.reads:
            published.append((time_us, state))

    flight = fly(scenario, recorders=[note])
    found = replayed(published, pipeline_config(scenario, flight.world, np.zeros((0, 3))).noise)
    times = flight.log.column("time")[:-1]
    estimates, deviations = np.array([found[round(1e6 * time)] for time in times]).transpose(1, 0, 2)
    figure, panels = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
    for panel, (label, columns, first, limit) in zip(panels, PARTS, strict=True):
        truth = flight.log.columns(*columns)[:-1]
        for axis, colour in enumerate((style.BLUE, style.ORANGE, style.GREEN)):
            error = estimates[:, first + axis] - truth[:, axis]
            panel.plot(times, error, color=colour, linewidth=0.9, label=columns[axis])
        for sign in (-3.0, 3.0):
            panel.plot(times, sign * deviations[:, first], color="grey", linestyle="--", linewidth=0.9)
        panel.set(xlabel="time (s)", ylabel=label, ylim=(-limit, limit), xlim=(0.0, times[-1]))
        panel.legend(frameon=False, ncols=3, loc="upper right")
        panel.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    draw(drawing.IMAGES / "state_estimation.png")
