"""`mavfi fly`: one mission, with a fault and a detector if wanted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mavfi.cli import options
from mavfi.cli.console import check_picture, check_seed, check_writable, console, write_json
from mavfi.errors import BadInputError
from mavfi.mission import MissionSpec

if TYPE_CHECKING:
    from mavfi.detectors.detector import Detector
    from mavfi.mission import Scenario
    from mavfi.reports.flight_result import FlightResult

DEFAULT_PROFILE = "paper"


@options.with_mission_options
def fly(  # noqa: PLR0913 - one parameter per option
    mission: MissionSpec,
    fault: options.Fault = None,
    fault_seed: options.FaultSeed = None,
    detector: options.Detector = "none",
    profile: options.Profile = None,
    models: options.Models = None,
    as_json: options.AsJson = False,
    save: options.Save = None,
    picture: options.Picture = None,
) -> None:
    """Fly one mission, and report how it went; with a fault, compared with its golden run.

    Example: [bold]mavfi fly --environment dense --seed 10007 --fault state:planning.waypoint.x:bit=62@20.0[/bold]
    """
    coupling = None if mission.coupling == "inline" else mission.coupling
    check_company(fault, fault_seed, detector, {"--profile": profile, "--models": models, "--coupling": coupling})
    _check_files(save, picture)
    from mavfi.faults.spec import parse

    request = None if fault is None else parse(fault, mission.localization)
    from mavfi.cli.progress import compiling

    with compiling(instrumented=fault is not None and fault.startswith("instruction")):
        from mavfi.api import fly_request
        from mavfi.hosts.loop.compose import resolve

        scenario = resolve(mission)
        watching, label = load_watcher(detector, profile, models, scenario)
        result = fly_request(scenario, request, fault_seed or 0, watching, label, mission.coupling)
    _show(result, as_json, _write(result, save, picture))


def _write(result: FlightResult, save: Path | None, picture: Path | None) -> list[Path]:
    """Write what was asked for; gives the files."""
    if save is not None:
        result.log.save(save)
    if picture is not None:
        from mavfi.reports.picture import draw_flight

        draw_flight(picture, result.flight, result.golden, detector=result.detector)
    return [path for path in (save, picture) if path is not None]


def check_company(fault: str | None, fault_seed: int | None, detector: str, given: dict[str, object]) -> None:
    """Refuse an option that says nothing without another one.

    Raises:
        BadInputError: One line that names both.
    """
    if fault_seed is not None:
        check_seed("--fault-seed", fault_seed)
        if fault is None:
            raise BadInputError(f"--fault-seed: {fault_seed}: no fault to draw; allowed: together with --fault")
    for name, value in given.items():
        if value is not None and detector == "none":
            raise BadInputError(f"{name}: {value}: nothing watches the flight; allowed: together with --detector")


def _check_files(save: Path | None, picture: Path | None) -> None:
    if save is not None and save.suffix.lower() != ".npz":
        raise BadInputError(f"--save: {save}: allowed ending: .npz")
    check_writable(save)
    check_picture(picture)


def load_watcher(
    name: str, profile: str | None, models: Path | None, scenario: Scenario
) -> tuple[Detector | None, str]:  # fmt: skip
    """The detector, and its label: its name, and its profile if it has one."""
    if name == "none":
        return None, ""
    from mavfi.hosts.watching import detector_for

    detector, model = detector_for(scenario, name, profile or DEFAULT_PROFILE, models)
    if model:
        return detector, f"{name} ({profile or DEFAULT_PROFILE})"
    if profile is not None:
        raise BadInputError(f"--profile: {profile}: detector {name!r} has no profiles; allowed: none given")
    return detector, name


def _show(result: FlightResult, as_json: bool, written: list[Path]) -> None:
    if as_json:
        write_json(result.to_json())
        return
    from mavfi.cli.flight_text import panel

    out = console()
    out.print(panel(result))
    for path in written:
        out.print(f"wrote {path}", style="dim", markup=False)
