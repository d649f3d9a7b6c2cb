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
from mavfi.campaign.plan import RunSpec
from mavfi.campaign.replay import Explanation, flight_again, fly_recorded
from mavfi.campaign.store import Store
from mavfi.faults.fault import Fault
from mavfi.flight.decide import RecoveryPolicy
from mavfi.flight.host import ArmSetup, Flight
from mavfi.mission import MissionSpec, MissionStatus, Scenario
from mavfi.record import FlightLog
from mavfi.report.compared_flights import ComparedFlights
from mavfi.report.explain import (
    Story,
    around,
    detector_name,
    end_of,
    is_failure,
    lines,
    published_field,
    steps,
    verdict,
)
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
MAX_ALARMS = 60
"""Maximum number of alarms marked per flight."""
NEAR = 8.0
"""Distance from the paths within which voxels of a scan are shown (m)."""
MAX_VOXELS = 20_000
"""Maximum number of voxels of a scan."""
_STEP = 5
"""Smallest stride over the rows of a log: 10 Hz."""


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
    data = {"world": world_data(world, courses), "paths": paths, "fault": None, "lines": []}
    # the time lines are around the fault, if one was injected
    for path in paths:
        if path["fault"] is not None:  # the same instant in all flights with the fault
            published = {course.role: course.published for course in courses}
            data["fault"] = path["fault"]
            # what differs first in the output of the injected kernel, if one was injected
            effects = (course.log.kernel for course in courses if course.log.kernel is not None)
            wrong_fields = [published_field(effect.first_difference) for effect in effects if effect.first_difference]
            wrong_field = next(iter(wrong_fields), "")
            data["lines"] = time_lines(published, path["fault"], site, wrong_field)
            break
    return data


