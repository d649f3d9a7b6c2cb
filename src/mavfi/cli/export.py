"""`mavfi export`: a flight as a ROS bag, an mcap file or a table; the runs of a campaign as a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavfi.cli import options
from mavfi.cli.console import check_writable, console, write_json
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.flight_log import FlightLog

ENDINGS = (".bag", ".mcap", ".csv")
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
            help=".bag (ROS 1), .mcap (ROS 2, Foxglove, PlotJuggler), or .csv; of a campaign .parquet or .csv, a row "
            "per run.",
        ),
    ] = Path("flight.mcap"),
    as_json: options.AsJson = False,
) -> None:
    """Export a flight, or the runs of a campaign, for other tools; ROS is not required.

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
    log = _log(flight, run_id)
    count, unit = _write(log, to, str(flight)), "rows" if to.suffix == ".csv" else "messages"
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


def _write(log: FlightLog, to: Path, source: str) -> int:
    from mavfi.reports.export.files import write_bag, write_csv, write_mcap

    if to.suffix == ".csv":
        return write_csv(log, to)
    from mavfi.config import parse
    from mavfi.mission import Scenario
    from mavfi.reports.export.timeline import timeline
    from mavfi.sim.environments import build_world

    scenario = parse(Scenario, log.meta.get("scenario", {}), f"{source}: scenario")
    world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
    write = write_bag if to.suffix == ".bag" else write_mcap
    return write(timeline(log, world), to)
