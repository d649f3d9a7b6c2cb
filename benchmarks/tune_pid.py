"""Coordinate search for the tracker gains of `hardened` on design seeds; reports which values it confirms.

    N=4 SEED=200 ONLY=gain_p python benchmarks/tune_pid.py

N: missions per setting (4); SEED: the first seed (200), below 10000; ONLY: one parameter.  No file is changed: to
replace a value is a manual decision, as it changes every golden digest of the profile.

Objective of a variant, to be minimized: root mean square of the distance from the reference (m), plus 5 x the speed
above 1.1 v_max (as a share of v_max, worst flight), plus 10 x the share of failed missions.  A value is confirmed if
its objective is within TOLERANCE of the best one, or if only its tracking is worse, by less than two standard errors of
the paired difference between the missions' mean squares: another gain leads to other paths, whose tracking varies by
chance.  `published` is the paper's code and is not tuned; its look-ahead is flown at other values for comparison.
"""

import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mavfi.config import AutopilotConfig, shipped
from mavfi.errors import BadInputError, MavfiError
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec, MissionStatus

DESIGN_SEEDS = range(10_000)
SETTINGS = (("dense", 3.0), ("clutter", 5.0))
"""Environment and v_max (m/s)."""
TOLERANCE = 0.10
"""Tolerance of the objective, as a fraction."""
SPEED_LIMIT = 1.1
CANDIDATES: dict[str, tuple[float, ...]] = {
    "gain_p": (1.0, 1.5, 2.0, 2.5, 3.0),
    "gain_i": (0.0, 0.2),
    "gain_d": (0.0, 0.1),
    "velocity_feed_forward": (0.9, 1.0, 1.01, 1.05),
    "acceleration_feed_forward": (0.0, 0.2, 0.4, 0.6),
    "command_limit": (1.0, 1.04, 1.08, 1.1),
}
"""Candidate values in addition to that of the YAML file; a gain is equal on all axes."""
LOOK_AHEAD = (0.0, 0.15, 0.3, 0.45)


@dataclass(frozen=True, slots=True)
class Score:
    """Tracking performance of a variant.

    Attributes:
        arrived: Share of successful missions.
        squares: Mean square of the distance from the reference (m^2), by mission.
        farthest: Maximum distance (m).
        speed: Maximum speed / v_max.
        duration: Mean flight time (s); printed, not part of the objective.
    """

    arrived: float
    squares: tuple[float, ...]
    farthest: float
    speed: float
    duration: float

    @property
    def tracking(self) -> float:
        """Root mean square of the distance from the reference, over all missions (m)."""
        return float(np.sqrt(np.mean(self.squares)))

    @property
    def penalty(self) -> float:
        """Terms of the objective for speed and failed missions."""
        return 5.0 * max(0.0, self.speed - SPEED_LIMIT) + 10.0 * (1.0 - self.arrived)

    @property
    def objective(self) -> float:
        """Objective, to be minimized; see the module."""
        return self.tracking + self.penalty


def check_seeds(first: int, count: int) -> None:
    """Refuse seeds reserved for published results.

    Raises:
        BadInputError: A seed is not a design seed.
    """
    if count < 1 or first not in DESIGN_SEEDS or first + count - 1 not in DESIGN_SEEDS:
        raise BadInputError(
            f"SEED={first} N={count}: allowed: seeds from 0 to {DESIGN_SEEDS[-1]}, at least one; others are for results"
        )


def variant(autopilot: AutopilotConfig, key: str, value: float) -> AutopilotConfig:
    """The profile with one value changed; a gain on all axes."""
    is_vector = isinstance(getattr(autopilot, key), tuple)
    return autopilot.model_copy(update={key: (value,) * 3 if is_vector else value})


def present(autopilot: AutopilotConfig, key: str) -> float:
    """Current value of a key of the profile."""
    value = getattr(autopilot, key)
    return float(value[0] if isinstance(value, tuple) else value)


def score(autopilot: AutopilotConfig, seeds: range) -> Score:
    """Fly every setting with every seed, and evaluate the variant."""
    arrived, squares, durations, farthest, speed = [], [], [], 0.0, 0.0
    for environment, v_max in SETTINGS:
        for seed in seeds:
            scenario = resolve(MissionSpec(environment=environment, seed=seed, autopilot=autopilot.name, v_max=v_max))
            log = fly(scenario.model_copy(update={"autopilot": autopilot})).log
            off = np.linalg.norm(
                log.columns("x", "y", "z") - log.columns("reference_x", "reference_y", "reference_z"), axis=1
            )
            fast = np.linalg.norm(log.columns("vx", "vy", "vz"), axis=1).max() / v_max
            arrived.append(log.status is MissionStatus.SUCCESS)
            squares.append(float(np.mean(off**2)))
            durations.append(float(log.column("time")[-1]))
            farthest, speed = max(farthest, float(off.max())), max(speed, float(fast))
    return Score(float(np.mean(arrived)), tuple(squares), farthest, speed, float(np.mean(durations)))


