"""`mavfi export`: a flight as a file of ROS, PX4, MAVLink or a table; the runs of a campaign as a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli import options
from mavfi.cli.console import check_writable, console, write_json
from mavfi.errors import BadInputError, MavfiError

if TYPE_CHECKING:
    from mavfi.campaign.divergence import Publication
    from mavfi.flight_log import FlightLog
    from mavfi.hosts.host import ArmSetup
    from mavfi.mission import Scenario
    from mavfi.reports.export.timeline import Publications
    from mavfi.sim.environments import World

ENDINGS = (".bag", ".mcap", ".ulg", ".tlog", ".csv")
ROS_ENDINGS = (".bag", ".mcap")
"""Formats with publications, for which the flight is flown again."""
RUNS = (".parquet", ".csv")
"""File name extensions for the runs of a campaign."""


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
            "stations), or .csv; of a campaign .parquet or .csv, a row per run.",
        ),
    ] = Path("flight.mcap"),
    as_json: options.AsJson = False,
) -> None:
    """Export a flight, or the runs of a campaign, for other tools; ROS is not required.

    Files of ROS also have the publications (point cloud, map, path, trajectory) and the golden path: the flight is
    flown again for them.

    Example: [bold]mavfi export flight.npz --to flight.mcap[/bold]

    Example: [bold]mavfi export out/states --to runs.parquet[/bold]
    """
    if flight.is_dir() and not run_id and to.suffix in RUNS:
        _export_runs(flight, to, as_json)
        return
    if to.suffix not in ENDINGS:
        raise BadInputError(f"--to: {to}: allowed: a file that ends in {', '.join(ENDINGS)}")
    if flight.is_dir() and not run_id:
        raise BadInputError(
            f"{flight}: is a folder; name the run, too: mavfi export {flight} RUN_ID; of all runs a table can be "
            f"written: --to runs{RUNS[0]}"
        )
    if run_id and not flight.is_dir():
        raise BadInputError(f"{flight}: is not the folder of a campaign, so there is no run {run_id!r}")
    check_writable(to)
    if to.suffix in ROS_ENDINGS:
        log, count = _write_ros(flight, run_id, to)
    else:
        log = _log(flight, run_id)
        count = _write(log, to)
    unit = "rows" if to.suffix == ".csv" else "messages"
    if as_json:
        write_json({"file": str(to), "written": count, "unit": unit})
        return
    text = f"{to}: {count} {unit}, {float(log.column('time')[-1]):.1f} s of flight, {log.status.label}"
    console().print(text, markup=False, soft_wrap=True)


def _export_runs(directory: Path, to: Path, as_json: bool) -> None:
    """Write one row per run, with all columns of the frame."""
    from mavfi.campaign.analysis.runs import Runs

    check_writable(to)
    frame = Runs.read(directory).frame
    if to.suffix == ".parquet":
        frame.write_parquet(to)
    else:
        frame.write_csv(to)
    if as_json:
        write_json({"file": str(to), "written": frame.height, "unit": "rows"})
        return
    console().print(f"{to}: {frame.height} runs, {frame.width} columns", soft_wrap=True)


def _log(flight: Path, run_id: str) -> FlightLog:
    if run_id:
        from mavfi.campaign.replay import replay

        return replay(flight, run_id).flight.log
    from mavfi.flight_log import FlightLog

    return FlightLog.load(flight)


def _write(log: FlightLog, to: Path) -> int:
    from mavfi.reports.export.files import write_csv
    from mavfi.reports.export.tlog import write_tlog
    from mavfi.reports.export.ulog import write_ulog

    return {".csv": write_csv, ".ulg": write_ulog, ".tlog": write_tlog}[to.suffix](log, to)


def _write_ros(source: Path, run_id: str, to: Path) -> tuple[FlightLog, int]:
    """Write a bag or an mcap file; returns the flight and the number of messages."""
    from mavfi.reports.export.files import write_bag, write_mcap
    from mavfi.reports.export.timeline import timeline

    log, published, golden = _recorded_run(source, run_id) if run_id else _recorded_file(source)
    _, world = _mission_of(log, str(source))
    write = write_bag if to.suffix == ".bag" else write_mcap
    return log, write(timeline(log, world, published, golden), to)


def _recorded_run(directory: Path, run_id: str) -> tuple[FlightLog, Publications, FlightLog | None]:
    """Log, publications and golden run of a run of a campaign."""
    from mavfi.campaign.replay import recorded_again

    flight, published, golden = recorded_again(directory, run_id)
    return flight.log, _publications(flight.log, published), None if golden is None else golden.log


def _publications(log: FlightLog, published: list[Publication]) -> Publications:
    """The publications with the geometry of the map."""
    import numpy as np

    from mavfi.hosts.loop.compose import pipeline_config
    from mavfi.pipeline.kernel import map_grid
    from mavfi.reports.export.timeline import Publications

    scenario, world = _mission_of(log, "flight")
    grid = map_grid(pipeline_config(scenario, world, np.zeros((1, 3))))
    return Publications([(item.time_us, item.state) for item in published], grid)


def _mission_of(log: FlightLog, source: str) -> tuple[Scenario, World]:
    """Scenario and world of a flight."""
    from mavfi.config import parse
    from mavfi.mission import Scenario
    from mavfi.sim.environments import build_world

    scenario = parse(Scenario, log.meta.get("scenario", {}), f"{source}: scenario")
    return scenario, build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)


def _recorded_file(source: Path) -> tuple[FlightLog, Publications | None, FlightLog | None]:
    """Log of a file, with the publications and the golden run of a second flight if that is bit-identical."""
    from mavfi.campaign.replay import fly_recorded
    from mavfi.faults.fault import fault_from_json
    from mavfi.flight_log import FlightLog

    log = FlightLog.load(source)
    scenario, _ = _mission_of(log, str(source))
    request = log.meta.get("request")
    request = request if isinstance(request, dict) and isinstance(request.get("mission"), dict) else {}
    try:
        fault = None if request.get("fault") is None else fault_from_json(request["fault"])
        setup = _setup(request, scenario)
        flight, published = fly_recorded(setup, fault)
        if flight.log.digest() != log.digest():
            raise BadInputError("another flight resulted, e.g. by another version or after edits of a file")
        golden = None if fault is None else fly_recorded(setup, None)[0].log
    except MavfiError as error:
        text = f"{source}: cannot be flown again ({error}); exported without publications and golden path"
        console(error=True).print(text, markup=False, soft_wrap=True)
        return log, None, None
    return log, _publications(log, published), golden


def _setup(request: dict[str, Any], scenario: Scenario) -> ArmSetup:
    """Mission, detector and recovery of a saved flight; without a request, the mission only."""
    from mavfi.cli.fly import load_watcher
    from mavfi.config import parse
    from mavfi.hosts.host import ArmSetup
    from mavfi.hosts.loop.compose import resolve
    from mavfi.hosts.loop.recovery import Recovery
    from mavfi.hosts.watching import with_keys_of
    from mavfi.mission import MissionSpec

    if not request:
        return ArmSetup(scenario)
    detector, models = str(request.get("detector")), request.get("models")
    spec = with_keys_of(parse(MissionSpec, request["mission"], "mission"), detector)
    resolved = resolve(spec)
    watcher, _ = load_watcher(detector, request.get("profile"), None if models is None else Path(models), resolved)
    return ArmSetup(resolved, None if watcher is None else lambda: watcher, Recovery.of(spec))
