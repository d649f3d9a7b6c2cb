"""Flight pages for `mavfi fly`, `explain` and `report`: replay flights with all publications recorded."""

import shlex
from pathlib import Path

from mavfi.campaign.divergence import departure, first_difference, spread
from mavfi.campaign.replay import Explanation, flight_again, fly_recorded
from mavfi.campaign.store import Store
from mavfi.faults.fault import Fault
from mavfi.flight.decide import Recovery
from mavfi.flight.host import ArmSetup, Flight
from mavfi.mission import MissionSpec, Scenario
from mavfi.report.explain import Lines, detector_name, end_of, lines, steps, verdict
from mavfi.report.flight_result import FlightResult
from mavfi.report.html.flight_data import GOLDEN, INJECTED, RECOVERED, Course
from mavfi.report.html.flight_page import FlightPage

FAULT, NO_FAULT = "with the fault", "golden run"


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
    courses = [golden, alone] if result.unwatched is None else [golden, alone, watched]
    seen, logs = (golden.published, watched.published), (result.golden.log, result.log)
    first = first_difference(*seen)
    judged = verdict(result.effect, result.log, result.golden.log)
    if result.unwatched is not None:
        judged = f"with detector {result.detector}, {judged}; without it: {result.unwatched.log.status.value.lower()}"
    story = [("verdict", judged.removesuffix("."))]
    story += steps(
        result.log, result.golden.log, result.fault, result.detector, first, departure(*logs),
        spread(*seen),
    )  # fmt: skip
    if result.unwatched is not None:
        story.append(("without the detector", end_of(result.unwatched.log)))
    return FlightPage.of(context, story, commands, courses, result.flight.world, _site(result.fault))


def _course(role: str, label: str, setup: ArmSetup, fault: Fault | None, flight: Flight) -> Course:
    """A flight with its publications."""
    return Course(role, label, flight.log, fly_recorded(setup, fault)[1])


def _site(fault: Fault | None) -> str:
    return "" if fault is None else fault.site


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
        what = f"with {detector_name(other)}" if other.detector else "without a detector"
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
    return (RECOVERED, f"{FAULT} and detector {name}") if detector else (INJECTED, FAULT)


def fly_command(
    mission: MissionSpec, fault: str | None, fault_seed: int | None, detector: str, profile: str | None,
    models: Path | None,
) -> str:  # fmt: skip
    """The command line of a flight, with the options that were set."""
    given: dict[str, object] = {"environment": mission.environment, "seed": mission.seed}
    given |= mission.model_dump(mode="json", exclude_unset=True)
    given |= {"fault": fault, "fault_seed": fault_seed, "detector": None if detector == "none" else detector}
    given |= {"profile": profile, "models": models}
    words = [f"--{name.replace('_', '-')} {_word(value)}" for name, value in given.items() if value is not None]
    return " ".join(["mavfi fly", *words])


def _word(value: object) -> str:
    return " ".join(map(str, value)) if isinstance(value, (list, tuple)) else shlex.quote(str(value))
