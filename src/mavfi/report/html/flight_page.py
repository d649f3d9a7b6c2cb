"""The page of a flight: an interactive 3-D scene, time lines around the fault, the explanation, and commands."""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from mavfi.campaign.divergence import TimedState, departure, first_difference, spread
from mavfi.campaign.replay import Explanation, flight_again, fly_recorded
from mavfi.campaign.store import Store
from mavfi.errors import write_text
from mavfi.faults.fault import Fault
from mavfi.flight.decide import Recovery
from mavfi.flight.host import ArmSetup, Flight
from mavfi.mission import MissionSpec, MissionStatus, Scenario
from mavfi.record import FlightLog
from mavfi.report.explain import Lines, around, detector_name, end_of, lines, published_field, steps, verdict
from mavfi.report.flight_result import FlightResult
from mavfi.report.html import page
from mavfi.report.html.page import AFTER, BEFORE, encoded
from mavfi.sim.environments import World
from mavfi.states import STATES, Stage

GOLDEN = "golden"
INJECTED = "injected"
RECOVERED = "recovered"
"""Roles of flights on a page."""
SAMPLES = 400
"""Approximate maximum number of samples per path."""
MOST_ALARMS = 60
"""Maximum number of alarms marked per flight."""
NEAR = 8.0
"""Distance from the paths within which voxels of a scan are shown (m)."""
MOST_VOXELS = 20_000
_STEP = 5  # stride over the rows of a log: 10 Hz


@dataclass(frozen=True, slots=True)
class Course:
    """One of the flights of a page.

    Attributes:
        role: "golden", "injected" or "recovered".
        label: Label in the legend.
        log: The flight.
        published: Its publications, in order; empty = not recorded.
    """

    role: str
    label: str
    log: FlightLog
    published: Sequence[TimedState] = ()


def flight_data(courses: Sequence[Course], world: World, site: str = "") -> dict[str, Any]:
    """World, paths and time lines of flights of one mission.

    Args:
        courses: The flights, with each role at most once; the golden run first.
        world: World of the mission.
        site: Site of the fault, as text; if it is a state field, it is the first time line.
    """
    paths = [course_data(course) for course in courses]
    at = next((path["fault"] for path in paths if path["fault"] is not None), None)
    return {
        "world": world_data(world, courses),
        "paths": paths,
        "fault": at,
        "lines": []
        if at is None
        else time_lines({course.role: course.published for course in courses}, at, site, _first_wrong(courses)),
    }


def _first_wrong(courses: Sequence[Course]) -> str:
    """The first field that differs in the output of the injected kernel; "" = none, or no kernel was injected."""
    effects = [course.log.kernel for course in courses if course.log.kernel is not None]
    found = next((effect.first_difference for effect in effects if effect.first_difference), None)
    if found is None:
        return ""
    return published_field(found)


