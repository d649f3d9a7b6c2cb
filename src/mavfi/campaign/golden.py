"""How good error-free flights are: success, time, closest approach, replans, tracking, speed, and every failure."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mavfi.campaign.executors.local import LocalPool, Lost
from mavfi.campaign.statistics import Rate, wilson
from mavfi.errors import MavfiError
from mavfi.flight_log import FlightLog
from mavfi.mission import MissionStatus, Scenario

EVALUATION_SEED = 10_000
"""First seed of published figures; stacks are tuned on lower ones."""
_LAST_EVENTS = 3


@dataclass(frozen=True, slots=True)
class Setting:
    """One row of the table.

    Attributes:
        environment: Name or path.
        stack: Name or path.
        planner: Name.
        platform: Name or path.
        v_max: m/s.
        depth_noise: Standard deviation / range.
        least: Smallest success that is wanted of 100 flights; None = no demand.
    """

    environment: str
    stack: str
    planner: str = "rrt_connect"
    platform: str = "i9-9940x"
    v_max: float = 3.0
    depth_noise: float = 0.0
    least: float | None = None

    def scenario(self, seed: int) -> Scenario:
        """The mission of a seed."""
        from mavfi.hosts.compose import make_scenario

        options = asdict(self)
        del options["least"]
        return make_scenario(options.pop("environment"), seed, **options)

    def command(self, seed: int) -> str:
        """What flies this mission again, with a picture of it."""
        words = [
            "mavfi fly", f"--environment {self.environment}", f"--seed {seed}", f"--stack {self.stack}",
            f"--planner {self.planner}", f"--platform {self.platform}", f"--v-max {self.v_max:g}",
        ]  # fmt: skip
        if self.depth_noise > 0.0:
            words.append(f"--depth-noise {self.depth_noise:g}")
        return " ".join([*words, "--picture flight.png"])


@dataclass(frozen=True, slots=True)
class GoldenFlight:
    """What is kept of one flight.

    Attributes:
        seed: Mission seed.
        status: How it ended, as in tables.
        time_s: Flight time.
        limit_s: Time limit.
        clearance_m: Smallest distance of the hull from the true nearest obstacle or the ground.
        tracking_m: Largest distance of the vehicle from its reference.
        speed_share: Largest speed / v_max.
        plans: Plans that were found.
        failed_plans: Plans that were not.
        alarms: Collisions that the check predicted.
        warnings: Warnings of the simulator.
        position: Last position (m).
        events: The last events of a flight that did not arrive, as text.
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
    events: str

    @property
    def success(self) -> bool:
        """Whether it reached its goal."""
        return self.status == MissionStatus.SUCCESS.label


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
        """Median, 95th percentile and largest time of the flights that arrived (s); None if none did."""
        times = [flight.time_s for flight in self.flights if flight.success]
        return (float(np.median(times)), float(np.percentile(times, 95)), max(times)) if times else None

    def failures(self) -> list[GoldenFlight]:
        """Flights that did not reach their goals."""
        return [flight for flight in self.flights if not flight.success]


def measure(task: tuple[Setting, int]) -> GoldenFlight:
    """Fly one error-free mission and judge its quality by the true world."""
    from mavfi.hosts.inprocess import fly

    setting, seed = task
    scenario = setting.scenario(seed)
    flight = fly(scenario)
    log = flight.log
    position = log.columns("x", "y", "z")
    reference = log.columns("reference_x", "reference_y", "reference_z")
    speed = np.linalg.norm(log.columns("vx", "vy", "vz"), axis=1)
    return GoldenFlight(
        seed, log.status.label, float(log.column("time")[-1]), float(log.meta["time_limit_s"]),
        float(flight.world.clearance(position).min()) - scenario.vehicle.hull_radius,
        float(np.linalg.norm(position - reference, axis=1).max()), float(speed.max()) / scenario.v_max,
        log.count("plan"), log.count("plan_failed"), log.count("collision_predicted"), log.count("warning"),
        _point(position[-1]),
        "" if log.status is MissionStatus.SUCCESS else _last_events(log),
    )  # fmt: skip


def _point(position: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 2) for value in position)
    return x, y, z


def _last_events(log: FlightLog) -> str:
    return "; ".join(
        f"{1e-6 * event.time_us:.1f} s {event.kind} {_plain(event.data)}".strip()
        for event in log.events[-_LAST_EVENTS:]
    )


def _plain(data: dict[str, Any]) -> str:
    numbers = ((key, f"{value:.3g}" if isinstance(value, float) else str(value)) for key, value in data.items())
    return ", ".join(f"{key} {text}" for key, text in numbers)


def fly_row(
    setting: Setting, count: int, workers: int, first_seed: int = EVALUATION_SEED,
    progress: Callable[[int, int], None] | None = None,
) -> Row:  # fmt: skip
    """Fly one setting.

    Args:
        setting: What.
        count: Flights; their seeds follow each other, and none is left out.
        workers: Number of processes; the result does not depend on it.
        first_seed: Of the first flight.
        progress: Called with flights done and wanted.

    Raises:
        MavfiError: A worker was lost.
    """
    setting.scenario(first_seed)  # what cannot be flown is told here, not by a worker
    tasks = [(setting, first_seed + i) for i in range(count)]
    done: dict[int, GoldenFlight] = {}
    with closing(LocalPool(workers).run(measure, tasks)) as results:
        for (_, seed), flight in results:
            if isinstance(flight, Lost):
                raise MavfiError(f"golden flight with seed {seed}: {flight.reason}")
            done[seed] = flight
            if progress is not None:
                progress(len(done), count)
    return Row(setting, tuple(done[seed] for seed in sorted(done)))
