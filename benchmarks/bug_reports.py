"""Four public bug reports of autopilots as faults, without and with `recommended`; writes docs/reference/faults.md.

    N=20 python benchmarks/bug_reports.py

N: missions per environment (20), each flown without a fault, and with each fault in both arms.
"""

import os
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

from mavfi.analysis.statistics import score_bounds
from mavfi.faults.fault import Fault
from mavfi.flight.compose import watched
from mavfi.flight.fly import fly
from mavfi.levels.level import parse
from mavfi.mission import MissionSpec, MissionStatus
from tools.markers import between

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "faults.md"
FIRST_SEED = 10_000
ENVIRONMENTS = ("sparse", "dense")
AUTOPILOT = "published"
ARMS = ("none", "recommended")


class BugReport(NamedTuple):
    """A report, and the faults that do in our pipeline what it describes: for a moment, and to the end."""

    name: str
    url: str
    what: str
    faults: tuple[str, str]


REPORTS = (
    BugReport(
        "ArduPilot 19382",
        "https://github.com/ArduPilot/ardupilot/issues/19382",
        "a planner sends yaw rates that are NaN; the firmware crashes",
        ("state:control.command.yaw_rate:set=nan@10..12", "state:control.command.yaw_rate:set=nan@10.."),
    ),
    BugReport(
        "PX4 3001",
        "https://github.com/PX4/PX4-Autopilot/issues/3001",
        "velocity set-points are NaN; the vehicle falls",
        ("state:control.command.vx:set=nan@10..12", "state:control.command.vx:set=nan@10.."),
    ),
    BugReport(
        "PX4 7510",
        "https://github.com/PX4/PX4-Autopilot/issues/7510",
        "the altitude of a set-point that is marked valid is NaN; the vehicle flies away",
        ("state:planning.waypoint.z:set=nan@10..12", "state:planning.waypoint.z:set=nan@10.."),
    ),
    BugReport(
        "mavros 2025",
        "https://github.com/mavlink/mavros/issues/2025",
        "outliers of the position on one axis, here 20 m, once or every second",
        ("state:sensor.odometry.y:bias=20@10", "state:sensor.odometry.y:bias=20:every=50@10.."),
    ),
)


FAULTS = tuple(fault for report in REPORTS for fault in report.faults)
"""All faults, in order."""


class ReportedFlight(NamedTuple):
    """How a mission ended, how much later than its golden run (s), and the detector's alarms in addition to its."""

    status: MissionStatus
    later_s: float
    alarms: int


def fly_arm(mission: MissionSpec, faults: Sequence[Fault], arm: str) -> list[ReportedFlight]:
    """A mission without a fault and with each of some, under a detector or `none`."""
    detector = None
    if arm != "none":
        detector = arm
    setup = watched(mission, detector).setup
    logs = [fly(setup.scenario, fault, setup.detector(), recovery=setup.recovery).log for fault in (None, *faults)]
    golden = logs[0]
    return [
        ReportedFlight(
            log.status,
            float(log.column("time")[-1] - golden.column("time")[-1]),
            len(log.alarms) - len(golden.alarms),
        )
        for log in logs
    ]


def fly_mission(environment: str, seed: int) -> dict[str, list[ReportedFlight]]:
    """Both arms of a mission: the golden flight, then one flight for each fault."""
    mission = MissionSpec(environment=environment, seed=seed, autopilot=AUTOPILOT)
    faults = [parse(text).draw(watched(mission, None).setup, seed)[0] for text in FAULTS]
    return {arm: fly_arm(mission, faults, arm) for arm in ARMS}


def table(environment: str, missions: Sequence[dict[str, list[ReportedFlight]]]) -> list[str]:
    """Rows of an environment: the golden flights, then the faults."""
    lines = []
    for number, name in enumerate(("no fault", *(f"`{text.removeprefix('state:')}`" for text in FAULTS))):
        cells = [name, environment]
        for arm in ARMS:
            flights = [mission[arm][number] for mission in missions]
            cells += [_success(flights), _ends(flights), _delay(flights)]
        alarmed = sum(mission["recommended"][number].alarms > 0 for mission in missions)
        lines.append(f"| {' | '.join([*cells, str(alarmed)])} |")
    return lines


def _success(flights: Sequence[ReportedFlight]) -> str:
    """Share of missions that succeed (per cent), its 95 % Wilson interval, and the count."""
    successes = sum(flight.status is MissionStatus.SUCCESS for flight in flights)
    share = successes / len(flights)
    low, high = score_bounds(share, len(flights))
    return f"{100 * share:.0f} [{100 * low:.0f}, {100 * high:.0f}] {successes}/{len(flights)}"


def _ends(flights: Sequence[ReportedFlight]) -> str:
    """How the other missions end, the most frequent first."""
    ends = Counter(flight.status.words for flight in flights if flight.status is not MissionStatus.SUCCESS)
    if not ends:
        return "–"
    return ", ".join(f"{count} {words}" for words, count in ends.most_common())


def _delay(flights: Sequence[ReportedFlight]) -> str:
    """Median of how much later the successful missions arrive (s)."""
    delays = [flight.later_s for flight in flights if flight.status is MissionStatus.SUCCESS]
    if not delays:
        return "–"
    return f"{median(delays):+z.1f}"


def page_block(missions: dict[str, list[dict[str, list[ReportedFlight]]]]) -> str:
    """The reports, their faults, and what happens."""
    count = len(next(iter(missions.values())))
    lines = ["| report | what it describes | faults |", "|---|---|---|"]
    for report in REPORTS:
        faults = ", ".join(f"`{fault}`" for fault in report.faults)
        lines.append(f"| [{report.name}]({report.url}) | {report.what} | {faults} |")
    lines += [
        "",
        f"{count} missions in each environment, autopilot profile `{AUTOPILOT}`, seeds from {FIRST_SEED}; the same "
        "missions in both arms. Success in per cent, 95 % Wilson interval, count; how the others end; how much later "
        "than without the fault those that succeed arrive (median, s). *Alarms*: missions with more alarms than "
        "without the fault.",
        "",
        "| fault | environment | success, no detector | others | later | success, `recommended` | others | later "
        "| alarms |",
        "|---|---|---|---|---:|---|---|---:|---:|",
    ]
    for environment, flown in missions.items():
        lines += table(environment, flown)
    return "\n".join(lines)


def main() -> None:
    """Fly all missions and write the table."""
    count = int(os.environ.get("N", "20"))
    missions: dict[str, list[dict[str, list[ReportedFlight]]]] = {}
    for environment in ENVIRONMENTS:
        missions[environment] = []
        for seed in range(FIRST_SEED, FIRST_SEED + count):
            missions[environment].append(fly_mission(environment, seed))
            sys.stderr.write(f"\r{environment} {len(missions[environment])} missions")
        page = between(PAGE.read_text(encoding="utf-8"), "bug-reports", page_block(missions))
        PAGE.write_text(page, encoding="utf-8")
    sys.stdout.write(f"\n{page_block(missions)}\n")


if __name__ == "__main__":
    main()
