"""`mavfi fly`: one mission, with a fault and a detector if wanted."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from mavfi.cli.console import JSON_HELP, check_number, check_point, check_seed, check_writable, console, write_json
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.detectors.detector import Detector
    from mavfi.faults.fault import Fault
    from mavfi.faults.spec import FaultRequest
    from mavfi.hosts.inprocess import Flight
    from mavfi.mission import Scenario

PICTURES = (".png", ".svg", ".pdf")


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


def fly(  # noqa: PLR0913 - one parameter per option
    environment: str = typer.Option("sparse", help="Name, a YAML file, or a scanned map (.bt, .ot of OctoMap)."),
    seed: int = typer.Option(0, help="All randomness of the mission comes from it."),
    start: tuple[float, float, float] = typer.Option(None, metavar="X Y Z", help="m, instead of the environment's."),
    goal: tuple[float, float, float] = typer.Option(None, metavar="X Y Z", help="m, instead of the environment's."),
    stack: str = typer.Option("published", help="published, hardened, or a YAML file."),
    planner: str = typer.Option("rrt_connect", help="Name, or package:Class."),
    platform: str = typer.Option("i9-9940x", help="Computer whose latencies are charged: a name, or a YAML file."),
    v_max: float = typer.Option(None, help="Speed limit, m/s; the environment's by default."),
    depth_noise: float = typer.Option(0.0, help="Of the depth camera: standard deviation / range."),
    fault: str = typer.Option(None, metavar="SPEC", help="null, or state:STATE[.FIELD][[ELEMENT]][:bit=N][@SECONDS]."),
    fault_seed: int = typer.Option(0, help="Draws what the fault does not name: instant, element, bit."),
    detector: str = typer.Option("none", help="gaussian, autoencoder, another entry point, or package:Class."),
    profile: str = typer.Option("paper", help="Of the detector: paper or tuned."),
    models: Path = typer.Option(None, help="Folder of trained models; the shipped ones by default."),
    as_json: bool = typer.Option(False, "--json", help=JSON_HELP),
    save: Path = typer.Option(None, metavar="FILE.npz", help="Write the whole record of the flight."),
    picture: Path = typer.Option(None, metavar="FILE.png", help="Draw the flight from above and from the side."),
) -> None:
    """Fly one mission, and tell how it went; with a fault, beside its error-free twin.

    Example: [bold]mavfi fly --environment dense --seed 10007 --fault state:planning.waypoint.x:bit=62@20.0[/bold]
    """
    check_seed("--seed", seed)
    check_seed("--fault-seed", fault_seed)
    check_number("--depth-noise", depth_noise, 0.0, 1.0)
    check_number("--v-max", v_max, 0.1, 20.0)
    check_point("--start", start)
    check_point("--goal", goal)
    check_writable(save)
    _check_picture(picture)
    request = _request(fault)

    from mavfi.hosts.compose import make_scenario

    scenario = make_scenario(
        environment, seed, stack=stack, platform=platform, planner=planner, v_max=v_max, start=start, goal=goal,
        depth_noise=depth_noise,
    )  # fmt: skip
    watching = _load(detector, profile, models, scenario)
    flown = _fly(scenario, request, fault_seed, watching, "" if watching is None else f"{detector} ({profile})")
    if save is not None:
        flown.flight.log.save(save)
    if picture is not None:
        _draw(flown, picture)
    if as_json:
        write_json(to_json(flown))
    else:
        _show(flown, [path for path in (save, picture) if path is not None])


def _check_picture(path: Path | None) -> None:
    if path is not None and path.suffix.lower() not in PICTURES:
        raise BadInputError(f"--picture: {path}: allowed endings: {', '.join(PICTURES)}")
    check_writable(path)


def _request(text: str | None) -> FaultRequest | None:
    if text is None:
        return None
    from mavfi.faults.spec import parse

    return parse(text)


def _load(name: str, profile: str, models: Path | None, scenario: Scenario) -> Detector | None:
    if name == "none":
        return None
    from mavfi.campaign.tools import host_tools

    return host_tools().load_detector(name, profile, models, scenario)[0]


def _fly(
    scenario: Scenario, request: FaultRequest | None, fault_seed: int, detector: Detector | None, watching: str
) -> Flown:
    """The golden twin first, then the draw of the fault from its publications, then the flight."""
    from mavfi.hosts.inprocess import fly as fly_mission

    if request is None:
        return Flown(scenario, fly_mission(scenario, None, detector), None, None, watching)
    golden = fly_mission(scenario, None, detector, want_profile=detector is None)
    profile = golden.profile
    if request.needs_profile and detector is not None:
        profile = fly_mission(scenario, want_profile=True).profile  # as campaigns draw: nothing watches
    fault = request.resolve(fault_seed, scenario.stack.name, profile)
    return Flown(scenario, fly_mission(scenario, fault, detector), golden, fault, watching)


def to_json(flown: Flown) -> dict[str, Any]:
    """What `--json` prints.

    Returns:
        status, status_text, flight_time_s, energy_j, distance_m, battery_used, digest, injections, alarms, replans,
        events (counts by kind), what flew (environment, seed, stack, platform, planner, v_max, detector, start, goal,
        course_m, time_limit_s), fault, outcome, and golden (of the error-free twin: the figures), the last three null
        for a golden flight.
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
        "v_max": scenario.v_max,
        "detector": flown.detector,
        **{key: log.meta[key] for key in ("start", "goal", "course_m", "time_limit_s")},
        "fault": None if flown.fault is None else flown.fault.to_json(),
        "outcome": outcome(flown),
        "golden": None if flown.golden is None else _figures(flown.golden),
    }


def _figures(flight: Flight) -> dict[str, Any]:
    from mavfi.qof import quality_of_flight

    status = flight.log.status
    quality = asdict(quality_of_flight(flight.log))
    return {"status": status.label, "status_text": status.value, **quality, "digest": flight.log.digest()}


def replans(flight: Flight) -> int:
    """Plans after the first one."""
    return max(0, flight.log.count("plan") - 1)


def outcome(flown: Flown) -> str | None:
    """What the fault did, against the golden twin; None for a golden flight."""
    from mavfi.outcomes import FlightEnd, classify

    if flown.golden is None:
        return None
    return classify(FlightEnd(flown.golden.log.digest()), FlightEnd(flown.flight.log.digest())).label


def _draw(flown: Flown, path: Path) -> None:
    from mavfi.reports.picture import draw_flight

    draw_flight(path, flown.flight, flown.golden)


def _show(flown: Flown, written: list[Path]) -> None:
    from mavfi.cli.flight_text import panel

    out = console()
    out.print(panel(flown))
    for path in written:
        out.print(f"[dim]wrote[/dim] {path}")
