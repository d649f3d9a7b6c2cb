"""`mavfi fly`: one mission, with a fault and a detector if wanted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavfi.cli.console import JSON_HELP, check_number, check_point, check_seed, check_writable, console, write_json
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.cli.flown import Flown
    from mavfi.detectors.detector import Detector
    from mavfi.faults.spec import FaultRequest
    from mavfi.mission import Scenario

PICTURES = (".png", ".svg", ".pdf")
DEFAULT_PROFILE = "paper"


def fly(  # noqa: PLR0913 - one parameter per option
    environment: Annotated[
        str, typer.Option(help="Name, a YAML file, or a scanned map (.bt, .ot of OctoMap).")
    ] = "sparse",
    seed: Annotated[int, typer.Option(help="All randomness of the mission comes from it.")] = 0,
    start: Annotated[
        tuple[float, float, float] | None, typer.Option(metavar="X Y Z", help="m, instead of the environment's.")
    ] = None,
    goal: Annotated[
        tuple[float, float, float] | None, typer.Option(metavar="X Y Z", help="m, instead of the environment's.")
    ] = None,
    stack: Annotated[str, typer.Option(help="published, hardened, or a YAML file.")] = "published",
    planner: Annotated[
        str, typer.Option(help="rrt, rrt_connect, rrt_star, a YAML file, or package:Class.")
    ] = "rrt_connect",
    platform: Annotated[
        str, typer.Option(help="Computer whose latencies are charged: a name, or a YAML file.")
    ] = "i9-9940x",
    map_kind: Annotated[
        str, typer.Option("--map", help="Where the map keeps its log-odds: dense or octree.")
    ] = "dense",
    v_max: Annotated[float | None, typer.Option(help="Speed limit, m/s; the environment's by default.")] = None,
    depth_noise: Annotated[float, typer.Option(help="Of the depth camera: standard deviation / range.")] = 0.0,
    fault: Annotated[
        str | None, typer.Option(metavar="SPEC", help=r"null, or state:STATE[.FIELD][[ELEMENT]][:bit=N]\[@SECONDS].")
    ] = None,
    fault_seed: Annotated[
        int | None, typer.Option(help="Draws what the fault does not name: instant, element, bit; 0 by default.")
    ] = None,
    detector: Annotated[
        str, typer.Option(help="gaussian, autoencoder, another entry point, or package:Class.")
    ] = "none",
    profile: Annotated[str | None, typer.Option(help="Of the detector: paper (the default) or tuned.")] = None,
    models: Annotated[Path | None, typer.Option(help="Folder of trained models; the shipped ones by default.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help=JSON_HELP)] = False,
    save: Annotated[Path | None, typer.Option(metavar="FILE.npz", help="Write the whole record of the flight.")] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw the flight from above and from the side.")
    ] = None,
) -> None:
    """Fly one mission, and tell how it went; with a fault, beside its error-free twin.

    Example: [bold]mavfi fly --environment dense --seed 10007 --fault state:planning.waypoint.x:bit=62@20.0[/bold]
    """
    check_seed("--seed", seed)
    _check_company(fault, fault_seed, detector, {"--profile": profile, "--models": models})
    check_number("--depth-noise", depth_noise, 0.0, 1.0)
    check_number("--v-max", v_max, 0.1, 20.0)
    check_point("--start", start)
    check_point("--goal", goal)
    _check_save(save)
    _check_picture(picture)
    request = _request(fault)

    from mavfi.hosts.compose import make_scenario

    scenario = make_scenario(
        environment, seed, stack=stack, platform=platform, planner=planner, v_max=v_max, start=start, goal=goal,
        depth_noise=depth_noise, map_kind=map_kind,
    )  # fmt: skip
    watching, told = _load(detector, profile, models, scenario)
    flown = _fly(scenario, request, fault_seed or 0, watching, told)
    _show(flown, as_json, _write(flown, save, picture))


def _write(flown: Flown, save: Path | None, picture: Path | None) -> list[Path]:
    """Write what was asked for; gives the files."""
    if save is not None:
        flown.flight.log.save(save)
    if picture is not None:
        _draw(flown, picture)
    return [path for path in (save, picture) if path is not None]


def _check_company(fault: str | None, fault_seed: int | None, detector: str, options: dict[str, object]) -> None:
    """Refuse an option that says nothing without another one.

    Raises:
        BadInputError: One line that names both.
    """
    if fault_seed is not None:
        check_seed("--fault-seed", fault_seed)
        if fault is None:
            raise BadInputError(f"--fault-seed: {fault_seed}: no fault to draw; allowed: together with --fault")
    for name, value in options.items():
        if value is not None and detector == "none":
            raise BadInputError(f"{name}: {value}: nothing watches the flight; allowed: together with --detector")


def _check_save(path: Path | None) -> None:
    if path is not None and path.suffix.lower() != ".npz":
        raise BadInputError(f"--save: {path}: allowed ending: .npz")
    check_writable(path)


def _check_picture(path: Path | None) -> None:
    if path is not None and path.suffix.lower() not in PICTURES:
        raise BadInputError(f"--picture: {path}: allowed endings: {', '.join(PICTURES)}")
    check_writable(path)


def _request(text: str | None) -> FaultRequest | None:
    if text is None:
        return None
    from mavfi.faults.spec import parse

    return parse(text)


def _load(
    name: str, profile: str | None, models: Path | None, scenario: Scenario
) -> tuple[Detector | None, str]:  # fmt: skip
    """The detector, and what is told of it: its name, and its profile if it has one."""
    if name == "none":
        return None, ""
    from mavfi.campaign.tools import host_tools

    detector, model = host_tools().load_detector(name, profile or DEFAULT_PROFILE, models, scenario)
    if model:
        return detector, f"{name} ({profile or DEFAULT_PROFILE})"
    if profile is not None:
        raise BadInputError(f"--profile: {profile}: detector {name!r} has no profiles; allowed: none given")
    return detector, name


def _fly(
    scenario: Scenario, request: FaultRequest | None, fault_seed: int, detector: Detector | None, watching: str
) -> Flown:
    """The golden twin first, then the draw of the fault from its publications, then the flight."""
    from mavfi.cli.flown import Flown
    from mavfi.hosts.inprocess import fly as fly_mission

    if request is None:
        return Flown(scenario, fly_mission(scenario, None, detector), None, None, watching)
    golden = fly_mission(scenario, None, detector, want_profile=detector is None)
    profile = golden.profile
    if request.needs_profile and detector is not None:
        profile = fly_mission(scenario, want_profile=True).profile  # as campaigns draw: nothing watches
    fault = request.resolve(fault_seed, scenario.stack.name, profile)
    return Flown(scenario, fly_mission(scenario, fault, detector), golden, fault, watching)


def _draw(flown: Flown, path: Path) -> None:
    from mavfi.reports.picture import draw_flight

    draw_flight(path, flown.flight, flown.golden)


def _show(flown: Flown, as_json: bool, written: list[Path]) -> None:
    from mavfi.cli.flown import to_json

    if as_json:
        write_json(to_json(flown))
        return
    from mavfi.cli.flight_text import panel

    out = console()
    out.print(panel(flown))
    for path in written:
        out.print(f"[dim]wrote[/dim] {path}")
