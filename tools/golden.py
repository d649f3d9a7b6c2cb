"""Quality of error-free flights: success, time, clearance, replans, tracking error, speed, and causes of failure."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavfi.campaign.analysis.statistics import Rate, wilson
from mavfi.campaign.executors.executor import map_each
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.flight_log import FlightLog
from mavfi.hosts.local import Flight, fly
from mavfi.hosts.loop.compose import resolve
from mavfi.kernels.perception.clearance import OCCUPIED
from mavfi.mission import MissionSpec, MissionStatus, Scenario

EVALUATION_SEED = 10_000
"""First seed of published figures; autopilot profiles are tuned on lower seeds."""
LEAST_CLEARANCE, MOST_TRACKING, MOST_SPEED = 0.15, 1.0, 1.1
"""Quality criteria: clearance of the vehicle's sphere (m), tracking error (m), speed / v_max."""
_LAST_EVENTS = 3
_TURN_BACK = 5.0
"""Increase of the distance to the goal that counts as turning back (m)."""
_NAMED = ("environment", "seed", "autopilot", "planner", "platform", "v_max")
"""Mission keys that a command always states; others only if they differ from the default."""


@dataclass(frozen=True, slots=True)
class Setting:
    """One row of the table.

    Attributes:
        mission: The mission without its seed.
        least: Required success rate (%); None = no requirement.
        quality: Whether the quality criteria apply as well.
    """

    mission: MissionSpec
    least: float | None = None
    quality: bool = False

    @staticmethod
    def of(
        environment: str, autopilot: str, *, least: float | None = None, quality: bool = False, **mission: Any
    ) -> "Setting":
        """A setting from the keys of its mission; v_max defaults to 3 m/s."""
        given = {"environment": environment, "autopilot": autopilot, "v_max": 3.0, **mission}
        return Setting(MissionSpec.model_validate(given), least, quality)

    def spec(self, seed: int) -> MissionSpec:
        """The mission of a seed."""
        return self.mission.model_copy(update={"seed": seed})

    def command(self, seed: int) -> str:
        """The command that repeats this flight, with a picture."""
        words = ["mavfi fly"]
        for name, field in MissionSpec.model_fields.items():
            value = getattr(self.spec(seed), name)
            if name in _NAMED or value != field.default:
                values = value if isinstance(value, tuple) else (value,)
                text = " ".join(f"{one:g}" if isinstance(one, float) else str(one) for one in values)
                words.append(f"--{name.replace('_', '-')} {text}")
        return " ".join([*words, "--picture flight.png"])


@dataclass(frozen=True, slots=True)
class GoldenFlight:
    """Summary of one flight.

    Attributes:
        seed: Mission seed.
        status: Final status, as in tables.
        time_s: Flight time.
        limit_s: Time limit.
        clearance_m: Minimum distance of the vehicle's sphere from the nearest true obstacle or the ground (m).
        tracking_m: Maximum distance between vehicle and reference (m).
        speed_share: Maximum speed / v_max.
        plans: Number of successful plans.
        failed_plans: Number of failed plans.
        alarms: Number of predicted collisions.
        warnings: Number of simulator warnings.
        position: Last position (m).
        cause: Cause of failure, as far as the log shows; "" on success.
        events: The last events of a failed flight, as text.
    """

    seed: int
    status: str
    time_s: float
    limit_s: float
    clearance_m: float
    tracking_m: float
    speed_share: float
    plans: int
    failed_plans: int
    alarms: int
    warnings: int
    position: tuple[float, float, float]
    cause: str
    events: str

    @property
    def success(self) -> bool:
        """Whether it reached its goal."""
        return self.status == MissionStatus.SUCCESS.label


@dataclass(frozen=True, slots=True)
class Bar:
    """A requirement on a row, and whether it is met.

    Attributes:
        name: The measured quantity.
        wanted: The required value, as text.
        measured: The measured value, as text.
        met: Whether the requirement is met.
    """

    name: str
    wanted: str
    measured: str
    met: bool


@dataclass(frozen=True, slots=True)
class Row:
    """A setting and its flights, by seed."""

    setting: Setting
    flights: tuple[GoldenFlight, ...]

    @property
    def success(self) -> Rate:
        """Success rate with its interval."""
        return wilson(sum(flight.success for flight in self.flights), len(self.flights))

    def flight_times(self) -> tuple[float, float, float] | None:
        """Median, 95th percentile and maximum time of the successful flights (s); None if there is none."""
        times = [flight.time_s for flight in self.flights if flight.success]
        return (float(np.median(times)), float(np.percentile(times, 95)), max(times)) if times else None

    def failures(self) -> list[GoldenFlight]:
        """Flights that did not reach their goal."""
        return [flight for flight in self.flights if not flight.success]

    def bars(self) -> list[Bar]:
        """All requirements on this row."""
        rate, least = self.success, self.setting.least
        successes = rate.successes or 0
        found = []
        if least is not None:
            met = 100 * successes >= least * rate.n
            found.append(Bar("arrived", f"≥ {least:g} %", f"{successes}/{rate.n}", met))
        if self.setting.quality:
            closest = min(flight.clearance_m for flight in self.flights)
            off = max(flight.tracking_m for flight in self.flights)
            fastest = max(flight.speed_share for flight in self.flights)
            found += [
                Bar("closest", f"≥ {LEAST_CLEARANCE:g} m", f"{closest:.2f} m", closest >= LEAST_CLEARANCE),
                Bar("off reference", f"< {MOST_TRACKING:g} m", f"{off:.2f} m", off < MOST_TRACKING),
                Bar("speed", f"≤ {MOST_SPEED:g} v_max", f"{fastest:.3f} v_max", fastest <= MOST_SPEED),
            ]
        return found