def candidates(key: str, autopilot: AutopilotConfig) -> list[float]:
    """Values to evaluate, including the current one."""
    values = LOOK_AHEAD if key == "look_ahead" else CANDIDATES[key]
    return sorted({*values, present(autopilot, key)})


def search(
    autopilot: AutopilotConfig, keys: list[str], seeds: range, known: dict[str, Score]
) -> Iterator[tuple[str, list]]:
    """Evaluate every value of each parameter, the others unchanged; `known` caches evaluated variants."""
    for key in keys:
        rows = []
        for value in candidates(key, autopilot):
            changed = variant(autopilot, key, value)
            name = changed.model_dump_json()
            if name not in known:
                known[name] = score(changed, seeds)
            rows.append((value, known[name]))
        yield key, rows


def verdict(key: str, autopilot: AutopilotConfig, rows: list[tuple[float, Score]]) -> str:
    """Whether the current value is as good as the best one."""
    ours = present(autopilot, key)
    best_value, best = min(rows, key=lambda row: row[1].objective)
    own = next(found for value, found in rows if value == ours)
    more = own.objective / best.objective - 1.0
    excess = f"{100 * more:.1f} % above the best ({best_value:g})"
    if more <= TOLERANCE:
        return f"{autopilot.name}.yaml {key} {ours:g}: confirmed, {excess}"
    if by_chance(own, best):
        return f"{autopilot.name}.yaml {key} {ours:g}: confirmed, {excess}, which may be chance"
    return f"{autopilot.name}.yaml {key} {ours:g}: NOT confirmed, {excess}"


def by_chance(own: Score, best: Score) -> bool:
    """Whether only the tracking is worse, by less than two standard errors of the paired difference."""
    more = np.subtract(own.squares, best.squares)
    error = float(np.std(more, ddof=1) / np.sqrt(len(more)))
    return own.penalty <= best.penalty and float(np.mean(more)) <= 2.0 * error


def table(key: str, autopilot: AutopilotConfig, rows: list[tuple[float, Score]]) -> str:
    """Rows of one parameter, with the current value marked."""
    lines = [
        f"{key:26s} {'objective':>9s} {'arrived':>8s} {'rms (m)':>8s} {'max (m)':>8s} {'speed':>6s} {'time (s)':>9s}"
    ]
    for value, found in rows:
        mark = " <- yaml" if value == present(autopilot, key) else ""
        lines.append(
            f"{value:26g} {found.objective:9.4f} {100 * found.arrived:7.0f}% {found.tracking:8.4f} "
            f"{found.farthest:8.3f} {found.speed:6.3f} {found.duration:9.1f}{mark}"
        )
    return "\n".join(lines)


def main() -> None:
    """Search, and print."""
    first, count = int(os.environ.get("SEED", "200")), int(os.environ.get("N", "4"))
    only = os.environ.get("ONLY", "")
    start = time.perf_counter()
    try:
        check_seeds(first, count)
        if only and only not in (*CANDIDATES, "look_ahead"):
            raise BadInputError(f"ONLY={only}: not known; allowed: {', '.join((*CANDIDATES, 'look_ahead'))}")
    except MavfiError as error:
        sys.exit(str(error))
    seeds = range(first, first + count)
    flown = ", ".join(f"{name} at {v_max:g} m/s" for name, v_max in SETTINGS)
    sys.stdout.write(f"seeds {seeds[0]} to {seeds[-1]}; {flown}; tolerance {100 * TOLERANCE:g} %\n\n")
    verdicts = []
    for name, keys in (("hardened", list(CANDIDATES)), ("published", ["look_ahead"])):
        autopilot = shipped("autopilots", AutopilotConfig, name)
        wanted = [key for key in keys if only in ("", key)]
        for key, rows in search(autopilot, wanted, seeds, {}):
            sys.stdout.write(f"{name}: {table(key, autopilot, rows)}\n\n")
            sys.stdout.flush()
            if name == "hardened":
                verdicts.append(verdict(key, autopilot, rows))
    sys.stdout.write("\n".join(verdicts) + f"\n{time.perf_counter() - start:.0f} s\n")


if __name__ == "__main__":
    main()