def course_data(course: Course) -> dict[str, Any]:
    """Data of a flight: time, position and speed as float32, attitude as int8, end, fault, alarms."""
    log = course.log
    rows = log.rows[np.isfinite(log.columns("x", "y", "z", "vx", "vy", "vz")).all(axis=1)]
    step = max(_STEP, -(-len(rows) // SAMPLES))
    rows = rows[np.unique(np.append(np.arange(0, len(rows), step), len(rows) - 1))]
    speed = np.linalg.norm(rows[:, 4:7], axis=1)
    near, _ = around(log)
    near_times = {alarm.time_s for alarm in near}
    injected = [injection.time_s for injection in log.injections if injection.activated]
    return {
        "role": course.role,
        "label": course.label,
        "n": len(rows),
        "rows": encoded(np.column_stack([rows[:, :4], speed]), "f4"),
        "attitude": encoded(np.clip(127 * np.nan_to_num(rows[:, 7:11]), -127, 127).round(), "i1"),
        "success": log.status is MissionStatus.SUCCESS,
        "status": log.status.words,
        "end": round(float(log.column("time")[-1]), 3),
        "fault": injected[0] if injected else None,
        "alarms": [
            [round(alarm.time_s, 3), int(alarm.time_s in near_times), f"{alarm.source}: {alarm.action} {alarm.stage}"]
            for alarm in log.alarms[:MOST_ALARMS]
        ],
    }


def world_data(world: World, courses: Sequence[Course]) -> dict[str, Any]:
    """Data of a world: start, goal, arena, boxes as float32 corners; for scans, surface voxels as int16 indices."""
    data: dict[str, Any] = {
        "start": world.start.tolist(),
        "goal": world.goal.tolist(),
        "arena": [*world.arena_lower.tolist(), *world.arena_upper.tolist()],
        "boxes": encoded(np.hstack([world.lower, world.upper]), "f4"),
    }
    if world.is_voxels:
        cells = _surface_near(world, np.concatenate([course.log.columns("x", "y", "z") for course in courses]))
        data |= {"voxels": encoded(cells, "i2"), "origin": world.origin.tolist(), "edge": world.resolution}
    return data


def _surface_near(world: World, points: np.ndarray) -> np.ndarray:
    """Indices of solid voxels with a free neighbour, ordered by distance from the paths. Shape (n, 3)."""
    solid = np.pad(world.occupied, 1, constant_values=True)
    buried = np.ones_like(world.occupied)
    for axis in range(3):
        for shift in (-1, 1):
            buried &= np.roll(solid, shift, axis)[1:-1, 1:-1, 1:-1]
    cells = np.argwhere(world.occupied & ~buried)
    path = points[np.isfinite(points).all(axis=1)][::_STEP]
    distance = cKDTree(path).query(world.origin + (cells + 0.5) * world.resolution)[0]
    order = np.argsort(distance, kind="stable")[: int((distance < NEAR).sum())]
    found: np.ndarray = cells[order[:MOST_VOXELS]]
    return found


@dataclass(frozen=True, slots=True)
class FlightPage:
    """Text and plain data of one page.

    Attributes:
        title: Site of the fault.
        context: Environment, seed and configuration of the flight.
        verdict: Effect of the fault and result of the mission, in a sentence.
        story: Explanation as headings and sentences.
        commands: Descriptions and commands.
        data: Result of `flight_data`.
    """

    title: str
    context: str
    verdict: str
    story: Lines
    commands: Sequence[tuple[str, str]]
    data: dict[str, Any]

    @staticmethod
    def of(
        context: str,
        story: Lines,
        commands: Sequence[tuple[str, str]],
        courses: Sequence[Course],
        world: World,
        site: str = "",
    ) -> "FlightPage":
        """Create the page of flights of one mission; the first sentence of the story is the verdict."""
        (_, verdict), *rest = story
        title = f"Fault in {site}" if site else "A flight without a fault"
        return FlightPage(title, context, verdict, rest, commands, flight_data(courses, world, site))

    def to_json(self) -> dict[str, Any]:
        """Plain data for the template and scripts."""
        return asdict(self)


def write_flight_page(path: Path, flight: FlightPage) -> Path:
    """Write the page of one flight; `BadInputError` if the file cannot be written."""
    write_text(path, page.render("flight.html.j2", flight=flight.to_json()))
    return path


# ---- of a flight, and of a run of a ledger, with all publications recorded -------------------------------------------

FAULT = "with the fault"
NO_FAULT = "golden run"


def page_of_result(result: FlightResult, setup: ArmSetup, bare: Scenario, command: str) -> FlightPage:
    """Build the page of a flight requested by `mavfi fly`.

    Args:
        result: The flight.
        setup: Its mission, detector and recovery.
        bare: The mission without the detector.
        command: The command that repeats it.
    """
    mission = result.scenario
    context = f"{mission.environment.name} · seed {mission.seed} · autopilot {mission.autopilot.name}"
    commands = [("fly it again", command)]
    if result.golden is None or result.effect is None:
        story: Lines = [("verdict", end_of(result.log)), ("flight", f"without a fault; {end_of(result.log)}")]
        course = Course(GOLDEN, NO_FAULT, result.log)
        return FlightPage.of(context, story, commands, [course], result.flight.world)
    watched = _course(RECOVERED, f"{FAULT} and detector {result.detector}", setup, result.fault, result.flight)
    alone = Course(INJECTED, FAULT, result.log, watched.published)
    if result.unwatched is not None:
        alone = _course(INJECTED, FAULT, ArmSetup(bare, None, Recovery()), result.fault, result.unwatched)
    elif result.detector:
        alone = watched
    golden = _course(GOLDEN, NO_FAULT, setup, None, result.golden)
    if result.unwatched is None:
        courses = [golden, alone]
    else:
        courses = [golden, alone, watched]
    seen = (golden.published, watched.published)
    logs = (result.golden.log, result.log)
    first = first_difference(*seen)
    judged = verdict(result.effect, result.log, result.golden.log)
    if result.unwatched is not None:
        judged = f"with detector {result.detector}, {judged}; without it: {result.unwatched.log.status.value.lower()}"
    story = [("verdict", judged.removesuffix("."))]
    story += steps(
        result.log,
        result.golden.log,
        result.fault,
        result.detector,
        first,
        departure(*logs),
        spread(*seen),
    )
    if result.unwatched is not None:
        story.append(("without the detector", end_of(result.unwatched.log)))
    return FlightPage.of(context, story, commands, courses, result.flight.world, _site(result.fault))


def _course(role: str, label: str, setup: ArmSetup, fault: Fault | None, flight: Flight) -> Course:
    """A flight with its publications."""
    return Course(role, label, flight.log, fly_recorded(setup, fault)[1])


def _site(fault: Fault | None) -> str:
    if fault is None:
        return ""
    return fault.site


def page_of_explanation(directory: Path, found: Explanation, partner: str | None, shown: Path) -> FlightPage:
    """Build the page of an injected run, with its golden run and the same fault in another setting.

    Args:
        directory: Folder of the ledger.
        found: The run and its golden run.
        partner: Id of a run with the same fault, see `campaign.telling.partner`; None = none.
        shown: Folder to print in commands.
    """
    spec = found.spec
    own = Course(*_role(spec.detector, detector_name(spec)), found.flight.log, found.published)
    courses = [Course(GOLDEN, NO_FAULT, found.golden.log, found.golden_published), own]
    story = lines(found)
    if partner is not None:
        with Store.open(directory) as store:
            other = store.run(partner).spec
            log = flight_again(store, other).log
        role, label = _role(other.detector, detector_name(other))
        courses.append(Course(role, label, log))
        if other.detector:
            what = f"with {detector_name(other)}"
        else:
            what = "without a detector"
        story.append((what, f"{end_of(log)}, run {partner}"))
    courses.sort(key=lambda course: (GOLDEN, INJECTED, RECOVERED).index(course.role))
    commands = [
        ("fly it again, compare digests", f"mavfi replay {shown} {spec.run_id}"),
        ("explain it step by step", f"mavfi explain {shown} {spec.run_id}"),
        ("draw it", f"mavfi explain {shown} {spec.run_id} --picture flight.png"),
    ]
    context = f"{spec.environment} · seed {spec.seed} · {spec.setting} · {spec.run_id}"
    return FlightPage.of(context, story, commands, courses, found.flight.world, _site(spec.fault))


def _role(detector: str, name: str) -> tuple[str, str]:
    if detector:
        return (RECOVERED, f"{FAULT} and detector {name}")
    return (INJECTED, FAULT)


def fly_command(
    mission: MissionSpec,
    fault: str | None,
    fault_seed: int | None,
    detector: str,
    profile: str | None,
    models: Path | None,
) -> str:
    """The command line of a flight, with the options that were set."""
    given: dict[str, object] = {"environment": mission.environment, "seed": mission.seed}
    given |= mission.model_dump(mode="json", exclude_unset=True)
    given |= {"fault": fault, "fault_seed": fault_seed, "detector": None if detector == "none" else detector}
    given |= {"profile": profile, "models": models}
    words = [f"--{name.replace('_', '-')} {_word(value)}" for name, value in given.items() if value is not None]
    return " ".join(["mavfi fly", *words])


def _word(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return " ".join(map(str, value))
    return shlex.quote(str(value))


# ---- time lines of published fields around a fault: the most affected fields, and their samples --------------------

MOST_LINES = 6
"""Maximum number of time lines."""
LINE_SAMPLES = 260
"""Approximate maximum number of samples per line."""
_LARGEST = 1e300  # replaces infinite values


class Site(NamedTuple):
    """A numeric field of a published state."""

    state: str
    field: str
    element: int | None = None

    @property
    def label(self) -> str:
        """Display name."""
        return f"{self.state}.{self.field}" + ("" if self.element is None else f"[{self.element}]")


Line = tuple[np.ndarray, np.ndarray]
"""Instants (s) and values. Shapes (n,), (n,)."""


def time_lines(
    published: Mapping[str, Sequence[TimedState]], at: float, site: str, wrong: str = ""
) -> list[dict[str, Any]]:
    """Time lines of the injected field, or of the first wrong one, and of those that differ most from the golden run.

    They are in data-flow order after the first.

    Args:
        published: Publications by role of the flight; the result is empty without those of the golden run and of
            another flight.
        at: Instant of the fault (s).
        site: Site of the fault, as text.
        wrong: First field that the injected kernel published wrong, as text; "" = none, or not known.
    """
    near = {role: _near(publications, at) for role, publications in published.items() if publications}
    if "golden" not in near or len(near) < 2:
        return []
    injected = near.get("injected") or near["recovered"]
    own = _numeric_site(site)
    first = [one for one in (own or _numeric_site(wrong),) if one is not None]
    scores = {site: _difference(near["golden"], injected, site) for site in _candidates() if site not in first}
    worst = sorted((site for site in scores if scores[site] > 0), key=lambda site: -scores[site])[
        : MOST_LINES - len(first)
    ]
    shown = first + [site for site in scores if site in worst]
    ends = {role: min(1e-6 * published[role][-1].time_us, at + AFTER) for role in near}
    return [_line(site, near, at, ends, is_site=site == own) for site in shown]


def _near(publications: Sequence[TimedState], at: float) -> dict[str, list[TimedState]]:
    """Publications in the time window around an instant, by state, with the last one before the window."""
    found: dict[str, list[TimedState]] = {}
    for publication in publications:
        time_s = 1e-6 * publication.time_us
        if time_s > at + AFTER:
            break
        own = found.setdefault(publication.state.spec.name, [])
        if time_s < at - BEFORE:
            own.clear()
        own.append(publication)
    return found


def _numeric_site(text: str) -> Site | None:
    """Parse the text of a numeric state field, e.g. "planning.trajectory.x[3]"; None for sites of other kinds."""
    found = re.fullmatch(r"(\w+\.\w+)\.(\w+)(?:\[(\d+)\])?", text)
    if found is None or found[1] not in STATES:
        return None
    spec = STATES[found[1]]
    in_elements = STATES[found[1]].in_elements(found[2])
    if not in_elements and found[2] not in (spec.header_dtype.names or ()):  # e.g. the number of elements
        return None
    return Site(found[1], found[2], int(found[3] or 0) if in_elements else None)


def _candidates() -> list[Site]:
    """Scalar fields of all states except sensor states, in data-flow order."""
    return [
        Site(spec.name, field.name)
        for spec in STATES.values()
        if spec.stage is not Stage.SENSOR
        for field in spec.header
        if field.name != "scan"
    ]


def _samples(own: Mapping[str, Sequence[TimedState]], site: Site) -> Line:
    publications = own.get(site.state, ())
    times = []
    values = []
    for publication in publications:
        if site.element is None:
            part = publication.state.header
        else:
            part = publication.state.elements
        place = site.element or 0
        if place < len(part):
            times.append(1e-6 * publication.time_us)
            values.append(float(part[site.field][place]))
    return np.array(times), np.array(values, np.float64)


def _difference(golden: Mapping[str, Any], injected: Mapping[str, Any], site: Site) -> float:
    """Largest difference at equal instants, relative to the range of the golden run; infinite if not finite."""
    (first_t, first), (second_t, second) = _samples(golden, site), _samples(injected, site)
    if len(first) == 0 or len(second) == 0:
        return 0.0
    held = first[np.clip(np.searchsorted(first_t, second_t + 1e-9, side="right") - 1, 0, None)]
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(second - held)
        apart[(second == held) | (np.isnan(second) & np.isnan(held))] = 0.0
        if np.isfinite(first).any():
            span = float(np.ptp(first[np.isfinite(first)]))
        else:
            span = 0.0
    largest = float(np.nan_to_num(apart, nan=np.inf).max())
    return largest / (span + 1e-3)


def _line(
    site: Site,
    near: Mapping[str, Mapping[str, Sequence[TimedState]]],
    at: float,
    ends: Mapping[str, float],
    *,
    is_site: bool,
) -> dict[str, Any]:
    """One time line; `ends` has the instant until which a flight's last value is held, by role."""
    unit = STATES[site.state].find(site.field).unit
    lines = {role: _thinned(*_held(*_samples(own, site), at - BEFORE, ends[role])) for role, own in near.items()}
    return {
        "label": site.label,
        "unit": "" if unit == "-" else unit,
        "site": is_site,
        "window": [round(at - BEFORE, 4), round(at + AFTER, 4)],
        "data": {
            role: [[round(t, 4) for t in line[0].tolist()], [_number(v) for v in line[1].tolist()]]
            for role, line in lines.items()
        },
    }


def _held(times: np.ndarray, values: np.ndarray, start: float, end: float) -> Line:
    """The samples between two instants (s); a value holds until the next one, the last one until the end."""
    kept = np.append(times[1:], np.inf)[: len(times)] > start
    times = np.maximum(times[kept], start)
    values = values[kept]
    if len(times) and times[-1] < end:
        times = np.append(times, end)
        values = np.append(values, values[-1])
    return times, values


def _thinned(times: np.ndarray, values: np.ndarray) -> Line:
    """Thin samples to about `LINE_SAMPLES`: every n-th, and those next to a jump above half the standard deviation."""
    step = -(-len(times) // LINE_SAMPLES)
    if step <= 1:
        return times, values
    with np.errstate(invalid="ignore", over="ignore"):
        jump = np.abs(np.diff(values, prepend=values[0])) > 0.5 * np.nanstd(values)
    kept = jump | np.append(jump[1:], False)
    kept[::step] = True
    return times[kept], values[kept]


def _number(value: float) -> float | None:
    """A value clipped to `_LARGEST` and rounded to 6 digits; None for NaN."""
    if np.isnan(value):
        return None
    return float(f"{np.clip(value, -_LARGEST, _LARGEST):.6g}")