def measure(task: tuple[Setting, int]) -> GoldenFlight:
    """Fly one error-free mission, and evaluate its quality against the true world."""
    row, seed = task
    scenario = resolve(row.spec(seed))
    flight = fly(scenario)
    log = flight.log
    position = log.columns("x", "y", "z")
    reference = log.columns("reference_x", "reference_y", "reference_z")
    speed = np.linalg.norm(log.columns("vx", "vy", "vz"), axis=1)
    return GoldenFlight(
        seed, log.status.label, float(log.column("time")[-1]), float(log.meta["time_limit_s"]),
        float(flight.world.clearance(position).min()) - scenario.vehicle.collision_radius,
        float(np.linalg.norm(position - reference, axis=1).max()), float(speed.max()) / scenario.v_max,
        log.count("plan"), log.count("plan_failed"), log.count("collision_predicted"), log.count("warning"),
        _point(position[-1]),
        "" if log.status is MissionStatus.SUCCESS else _cause(flight, scenario),
        "" if log.status is MissionStatus.SUCCESS else _last_events(log),
    )  # fmt: skip


def _point(position: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 2) for value in position)
    return x, y, z


def _cause(flight: Flight, scenario: Scenario) -> str:
    """Cause of failure as far as the log shows, in one line."""
    log = flight.log
    position = log.columns("x", "y", "z")
    if log.status is MissionStatus.COLLISION:
        clearance: Any = getattr(flight.pipeline["planner"], "clearance_map", None)
        seen = clearance is not None and _is_mapped(clearance, position[-1], scenario.vehicle.collision_radius)
        off = float(np.linalg.norm(position[-1] - log.columns("reference_x", "reference_y", "reference_z")[-1]))
        what = "touched what its map held for occupied" if seen else "touched what its map had not seen"
        return f"{what}, {off:.2f} m off its reference"
    flown = float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
    way = f"flew {flown:.0f} m on a course of {log.meta['course_m']:.0f} m"
    if log.status is MissionStatus.NO_PATH:
        return f"{scenario.autopilot.max_failed_plans + 1} plans in a row found no path; {way}"
    turns = turns_back(np.linalg.norm(position - flight.world.goal, axis=1))
    return f"{way}, turned back {turns} time{'' if turns == 1 else 's'}"


def _is_mapped(clearance: Any, point: np.ndarray, radius: float) -> bool:
    """Whether the map has an occupied voxel within the radius."""
    grid, reach = clearance.grid, radius + 0.5 * clearance.grid.resolution
    centre = (point - (grid.x0, grid.y0, grid.z0)) * grid.inverse
    low = np.maximum(np.floor(centre - reach * grid.inverse), 0).astype(int)
    high = np.minimum(np.floor(centre + reach * grid.inverse) + 1, (grid.nx, grid.ny, grid.nz)).astype(int)
    around = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    return bool((clearance.cells.reshape(grid.nx, grid.ny, grid.nz)[around] == OCCUPIED).any())


def turns_back(distance: np.ndarray) -> int:
    """Number of times that the distance to the goal increased by `_TURN_BACK` or more.

    Args:
        distance: Distance to the goal over time (m). Shape (n,).
    """
    turns, least, most = 0, np.inf, -np.inf
    away = False
    for value in distance:
        if away:
            most = max(most, value)
            if value < most - _TURN_BACK:
                away, least = False, value
        else:
            least = min(least, value)
            if value > least + _TURN_BACK:
                away, most, turns = True, value, turns + 1
    return turns


def _last_events(log: FlightLog) -> str:
    return "; ".join(
        f"{1e-6 * event.time_us:.1f} s {event.kind} {_plain(event.data)}".strip()
        for event in log.events[-_LAST_EVENTS:]
    )


def _plain(data: dict[str, Any]) -> str:
    numbers = ((key, f"{value:.3g}" if isinstance(value, float) else str(value)) for key, value in data.items())
    return ", ".join(f"{key} {text}" for key, text in numbers)


def fly_row(
    row: Setting, count: int, workers: int, first_seed: int = EVALUATION_SEED,
    progress: Callable[[int, int], None] | None = None,
) -> Row:  # fmt: skip
    """Fly one setting.

    Args:
        row: The setting.
        count: Number of flights, with consecutive seeds, none omitted.
        workers: Number of processes, without effect on the result.
        first_seed: Seed of the first flight.
        progress: Called with the numbers of completed and requested flights.

    Raises:
        BadInputError: The setting cannot be flown.
        MavfiError: A worker was lost.
    """
    resolve(row.spec(first_seed))  # reports bad input before workers start
    tasks = [(row, first_seed + i) for i in range(count)]
    done: dict[int, GoldenFlight] = {}
    for (_, seed), flight in map_each(LocalExecutor(workers), measure, tasks):
        done[seed] = flight
        if progress is not None:
            progress(len(done), count)
    return Row(row, tuple(done[seed] for seed in sorted(done)))
