"""`mavfi export`: a flight as a ROS, PX4, MAVLink or CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from mavfi.cli import completion, options
from mavfi.cli.console import check_writable, console, write_json
from mavfi.config import Config, parse
from mavfi.errors import BadInputError, MavfiError
from mavfi.files import is_dir
from mavfi.mission import MissionSpec
from mavfi.plugins import known, load_object

if TYPE_CHECKING:
    from mavfi.campaign.divergence import TimedState
    from mavfi.flight.host import ArmSetup
    from mavfi.mission import Scenario
    from mavfi.record import FlightLog


HELP_PANEL = "Fly and look"
_GROUP = "mavfi.exporters"
"""Writers of other formats: functions (log, path) -> number of messages, by file name extension."""
ROS_ENDINGS = (".bag", ".mcap")
"""Formats with publications, for which the flight is flown again."""


class ExportedFlight(NamedTuple):
    """A flight to be exported, its publications, and the log of its golden run; None = unknown."""

    log: FlightLog
    published: list[TimedState] | None = None
    golden: FlightLog | None = None


class SavedRequest(Config):
    """What a saved flight was flown with, as stored by `mavfi fly --save`."""

    mission: MissionSpec
    fault: dict[str, Any] | None = None
    detector: str = "none"
    profile: str | None = None
    models: Path | None = None


def export(
    flight: Annotated[
        Path, typer.Argument(metavar="FLIGHT.npz|DIR", help="What `mavfi fly --save` wrote, or a campaign's folder.")
    ],
    run_id: Annotated[
        str,
        typer.Argument(
            metavar="[RUN]",
            help="Run of the campaign, by number or id; it is flown again.",
            show_default=False,
            autocompletion=completion.run_id,
        ),
    ] = "",
    to: Annotated[
        Path,
        typer.Option(
            metavar="FILE",
            help=".bag (ROS 1), .mcap (ROS 2, Foxglove, PlotJuggler), .ulg (PX4, Flight Review), .tlog (ground "
            "stations), or .csv.",
        ),
    ] = Path("flight.mcap"),
    as_json: options.AsJson = False,
) -> None:
    """Export a flight for other tools; ROS is not required.

    ROS files also have the publications (point cloud, map, path, trajectory) and the golden path, for which the flight
    is flown again.

    Example: [bold]mavfi export flight.npz --to flight.mcap[/bold]
    """
    endings = (*ROS_ENDINGS, *(f".{ending}" for ending in sorted(known(_GROUP, {}), reverse=True)), ".csv")
    if to.suffix not in endings:
        raise BadInputError(f"--to: {to}: allowed: a file that ends in {', '.join(endings)}")
    if is_dir(flight) and not run_id:
        from mavfi.campaign.store import Store

        Store.open(flight).close()  # refuses a folder without a campaign: the commands below would, too
        raise BadInputError(
            f"{flight}: is a folder; name the run, too: mavfi export {flight} RUN_ID; "
            f"a table of all runs: mavfi runs {flight} --csv"
        )
    if run_id and not is_dir(flight):
        raise BadInputError(f"{flight}: is not the folder of a campaign, so there is no run {run_id!r}")
    check_writable(to)
    if to.suffix in ROS_ENDINGS:
        exported = _fly_recorded(flight, run_id)
    else:
        exported = ExportedFlight(_log_of(flight, run_id))
    count = _write(exported, to, str(flight))
    log = exported.log
    unit = "messages"
    if to.suffix == ".csv":
        unit = "rows"
    if as_json:
        write_json({"file": str(to), "written": count, "unit": unit})
        return
    text = f"{to}: {count} {unit}, {float(log.column('time')[-1]):.1f} s of flight, {log.status.label}"
    console().print(text, markup=False, soft_wrap=True)


def _log_of(source: Path, run_id: str) -> FlightLog:
    """The log of a saved flight, or of a run of a campaign, which is flown again."""
    if run_id:
        from mavfi.campaign.replay import flight_again
        from mavfi.campaign.store import Store

        with Store.open(source) as store:
            return flight_again(store, store.run(run_id).spec).log
    from mavfi.record import FlightLog

    return FlightLog.load(source)


def _fly_recorded(source: Path, run_id: str) -> ExportedFlight:
    """The flight with publications and golden run, flown again; a saved flight must be bit-identical to the second."""
    from mavfi.campaign.replay import fly_recorded, recorded_again
    from mavfi.faults.fault import fault_from_json

    if run_id:
        flight, published, reference = recorded_again(source, run_id)
        if reference is None:
            return ExportedFlight(flight.log, published)
        return ExportedFlight(flight.log, published, reference.log)
    log = _log_of(source, "")
    scenario = _scenario(log, str(source))
    try:
        # Fly it again, with the fault and detector of its request.
        request = None
        fault = None
        if log.meta.get("request") is not None:
            request = parse(SavedRequest, log.meta["request"], "request", stored=True)
            if request.fault is not None:
                fault = fault_from_json(request.fault)
        setup = _setup(request, scenario)
        flight, published = fly_recorded(setup, fault)
        if flight.log.digest() != log.digest():
            raise BadInputError("another flight resulted, e.g. by another version or after edits of a file")
        # Its golden run: the flight itself if it has no fault.
        golden = None
        if fault is not None:
            golden = fly_recorded(setup, None)[0].log
    except MavfiError as error:
        text = f"{source}: cannot be flown again ({error}); exported without publications and golden path"
        console(error=True).print(text, markup=False, soft_wrap=True)
        return ExportedFlight(log)
    return ExportedFlight(log, published, golden)


def _setup(request: SavedRequest | None, scenario: Scenario) -> ArmSetup:
    """Mission, detector and recovery of a saved flight; without a request, the mission only."""
    from mavfi.cli.fly import watched
    from mavfi.flight.host import ArmSetup

    if request is None:
        return ArmSetup(scenario)
    return watched(request.mission, request.detector, request.profile, request.models)


def _write(exported: ExportedFlight, to: Path, source: str) -> int:
    """Write a file by its ending; returns the number of messages or rows.  Errors name the `source`."""
    from mavfi.extras.logs.files import write_bag, write_csv, write_mcap

    log = exported.log
    if to.suffix == ".csv":
        return write_csv(log, to)
    if to.suffix not in ROS_ENDINGS:
        count: int = load_object("exporter", to.suffix[1:], _GROUP, {})(log, to)
        return count
    import numpy as np

    from mavfi.extras.logs.timeline import PublishedStates, timeline
    from mavfi.flight.compose import pipeline_config
    from mavfi.pipeline.kernel import map_grid
    from mavfi.sim.environments import scenario_world

    # Messages of the flight in its world.
    scenario = _scenario(log, source)
    world = scenario_world(scenario)
    publications = None
    if exported.published is not None:
        grid = map_grid(pipeline_config(scenario, world, np.zeros((1, 3))))
        publications = PublishedStates([(item.time_us, item.state) for item in exported.published], grid)
    messages = timeline(log, world, publications, exported.golden)
    if to.suffix == ".bag":
        return write_bag(messages, to)
    return write_mcap(messages, to)


def _scenario(log: FlightLog, source: str) -> Scenario:
    """The mission of a flight."""
    from mavfi.mission import Scenario

    return parse(Scenario, log.meta.get("scenario", {}), f"{source}: scenario", stored=True)
