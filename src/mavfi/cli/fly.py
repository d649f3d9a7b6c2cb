"""`mavfi fly`: fly one mission, optionally with a fault and a detector."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavfi.cli import observing, options
from mavfi.cli.console import FLIGHTS, PAGES, PICTURES, check_file, check_seed, console, say_written, write_json
from mavfi.errors import BadInputError
from mavfi.mission import OF_A_DETECTOR, MissionSpec
from mavfi.plugins import extensions

if TYPE_CHECKING:
    from mavfi.faults.fault import Fault
    from mavfi.flight.host import ArmSetup, Host
    from mavfi.levels.level import Request
    from mavfi.report.flight_result import FlightResult

HELP_PANEL = "Fly and look"
DEFAULT_PROFILE = "paper"
FLY_OPTIONS = "mavfi.fly_options"
"""Group of entry points: objects with `options`, see `with_extra_options`, and `chosen(mission, values)`.

The latter takes the values of all these options, `fault` and `html`, and returns a fault of the extra's own level and
the host that flies the mission, each None if its options ask for none.
"""


@options.with_mission_options
@options.with_extra_options(FLY_OPTIONS, observing.OBSERVERS)
def fly(  # noqa: PLR0913 - one parameter per option
    mission: MissionSpec,
    faults: options.Faults = None,
    fault_seed: options.FaultSeed = None,
    detector: options.Detector = "none",
    profile: options.Profile = None,
    models: options.Models = None,
    as_json: options.AsJson = False,
    save: options.Save = None,
    picture: options.Picture = None,
    html: options.Html = None,
    pace: observing.Pace = observing.REAL_TIME,
    **extra: Any,  # noqa: ANN401 - of the options of extras
) -> None:
    """Fly one mission, with or without a fault and a detector.

    With a fault, it is compared with the golden run: the same mission without it.

    Example: [bold]mavfi fly --environment dense --seed 10007 --fault state:planning.waypoint.x:bit=62@20.0[/bold]
    """
    from mavfi.faults.combined import levels_in

    fault = fault_text(faults)
    # refuse what is not allowed before the flight, and before slow imports
    check_option_dependencies(mission, fault, fault_seed, detector, profile, models)
    if mission.dead_node != "fresh" and not levels_in(fault) & {"instruction", "memory"}:
        reason = "no node can die; allowed: together with --fault instruction:KERNEL or memory:KERNEL"
        raise BadInputError(f"--dead-node: {mission.dead_node}: {reason}")
    observers = observing.chosen_observers(extra, pace, fault)
    check_file("--save", save, FLIGHTS)
    check_file("--picture", picture, PICTURES)
    check_file("--html", html, PAGES)
    request: Request | Fault | None
    request, host = _chosen_by_extras(mission, {"fault": fault, "html": html, **extra})
    from mavfi.levels.level import parse
    from mavfi.report.progress import compiling

    if fault is not None:
        request = parse(fault, mission.localization)

    # fly it; the report of an empty cache covers the imports, which compile some functions
    is_instrumented = bool(mission.protection) or "instruction" in levels_in(fault)
    with compiling(instrumented=is_instrumented, flight=True) as cold:
        from mavfi.api import fly_request
        from mavfi.flight.compose import resolve

        bare = resolve(mission)
        if cold:  # on all processors: the flight itself would compile one function after the other
            from mavfi.campaign.executors.local import LocalExecutor
            from mavfi.campaign.warm_up import compile_flight

            compile_flight(bare, LocalExecutor(os.cpu_count() or 1))
        setup = watched(mission, detector, profile, models)
        with observing.observing(observers, extra, pace) as views:
            result = fly_request(replace(setup, observers=views), request, fault_seed or 0, bare, host)

    # write files, and report
    if save is not None:
        _save(save, result, mission, {"detector": detector, "profile": profile, "models": models})
    if picture is not None:
        from mavfi.report.picture import draw_flight

        if result.unwatched is None:
            draw_flight(picture, result.flight, result.golden, detector=result.detector)
        else:
            draw_flight(picture, result.unwatched, result.golden, result.flight, detector=result.detector)
    if html is not None:
        from mavfi.report.html.flight_page import fly_command, page_of_result, write_flight_page

        command = fly_command(mission, fault, fault_seed, detector, profile, models)
        write_flight_page(html, page_of_result(result, setup, bare, command))
    if as_json:
        write_json(result.to_json())
        return
    from mavfi.cli.flight_text import panel

    console().print(panel(result))
    say_written(save, picture, html)


def fault_text(faults: Sequence[str] | None) -> str | None:
    """The text of all faults of a mission; None without any."""
    from mavfi.faults.combined import AND

    if not faults:
        return None
    return AND.join(faults)


def _save(save: Path, result: FlightResult, mission: MissionSpec, detection: dict[str, Path | str | None]) -> None:
    """Save a flight with its request, from which `mavfi export` flies it again.

    Args:
        save: File to write.
        result: The flight.
        mission: The requested mission.
        detection: Options `detector`, `profile` and `models`.
    """
    models = detection["models"]
    if models is not None:
        detection = detection | {"models": str(Path(models).absolute())}
    fault = None if result.fault is None else result.fault.to_json()
    request = {"mission": mission.model_dump(mode="json", exclude_unset=True), "fault": fault, **detection}
    result.log.meta["request"] = request
    result.log.save(save)


def _chosen_by_extras(mission: MissionSpec, values: dict[str, Any]) -> tuple[Fault | None, Host | None]:
    """The fault and the host that options of extras ask for, see `FLY_OPTIONS`; the first of each counts."""
    fault: Fault | None = None
    host: Host | None = None
    for extra in extensions(FLY_OPTIONS).values():
        chosen_fault, chosen_host = extra.chosen(mission, values)
        fault = chosen_fault if fault is None else fault
        host = chosen_host if host is None else host
    return fault, host


def check_option_dependencies(
    mission: MissionSpec,
    fault: str | None,
    fault_seed: int | None,
    detector: str,
    profile: str | None,
    models: Path | None,
) -> None:
    """Reject options that have no effect without another one."""
    from mavfi.faults.combined import waits_for_alarm

    if fault_seed is not None:
        check_seed("--fault-seed", fault_seed)
        if fault is None:
            raise BadInputError(f"--fault-seed: {fault_seed}: no fault to draw; allowed: together with --fault")
    if detector != "none":
        return
    if waits_for_alarm(fault):
        raise BadInputError(f"--fault: {fault}: nothing raises an alarm; allowed: together with --detector")
    of_a_detector = {"--profile": profile, "--models": models}
    for key in OF_A_DETECTOR:
        if getattr(mission, key) != MissionSpec.model_fields[key].default:
            of_a_detector[options.option_name(key)] = getattr(mission, key)
    for name, value in of_a_detector.items():
        if value is not None:
            raise BadInputError(f"{name}: {value}: nothing watches the flight; allowed: together with --detector")


def watched(mission: MissionSpec, detector: str, profile: str | None, models: Path | None) -> ArmSetup:
    """A mission under a detector; refuses options for which the detector has no use."""
    from mavfi.flight.compose import prepare

    if detector == "none":
        return prepare(mission, None)
    setup = prepare(mission, detector, profile or DEFAULT_PROFILE, models)
    if not setup.model:
        if mission.trained_for:
            text = f"detector {detector!r} is not trained; allowed: none given"
            raise BadInputError(f"--trained-for: {mission.trained_for}: {text}")
        if profile is not None:
            raise BadInputError(f"--profile: {profile}: detector {detector!r} has no profiles; allowed: none given")
    return setup