def course_data(course: Course) -> dict[str, Any]:
    """Data of a flight: time, position and speed as float32, attitude as int8, end, fault, alarms."""
    log = course.log
    # at most about `SAMPLES` finite rows, with the last one
    rows = log.rows[np.isfinite(log.columns("x", "y", "z", "vx", "vy", "vz")).all(axis=1)]
    step = max(_STEP, -(-len(rows) // SAMPLES))
    rows = rows[np.unique(np.append(np.arange(0, len(rows), step), len(rows) - 1))]
    speed = np.linalg.norm(rows[:, 4:7], axis=1)
    # instants of the fault and of alarms near it
    near, _ = around(log)
    near_times = {alarm.time_s for alarm in near}
    instants = [injection.time_s for injection in log.injections if injection.activated]
    return {
        "role": course.role,
        "label": course.label,
        "n": len(rows),
        "rows": encoded(np.column_stack([rows[:, :4], speed]), "f4"),
        "attitude": encoded(np.clip(127 * np.nan_to_num(rows[:, 7:11]), -127, 127).round(), "i1"),
        "success": log.status is MissionStatus.SUCCESS,
        "status": log.status.words,
        "end": round(float(log.column("time")[-1]), 3),
        "fault": next(iter(instants), None),
        "alarms": [
            [round(alarm.time_s, 3), int(alarm.time_s in near_times), f"{alarm.source}: {alarm.action} {alarm.stage}"]
            for alarm in log.alarms[:MAX_ALARMS]
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
    # a voxel is buried if all six neighbours are solid; those outside the scan count as solid
    solid = np.pad(world.occupied, 1, constant_values=True)
    buried = np.ones_like(world.occupied)
    for axis in range(3):
        for shift in (-1, 1):
            buried &= np.roll(solid, shift, axis)[1:-1, 1:-1, 1:-1]
    cells = np.argwhere(world.occupied & ~buried)
    # nearest first, so that a limit cuts off the farthest
    path = points[np.isfinite(points).all(axis=1)][::_STEP]
    distance = cKDTree(path).query(world.origin + (cells + 0.5) * world.resolution)[0]
    order = np.argsort(distance, kind="stable")[: int((distance < NEAR).sum())]
    nearest: np.ndarray = cells[order[:MAX_VOXELS]]
    return nearest


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
    story: Story
    commands: Sequence[tuple[str, str]]
    data: dict[str, Any]

    @staticmethod
    def of(
        context: str,
        story: Story,
        commands: Sequence[tuple[str, str]],
        courses: Sequence[Course],
        world: World,
        site: str = "",
    ) -> "FlightPage":
        """Create the page of flights of one mission; the first sentence of the story is the verdict."""
        (_, verdict), *rest = story
        if not site:
            title = "A flight without a fault"
        elif is_failure(courses[-1].log.injections):
            title = f"Failure: {site}"
        else:
            title = f"Fault in {site}"
        return FlightPage(title, context, verdict, rest, commands, flight_data(courses, world, site))

    def to_json(self) -> dict[str, Any]:
        """Plain data for the template and scripts."""
        return asdict(self)


def write_flight_page(path: Path, flight: FlightPage) -> Path:
    """Write the page of one flight; `BadInputError` if the file cannot be written."""
    return page.write(path, "flight.html.j2", flight=flight.to_json())


def rendered_flight_page(flight: FlightPage) -> str:
    """The page of one flight, as HTML."""
    return page.render("flight.html.j2", flight=flight.to_json())


# ---- of a flight, and of a run of a ledger, with all publications recorded -------------------------------------------

FAULT = "with the fault"
NO_FAULT = "golden run"


def page_of_result(result: ComparedFlights, setup: ArmSetup, bare: Scenario, command: str) -> FlightPage:
    """Build the page of a flight requested by `mavfi fly`.

    Args:
        result: The flight.
        setup: Its mission, detector and recovery.
        bare: The mission without the detector.
        command: The command that repeats it.
    """
    mission = result.scenario
    context = f"{mission.environment.name} · seed {mission.seed} · autopilot {mission.autopilot.name}"
    commands = []
    if command:
        commands.append(("fly it again", command))
    world = result.flight.world
    if result.golden is None or result.effect is None:
        story: Story = [("verdict", end_of(result.log)), ("flight", f"without a fault; {end_of(result.log)}")]
        return FlightPage.of(context, story, commands, [Course(GOLDEN, NO_FAULT, result.log)], world)

    # the flights, with their publications
    golden = _course(GOLDEN, NO_FAULT, setup, None, result.golden)
    requested = _course(INJECTED, FAULT, setup, result.fault, result.flight)
    if result.detector:
        label = f"{FAULT} and detector {result.detector}"
        requested = Course(RECOVERED, label, requested.log, requested.published)
    courses = [golden, requested]
    if result.unwatched is not None:
        without_detector = ArmSetup(bare, None, RecoveryPolicy())
        courses.insert(1, _course(INJECTED, FAULT, without_detector, result.fault, result.unwatched))

    # the explanation
    text = verdict(result.effect, result.log, result.golden.log)
    if result.unwatched is not None:
        text = f"with detector {result.detector}, {text}; without it: {result.unwatched.log.status.value.lower()}"
    story = [("verdict", text.removesuffix("."))]
    story += steps(
        result.log,
        result.golden.log,
        result.fault,
        result.detector,
        first_difference(golden.published, requested.published),
        departure(result.golden.log, result.log),
        spread(golden.published, requested.published),
    )
    if result.unwatched is not None:
        story.append(("without the detector", end_of(result.unwatched.log)))
    return FlightPage.of(context, story, commands, courses, world, _site(result.fault))


def _course(role: str, label: str, setup: ArmSetup, fault: Fault | None, flight: Flight) -> Course:
    """A flight with its publications."""
    return Course(role, label, flight.log, fly_recorded(setup, fault)[1])


def _site(fault: Fault | None) -> str:
    """Site of a fault, as text; "" = no fault."""
    if fault is None:
        return ""
    return fault.site


def page_of_explanation(directory: Path, explanation: Explanation, partner: str | None, shown: Path) -> FlightPage:
    """Build the page of an injected run, with its golden run and the same fault in another setting.

    Args:
        directory: Folder of the ledger.
        explanation: The run and its golden run.
        partner: Id of a run with the same fault, see `analysis.listing.partner`; None = none.
        shown: Folder to print in commands.
    """
    spec = explanation.spec
    role, label = _role(spec)
    courses = [
        Course(GOLDEN, NO_FAULT, explanation.golden.log, explanation.golden_published),
        Course(role, label, explanation.flight.log, explanation.published),
    ]
    story = lines(explanation)
    if partner is not None:
        with Store.open(directory) as store:
            other = store.run(partner).spec
            log = flight_again(store, other).log
        role, label = _role(other)
        courses.append(Course(role, label, log))
        heading = f"with {detector_name(other)}" if other.detector else "without a detector"
        story.append((heading, f"{end_of(log)}, run {partner}"))
    courses.sort(key=lambda course: (GOLDEN, INJECTED, RECOVERED).index(course.role))
    with Store.open(directory) as store:
        permission = store.permission
    commands = [
        ("fly it again, compare digests", f"mavfi replay {shown} {spec.run_id}{permission}"),
        ("explain it step by step", f"mavfi explain {shown} {spec.run_id}{permission}"),
        ("draw it", f"mavfi explain {shown} {spec.run_id} --picture flight.png{permission}"),
    ]
    context = f"{spec.environment} · seed {spec.seed} · {spec.setting} · {spec.run_id}"
    return FlightPage.of(context, story, commands, courses, explanation.flight.world, _site(spec.fault))


def _role(spec: RunSpec) -> tuple[str, str]:
    """Role and label of a run with a fault."""
    if spec.detector:
        return RECOVERED, f"{FAULT} and detector {detector_name(spec)}"
    return INJECTED, FAULT


def fly_command(
    mission: MissionSpec,
    fault: str | None,
    fault_seed: int | None,
    detector: str,
    profile: str | None,
    models: Path | None,
) -> str:
    """The command line of a flight, with the options that were set."""
    options: dict[str, object] = {"environment": mission.environment, "seed": mission.seed}
    options |= mission.model_dump(mode="json", exclude_unset=True)
    options |= {"fault": fault, "fault_seed": fault_seed}
    if detector != "none":
        options["detector"] = detector
    options |= {"profile": profile, "models": models}
    words = ["mavfi fly"]
    for name, value in options.items():
        if value is None:
            continue
        text = shlex.quote(str(value))
        if isinstance(value, (list, tuple)):
            text = " ".join(map(str, value))
        words.append(f"--{name.replace('_', '-')} {text}")
    return " ".join(words)


# ---- time lines of published fields around a fault: the most affected fields, and their samples --------------------

MAX_LINES = 6
"""Maximum number of time lines."""
LINE_SAMPLES = 260
"""Approximate maximum number of samples per line."""
_LARGEST = 1e300  # replaces infinite values


class FieldSite(NamedTuple):
    """A numeric field of a published state."""

    state: str
    field: str
    element: int | None = None

    @property
    def label(self) -> str:
        """Display name."""
        if self.element is None:
            return f"{self.state}.{self.field}"
        return f"{self.state}.{self.field}[{self.element}]"


TimeSeries = tuple[np.ndarray, np.ndarray]
"""Instants (s) and values. Shapes (n,), (n,)."""


def time_lines(
    published: Mapping[str, Sequence[TimedState]], fault_s: float, site: str, wrong_field: str = ""
) -> list[dict[str, Any]]:
    """Time lines of the injected field, or of the first wrong one, and of those that differ most from the golden run.

    They are in data-flow order after the first.

    Args:
        published: Publications by role of the flight; the result is empty without those of the golden run and of
            another flight.
        fault_s: Instant of the fault (s).
        site: Site of the fault, as text.
        wrong_field: First field that the injected kernel published wrong, as text; "" = none, or not known.
    """
    windows = {role: _window(publications, fault_s) for role, publications in published.items() if publications}
    if GOLDEN not in windows or len(windows) < 2:
        return []
    golden = windows[GOLDEN]
    injected = windows.get(INJECTED) or windows[RECOVERED]

    # the injected field or, if the fault is in no field, the first wrong one
    injected_field = _numeric_site(site)
    first_field = injected_field or _numeric_site(wrong_field)
    fields = []
    if first_field is not None:
        fields.append(first_field)

    # the fields that differ most, in data-flow order, which is that of the candidates
    scores = {field: _difference(golden, injected, field) for field in _candidates() if field != first_field}
    differing_fields = [field for field in scores if scores[field] > 0]
    worst_fields = sorted(differing_fields, key=lambda field: -scores[field])[: MAX_LINES - len(fields)]
    fields += [field for field in differing_fields if field in worst_fields]

    # the lines, each to the end of the flight or of the window
    ends = {role: min(1e-6 * published[role][-1].time_us, fault_s + AFTER) for role in windows}
    return [_line(field, windows, fault_s, ends, is_site=field == injected_field) for field in fields]


def _window(publications: Sequence[TimedState], fault_s: float) -> dict[str, list[TimedState]]:
    """Publications in the time window around the fault, by state, with the last one before the window."""
    by_state: dict[str, list[TimedState]] = {}
    for publication in publications:
        time_s = 1e-6 * publication.time_us
        if time_s > fault_s + AFTER:
            break
        window = by_state.setdefault(publication.state.spec.name, [])
        if time_s < fault_s - BEFORE:
            window.clear()  # only the last one before the window holds into it
        window.append(publication)
    return by_state


def _numeric_site(text: str) -> FieldSite | None:
    """Parse the text of a numeric state field, e.g. "planning.trajectory.x[3]"; None for sites of other kinds."""
    match = re.fullmatch(r"(\w+\.\w+)\.(\w+)(?:\[(\d+)\])?", text)
    if match is None or match[1] not in STATES:
        return None
    state, field, element = match.groups()
    spec = STATES[state]
    if spec.in_elements(field):
        return FieldSite(state, field, int(element or 0))
    if field in (spec.header_dtype.names or ()):
        return FieldSite(state, field)
    return None  # e.g. the number of elements


def _candidates() -> list[FieldSite]:
    """Scalar fields of all states except sensor states, in data-flow order."""
    return [
        FieldSite(spec.name, field.name)
        for spec in STATES.values()
        if spec.stage is not Stage.SENSOR
        for field in spec.header
        if field.name != "scan"
    ]


def _samples(publications: Mapping[str, Sequence[TimedState]], site: FieldSite) -> TimeSeries:
    """Published values of a field; publications whose list is too short for the element are left out."""
    times = []
    values = []
    index = site.element or 0
    for publication in publications.get(site.state, ()):
        state = publication.state
        records = state.header if site.element is None else state.elements
        if index < len(records):
            times.append(1e-6 * publication.time_us)
            values.append(float(records[site.field][index]))
    return np.array(times), np.array(values, np.float64)


def _difference(golden: Mapping[str, Any], injected: Mapping[str, Any], site: FieldSite) -> float:
    """Largest difference at equal instants, relative to the range of the golden run; infinite if not finite."""
    golden_times, golden_values = _samples(golden, site)
    times, values = _samples(injected, site)
    if len(golden_values) == 0 or len(values) == 0:
        return 0.0
    # the golden value that holds at each instant; 1 ns absorbs the rounding of equal instants
    last = np.searchsorted(golden_times, times + 1e-9, side="right") - 1
    expected = golden_values[np.clip(last, 0, None)]
    with np.errstate(invalid="ignore", over="ignore"):
        difference = np.abs(values - expected)
        # infinities and NaNs, too, can be equal
        difference[(values == expected) | (np.isnan(values) & np.isnan(expected))] = 0.0
        finite = golden_values[np.isfinite(golden_values)]
        span = 0.0
        if len(finite):
            span = float(np.ptp(finite))
    largest = float(np.nan_to_num(difference, nan=np.inf).max())
    return largest / (span + 1e-3)  # a field that is constant in the golden run has no range


def _line(
    site: FieldSite,
    windows: Mapping[str, Mapping[str, Sequence[TimedState]]],
    fault_s: float,
    ends: Mapping[str, float],
    *,
    is_site: bool,
) -> dict[str, Any]:
    """One time line; `ends` has the instant until which a flight's last value is held, by role."""
    data = {}
    for role, publications in windows.items():
        samples = _samples(publications, site)
        times, values = _thinned(*_within(*samples, fault_s - BEFORE, ends[role]))
        data[role] = [[round(time, 4) for time in times.tolist()], [_number(value) for value in values.tolist()]]
    unit = STATES[site.state].find(site.field).unit
    if unit == "-":  # a number without a unit
        unit = ""
    return {
        "label": site.label,
        "unit": unit,
        "site": is_site,
        "window": [round(fault_s - BEFORE, 4), round(fault_s + AFTER, 4)],
        "data": data,
    }


def _within(times: np.ndarray, values: np.ndarray, start: float, end: float) -> TimeSeries:
    """The samples between two instants (s); a value holds until the next one, the last one until the end."""
    holds = np.append(times[1:], np.inf)[: len(times)] > start  # its successor comes after the start
    times = np.maximum(times[holds], start)
    values = values[holds]
    if len(times) and times[-1] < end:
        times = np.append(times, end)
        values = np.append(values, values[-1])
    return times, values


def _thinned(times: np.ndarray, values: np.ndarray) -> TimeSeries:
    """Thin samples to about `LINE_SAMPLES`: every n-th, and those next to a jump above half the standard deviation."""
    step = -(-len(times) // LINE_SAMPLES)
    if step <= 1:
        return times, values
    with np.errstate(invalid="ignore", over="ignore"):
        jump = np.abs(np.diff(values, prepend=values[0])) > 0.5 * np.nanstd(values)
    chosen = jump | np.append(jump[1:], False)
    chosen[::step] = True
    return times[chosen], values[chosen]


def _number(value: float) -> float | None:
    """A value clipped to `_LARGEST` and rounded to 6 digits; None for NaN."""
    if np.isnan(value):
        return None
    return float(f"{np.clip(value, -_LARGEST, _LARGEST):.6g}")
