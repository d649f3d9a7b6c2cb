"""Four public bug reports of autopilots as faults, without and with `recommended`; writes docs/results/bug-reports.md.

python -m studies.bug_reports [MISSIONS]        # per environment, each in both arms; without: from the stored rows
"""

import csv
import sys
from collections import Counter
from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

from mavfi.analysis.statistics import score_bounds
from mavfi.analysis.table import Table
from mavfi.faults.fault import Fault
from mavfi.flight.compose import prepare
from mavfi.flight.fly import fly
from mavfi.levels.level import parse
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.report.text import markdown_grid
from tools import results
from tools.markers import ROOT

PAGE = "bug-reports"
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


FILE = "missions"
"""Name of the file of the table."""
HEADINGS = (
    "fault",
    "environment",
    "success, no detector",
    "how the others end",
    "later, s",
    "success, `recommended`",
    "how its others end",
    "later under it, s",
    "missions with an alarm",
)
TEXT = (
    "Two seconds of NaN cost about as much time; NaN without end ends the mission at its time limit, with "
    "`recommended` too: the flight controller rejects commands that are not finite, as the first two reports ask. "
    "`recommended` halves the delay by NaN way-points, and costs time elsewhere. In two of 20 missions in `dense` it "
    "withheld every way-point of the two seconds and restarted their node five times, and the vehicle collided; "
    "without it none of these missions is lost."
)
NOTES = (
    f"autopilot profile `{AUTOPILOT}`, seeds from {FIRST_SEED}, the same in both arms; "
    "success: per cent, 95 % Wilson interval, count",
    "later: median delay of missions that succeed; missions with an alarm: with more alarms than without the fault",
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
    setup = prepare(mission, detector)
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
    faults = [parse(text).draw(prepare(mission, None), seed)[0] for text in FAULTS]
    return {arm: fly_arm(mission, faults, arm) for arm in ARMS}


def rows_of(environment: str, missions: Sequence[dict[str, list[ReportedFlight]]]) -> list[tuple[str, ...]]:
    """Rows of an environment: the golden flights, then the faults."""
    rows = []
    for number, name in enumerate(("no fault", *(f"`{text.removeprefix('state:')}`" for text in FAULTS))):
        cells = [name, environment]
        for arm in ARMS:
            flights = [mission[arm][number] for mission in missions]
            cells += [_success(flights), _ends(flights), _delay(flights)]
        alarmed = sum(mission["recommended"][number].alarms > 0 for mission in missions)
        rows.append((*cells, str(alarmed)))
    return rows


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


def fly_all(count: int) -> list[tuple[str, ...]]:
    """Rows of all environments, with a number of missions in each."""
    rows: list[tuple[str, ...]] = []
    for environment in ENVIRONMENTS:
        missions = []
        for seed in range(FIRST_SEED, FIRST_SEED + count):
            missions.append(fly_mission(environment, seed))
            sys.stderr.write(f"\r{environment} {len(missions)} missions")
        rows += rows_of(environment, missions)
    return rows


def stored_rows() -> list[tuple[str, ...]]:
    """The published rows."""
    with (results.TABLES / PAGE / f"{FILE}.csv").open(encoding="utf-8", newline="") as file:
        _, *rows = csv.reader(file)
    return [tuple(cells) for cells in rows]


def write_page(rows: Sequence[tuple[str, ...]]) -> str:
    """Write the page and its table; returns the path of the page."""
    reports = markdown_grid(
        ["report", "what it describes", "faults"],
        [
            [f"[{report.name}]({report.url})", report.what, ", ".join(f"`{fault}`" for fault in report.faults)]
            for report in REPORTS
        ],
    )
    table = Table.of_text("Four reported bugs, by environment and fault", HEADINGS, rows, NOTES)
    excerpt = results.Excerpt(FILE, lambda row: row["environment"] == "dense")
    text = f"{TEXT}\n\n{reports}"
    command = "python -m studies.bug_reports"
    page = results.write(PAGE, "Four reported bugs", text, {FILE: table}, [excerpt], command=command)
    return str(page.relative_to(ROOT))


def main(arguments: Sequence[str]) -> None:
    """Write the page."""
    if arguments:
        rows = fly_all(int(arguments[0]))
    else:
        rows = stored_rows()
    print(f"wrote {write_page(rows)}")


if __name__ == "__main__":
    main(sys.argv[1:])
