"""`mavfi export`: a flight as a ROS, PX4, MAVLink or CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli import options
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

    Recorded = tuple[FlightLog, list[TimedState] | None, FlightLog | None]
    """A flight, its publications, and its golden run; None = unknown."""

_GROUP = "mavfi.exporters"
"""Writers of other formats: functions (log, path) -> number of messages, by file name extension."""
ROS_ENDINGS = (".bag", ".mcap")
"""Formats with publications, for which the flight is flown again."""


class Request(Config):
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
        str, typer.Argument(metavar="[RUN_ID]", help="Run of the campaign; it is flown again.", show_default=False)
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
        raise BadInputError(
            f"{flight}: is a folder; name the run, too: mavfi export {flight} RUN_ID; "
            f"a table of all runs: mavfi runs {flight} --csv"
        )
    if run_id and not is_dir(flight):
        raise BadInputError(f"{flight}: is not the folder of a campaign, so there is no run {run_id!r}")
    check_writable(to)
    read = _recorded if to.suffix in ROS_ENDINGS else _stored
    log, published, golden = read(flight, run_id)
    count = _write(log, to, str(flight), published, golden)
    unit = "rows" if to.suffix == ".csv" else "messages"
    if as_json:
        write_json({"file": str(to), "written": count, "unit": unit})
        return
    text = f"{to}: {count} {unit}, {float(log.column('time')[-1]):.1f} s of flight, {log.status.label}"
    console().print(text, markup=False, soft_wrap=True)


def _stored(source: Path, run_id: str) -> Recorded:
    """The flight alone."""
    if run_id:
        from mavfi.campaign.replay import flight_again
        from mavfi.campaign.store import Store

        with Store.open(source) as store:
            return flight_again(store, store.run(run_id).spec).log, None, None
    from mavfi.record import FlightLog

    return FlightLog.load(source), None, None


def _recorded(source: Path, run_id: str) -> Recorded:
    """The flight with publications and golden run, flown again; a saved flight must be bit-identical to the second."""
    from mavfi.campaign.replay import fly_recorded, recorded_again
    from mavfi.faults.fault import fault_from_json

    if run_id:
        flight, published, reference = recorded_again(source, run_id)
        return flight.log, published, None if reference is None else reference.log
    log, _, _ = _stored(source, "")
    scenario = _scenario(log, str(source))
    try:
        if log.meta.get("request") is None:
            request = None
        else:
            request = parse(Request, log.meta["request"], "request", stored=True)
        if request is None or request.fault is None:
            fault = None
        else:
            fault = fault_from_json(request.fault)
        setup = _setup(request, scenario)
        flight, published = fly_recorded(setup, fault)
        if flight.log.digest() != log.digest():
            raise BadInputError("another flight resulted, e.g. by another version or after edits of a file")
        golden = None if fault is None else fly_recorded(setup, None)[0].log
    except MavfiError as error:
        text = f"{source}: cannot be flown again ({error}); exported without publications and golden path"
        console(error=True).print(text, markup=False, soft_wrap=True)
        return log, None, None
    return log, published, golden


def _setup(request: Request | None, scenario: Scenario) -> ArmSetup:
    """Mission, detector and recovery of a saved flight; without a request, the mission only."""
    from mavfi.cli.fly import watched
    from mavfi.flight.host import ArmSetup

    if request is None:
        return ArmSetup(scenario)
    return watched(request.mission, request.detector, request.profile, request.models).setup


def _write(log: FlightLog, to: Path, source: str, published: list[TimedState] | None, golden: FlightLog | None) -> int:
    """Write a file by its ending; returns the number of messages or rows."""
    from mavfi.extras.logs.files import write_bag, write_csv, write_mcap

    if to.suffix == ".csv":
        return write_csv(log, to)
    if to.suffix not in ROS_ENDINGS:
        count: int = load_object("exporter", to.suffix[1:], _GROUP, {})(log, to)
        return count
    import numpy as np

    from mavfi.extras.logs.timeline import Publications, timeline
    from mavfi.flight.compose import pipeline_config
    from mavfi.pipeline.kernel import map_grid
    from mavfi.sim.environments import build_world

    scenario = _scenario(log, source)
    world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
    publications = None
    if published is not None:
        grid = map_grid(pipeline_config(scenario, world, np.zeros((1, 3))))
        publications = Publications([(item.time_us, item.state) for item in published], grid)
    write = write_bag if to.suffix == ".bag" else write_mcap
    return write(timeline(log, world, publications, golden), to)


def _scenario(log: FlightLog, source: str) -> Scenario:
    from mavfi.mission import Scenario

    return parse(Scenario, log.meta.get("scenario", {}), f"{source}: scenario", stored=True)
