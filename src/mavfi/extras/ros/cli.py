"""`mavfi ros`: the pipeline as real ROS nodes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavfi.cli import options
from mavfi.cli.console import FLIGHTS, check_file, check_number, console, write_json
from mavfi.cli.fly import check_company, watched
from mavfi.cli.stopping import stoppable
from mavfi.extras.registers.cli import RegistersOption, SeedOption, instant
from mavfi.extras.ros import cli_attach as ros_attach
from mavfi.extras.ros import cli_nodes as ros_nodes
from mavfi.mission import MissionSpec

if TYPE_CHECKING:
    from mavfi.extras.ros.ros1.host import RosFlight
    from mavfi.extras.ros.ros1.plan import Plan
    from mavfi.report.flight_result import FlightResult

_NODE_EVENTS = {"node_lost": "lost", "node_back": "back", "node_absent": "still away"}

app = typer.Typer(no_args_is_help=True)
app.command("list")(ros_attach.list_graph)
app.command("corrupt")(ros_attach.corrupt)
app.command("watch")(ros_attach.watch)


@app.callback()
def _ros() -> None:
    """The pipeline as real ROS 1 nodes (Debian's packages: `make ros`), and tools for any ROS application.

    Example: [bold]mavfi ros fly --environment sparse --seed 7 --kill octomap@20[/bold]
    """


@app.command("fly")
@options.with_mission_options
def fly(  # noqa: PLR0913 - one parameter per option
    mission: MissionSpec,
    fault: Annotated[
        str | None, typer.Option(metavar="SPEC", help=f"state:PLACE, sensor:UNIT:TYPE, or null; {options.FORMS}")
    ] = None,
    fault_seed: options.FaultSeed = None,
    detector: options.Detector = "none",
    profile: options.Profile = None,
    models: options.Models = None,
    pace: Annotated[
        float, typer.Option(help="Flight time per wall time, to look at it; 0 = as fast as possible.")
    ] = 0.0,
    kill: ros_nodes.KillOption = None,
    register_fault: ros_nodes.FaultOption = None,
    registers: RegistersOption = None,
    register_seed: SeedOption = None,
    allow_bind_all: Annotated[
        bool, typer.Option("--allow-bind-all", help="Fly even where there can be no private network.")
    ] = False,
    as_json: options.AsJson = False,
    save: options.Save = None,
) -> None:
    """Fly one mission with every kernel, the world, the injector and the detector as separate ROS nodes.

    Bit-identical to the flight of `mavfi fly`.

    Example: [bold]mavfi ros fly --environment sparse --seed 7 --kill octomap@20[/bold]
    """
    mission = ros_nodes.mission_with(mission, detector)
    check_company(mission, fault, fault_seed, detector, profile, models)
    check_file("--save", save, FLIGHTS)
    check_number("--pace", pace, 0, 1000)
    request = ros_nodes.request_of(fault, mission)
    kills = tuple(instant("--kill", text) for text in kill or ())
    faults = ros_nodes.register_faults(register_fault or (), registers, register_seed)
    from mavfi.extras.ros.ros1 import finder

    finder.require()
    from mavfi.extras.ros.ros1.host import configure
    from mavfi.extras.ros.ros1.plan import Plan

    setup, label, _ = watched(mission, detector, profile, models)
    plan = Plan(
        setup.scenario, configure(setup.scenario), ros_nodes.drawn(setup.scenario, request, fault_seed),
        setup.detector(), setup.recovery, kills, register_faults=faults, pace=pace,
    )  # fmt: skip
    ros_nodes.check(plan)
    with stoppable("Stopped; every process of the flight has ended."):
        result, flight = _fly(plan, label, allow_bind_all, quiet=as_json)
    _show(plan, result, flight, as_json, save)


def _fly(plan: Plan, label: str, allow_bind_all: bool, *, quiet: bool) -> tuple[FlightResult, RosFlight]:
    """Fly the plan; the result includes the golden run if there is a fault."""
    from mavfi.extras.ros.ros1.host import fly as fly_there
    from mavfi.report.flight_result import FlightResult

    tell = _invite if plan.pace > 0 and not quiet else None
    flight = fly_there(plan, allow_bind_all=allow_bind_all, tell=tell)
    golden = None if plan.fault is None else ros_nodes.without_registers(plan, with_fault=False)
    return FlightResult(plan.scenario, flight.flight, golden, plan.fault, label), flight


def _invite(folder: Path) -> None:
    from mavfi.extras.ros.ros1.folder import JOIN

    console(error=True).print(f"[dim]join the flight:[/dim] {folder / JOIN} rostopic list", soft_wrap=True)


def _show(plan: Plan, result: FlightResult, flight: RosFlight, as_json: bool, written: Path | None) -> None:
    log = flight.flight.log
    if written is not None:
        log.save(written)
    nodes = [event for event in log.events if event.kind in _NODE_EVENTS]
    if as_json:
        ros = {
            "nodes": list(plan.nodes), "coupling": plan.recovery.coupling if plan.detector is not None else None,
            "wall_s": flight.times,
            "lives": [{"time_s": 1e-6 * event.time_us, "event": event.kind, **event.data} for event in nodes],
            **ros_nodes.to_json(plan, log),
        }  # fmt: skip
        write_json({**result.to_json(), "ros": ros})
        return
    from mavfi.cli.flight_text import panel

    out = console()
    out.print(panel(result))
    for event in nodes:
        node, what = event.data["node"], _NODE_EVENTS[event.kind]
        detail = event.data.get("why") or f"pid {event.data['pid']}"
        out.print(f"{1e-6 * event.time_us:8.3f} s  node [bold]{node}[/bold] {what} [dim]({detail})[/dim]")
    for line in ros_nodes.lines(plan, log):
        out.print(line, markup=False)
    spent = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in flight.times.items())
    out.print(f"[dim]{1 + len(plan.nodes)} nodes · wall clock: {spent}[/dim]")
    if written is not None:
        out.print(f"[dim]wrote[/dim] {written}")
