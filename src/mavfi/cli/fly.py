"""`mavfi fly`: one mission, with a fault and a detector if wanted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mavfi.cli import options
from mavfi.cli.console import check_number, check_point, check_seed, check_writable, console, write_json
from mavfi.config import STRONGEST_WIND
from mavfi.errors import BadInputError
from mavfi.states import ODOMETRY

if TYPE_CHECKING:
    from mavfi.cli.flown import Flown
    from mavfi.detectors.detector import Detector
    from mavfi.faults.spec import InstructionRequest, StateRequest
    from mavfi.mission import Scenario

PICTURES = (".png", ".svg", ".pdf")
DEFAULT_PROFILE = "paper"


def fly(  # noqa: PLR0913 - one parameter per option
    environment: options.Environment = "sparse",
    seed: options.Seed = 0,
    start: options.Start = None,
    goal: options.Goal = None,
    stack: options.Stack = "published",
    planner: options.Planner = "rrt_connect",
    platform: options.Platform = "i9-9940x",
    map_kind: options.MapKind = "dense",
    map_resolution: options.MapResolution = None,
    vehicle: options.Vehicle = None,
    v_max: options.VMax = None,
    depth_noise: options.DepthNoise = 0.0,
    wind: options.Wind = 0.0,
    localization: options.Localization = "truth",
    fault: options.Fault = None,
    fault_seed: options.FaultSeed = None,
    detector: options.Detector = "none",
    profile: options.Profile = None,
    models: options.Models = None,
    as_json: options.AsJson = False,
    save: options.Save = None,
    picture: options.Picture = None,
) -> None:
    """Fly one mission, and tell how it went; with a fault, beside its error-free twin.

    Example: [bold]mavfi fly --environment dense --seed 10007 --fault state:planning.waypoint.x:bit=62@20.0[/bold]
    """
    check_seed("--seed", seed)
    check_company(fault, fault_seed, detector, {"--profile": profile, "--models": models})
    check_number("--depth-noise", depth_noise, 0.0, 1.0)
    check_number("--map-resolution", map_resolution, 0.02, 5.0)
    check_number("--wind", wind, 0.0, STRONGEST_WIND)
    check_number("--v-max", v_max, 0.1, 20.0)
    check_point("--start", start)
    check_point("--goal", goal)
    _check_files(save, picture)
    request = _request(fault, known_localization(localization))

    from mavfi.hosts.compose import make_scenario

    scenario = make_scenario(
        environment, seed, stack=stack, platform=platform, planner=planner, vehicle=vehicle, v_max=v_max,
        start=start, goal=goal, depth_noise=depth_noise, map_kind=map_kind, map_resolution=map_resolution, wind=wind,
        localization=localization,
    )  # fmt: skip
    watching, told = load_watcher(detector, profile, models, scenario)
    flown = _fly(scenario, request, fault_seed or 0, watching, told)
    _show(flown, as_json, _write(flown, save, picture))


def _write(flown: Flown, save: Path | None, picture: Path | None) -> list[Path]:
    """Write what was asked for; gives the files."""
    if save is not None:
        flown.flight.log.save(save)
    if picture is not None:
        _draw(flown, picture)
    return [path for path in (save, picture) if path is not None]


def check_company(fault: str | None, fault_seed: int | None, detector: str, options: dict[str, object]) -> None:
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


def _check_files(save: Path | None, picture: Path | None) -> None:
    if save is not None and save.suffix.lower() != ".npz":
        raise BadInputError(f"--save: {save}: allowed ending: .npz")
    check_writable(save)
    if picture is not None and picture.suffix.lower() not in PICTURES:
        raise BadInputError(f"--picture: {picture}: allowed endings: {', '.join(PICTURES)}")
    check_writable(picture)


def known_localization(name: str) -> str:
    """The same name.

    Raises:
        BadInputError: There is no such localization.
    """
    if name not in ODOMETRY:
        raise BadInputError(f"--localization: {name!r}: allowed: {', '.join(ODOMETRY)}")
    return name


def _request(text: str | None, localization: str) -> StateRequest | InstructionRequest | None:
    if text is None:
        return None
    from mavfi.faults.spec import parse

    return parse(text, localization)


def load_watcher(
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
    scenario: Scenario,
    request: StateRequest | InstructionRequest | None,
    fault_seed: int,
    detector: Detector | None,
    watching: str,
) -> Flown:
    """The golden twin first, then the draw of the fault from what happens in it, then the flight."""
    from mavfi.cli.flown import Flown
    from mavfi.faults.spec import InstructionRequest
    from mavfi.hosts.inprocess import fly as fly_mission

    if request is None:
        return Flown(scenario, fly_mission(scenario, None, detector), None, None, watching)
    if isinstance(request, InstructionRequest):
        return _fly_instruction(scenario, request, fault_seed, detector, watching)
    golden = fly_mission(scenario, None, detector, want_profile=detector is None)
    profile = golden.profile
    if request.needs_profile and detector is not None:
        profile = fly_mission(scenario, want_profile=True).profile  # as campaigns draw: nothing watches
    fault = request.resolve(fault_seed, scenario.stack.name, profile)
    return Flown(scenario, fly_mission(scenario, fault, detector), golden, fault, watching)


def _fly_instruction(
    scenario: Scenario, request: InstructionRequest, fault_seed: int, detector: Detector | None, watching: str
) -> Flown:  # fmt: skip
    """The same for a fault in an instruction."""
    from mavfi.campaign.samplers.instruction import draw_instruction_faults
    from mavfi.cli.flown import Flown
    from mavfi.hosts.instruction import fly_instruction_faults

    drawn = draw_instruction_faults(scenario, request, seed=fault_seed)
    fault = drawn.faults[request.kernel][0]
    if not fault.has_site:
        raise BadInputError(
            f"--fault: instruction:{request.kernel}: this mission executes no instruction {request.which!r} there; "
            "allowed: a class that it executes"
        )
    flown = fly_instruction_faults(scenario, [fault], detector, drawn.golden if detector is None else None)
    return Flown(scenario, flown.flights[0], flown.golden, fault, watching)


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
