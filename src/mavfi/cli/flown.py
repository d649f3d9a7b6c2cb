"""A flight that was asked for on the command line, and its figures as plain data."""

from dataclasses import asdict, dataclass
from typing import Any

from mavfi.campaign.worker import KERNEL_KEYS
from mavfi.faults.fault import Fault
from mavfi.hosts.inprocess import Flight
from mavfi.mission import Scenario
from mavfi.outcomes import FlightEnd, classify
from mavfi.qof import quality_of_flight


@dataclass(frozen=True, slots=True)
class Flown:
    """A flight, and what it is compared with.

    Attributes:
        scenario: The mission.
        flight: The flight that was asked for.
        golden: Its error-free twin with the same detector; None where the flight is golden itself.
        fault: What was injected.
        detector: Name and profile; "" = none watched.
    """

    scenario: Scenario
    flight: Flight
    golden: Flight | None
    fault: Fault | None
    detector: str


def to_json(flown: Flown) -> dict[str, Any]:
    """What `--json` prints.

    Returns:
        status, status_text, flight_time_s, energy_j, distance_m, battery_used, digest, injections, alarms, replans,
        events (counts by kind), what flew (environment, seed, stack, platform, planner, map, vehicle, v_max, wind,
        localization, detector, start, goal, course_m, time_limit_s), fault, outcome, and golden (of the error-free
        twin: the figures), the last three null for a golden flight; with a fault in an instruction also
        kernel_outcome, and where the kernel died due_end: the flight itself is then the one with a restart.
    """
    log = flown.flight.log
    scenario = flown.scenario
    kinds = [event.kind for event in log.events]
    return {
        **_figures(flown.flight),
        "injections": log.injections,
        "alarms": log.alarms,
        "replans": replans(flown.flight),
        "events": {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)},
        "environment": scenario.environment.name,
        "seed": scenario.seed,
        "stack": scenario.stack.name,
        "platform": scenario.platform.name,
        "planner": scenario.planner.name,
        "map": scenario.map.kind,
        "vehicle": scenario.vehicle.name,
        "v_max": scenario.v_max,
        "wind": scenario.wind.gust,
        "localization": scenario.localization.kind,
        "detector": flown.detector,
        **{key: log.meta[key] for key in ("start", "goal", "course_m", "time_limit_s")},
        "fault": None if flown.fault is None else flown.fault.to_json(),
        "outcome": outcome(flown),
        **{key: log.meta[key] for key in KERNEL_KEYS if key in log.meta},
        "golden": None if flown.golden is None else _figures(flown.golden),
    }


def _figures(flight: Flight) -> dict[str, Any]:
    status = flight.log.status
    quality = asdict(quality_of_flight(flight.log))
    return {"status": status.label, "status_text": status.value, **quality, "digest": flight.log.digest()}


def replans(flight: Flight) -> int:
    """Plans after the first one."""
    return max(0, flight.log.count("plan") - 1)


def outcome(flown: Flown) -> str | None:
    """What the fault did, against the golden twin; None for a golden flight."""
    if flown.golden is None:
        return None
    return classify(FlightEnd(flown.golden.log.digest()), FlightEnd(flown.flight.log.digest())).label
