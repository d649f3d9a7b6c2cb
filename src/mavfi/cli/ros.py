"""`mavfi ros`: the pipeline as real ROS nodes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavfi.cli import options, ros_attach, ros_strike
from mavfi.cli.console import JSON_HELP, check_seed, check_writable, console, write_json
from mavfi.cli.fly import check_company, known_localization, load_watcher
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.cli.flown import Flown
    from mavfi.faults.fault import Fault
    from mavfi.faults.spec import StateRequest
    from mavfi.hosts.ros1.plan import Coupling, Plan
    from mavfi.hosts.ros1.session import RosFlight
    from mavfi.mission import Scenario

_NODE_EVENTS = ("node_lost", "node_back", "node_absent")

app = typer.Typer(
    help="The pipeline as real ROS 1 nodes (Debian's packages: `make ros`), and tools for any ROS application.",
    no_args_is_help=True,
)
ros_attach.add_verbs(app)


@app.callback()
def _ros() -> None:
    """The pipeline as real ROS 1 nodes (Debian's packages: `make ros`), and tools for any ROS application."""


@app.command("fly")
def fly(  # noqa: PLR0913 - one parameter per option
    environment: options.Environment = "sparse",
    seed: options.Seed = 0,
    stack: Annotated[str, typer.Option(help="published, hardened, or a YAML file.")] = "published",
    platform: Annotated[
        str, typer.Option(help="Computer whose latencies are charged: a name, or a YAML file.")
    ] = "i9-9940x",
    localization: options.Localization = "truth",
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
    coupling: Annotated[
        str | None, typer.Option(help="inline: a gate before the value is seen; observer: acts one step later.")
    ] = None,
    free_running: Annotated[
        bool, typer.Option("--free-running", help="Time passes as on the wall, for rviz and rosbag.")
    ] = False,
    kill: ros_strike.KillOption = None,
    point_cloud_node: ros_strike.CloudOption = "mavfi",
    strike: ros_strike.StrikeOption = None,
    strike_registers: ros_strike.RegistersOption = None,
    strike_seed: ros_strike.SeedOption = None,
    allow_bind_all: Annotated[
        bool, typer.Option("--allow-bind-all", help="Fly even where there can be no private network.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help=JSON_HELP)] = False,
    save: Annotated[Path | None, typer.Option(metavar="FILE.npz", help="Write the whole record of the flight.")] = None,
) -> None:
    """Fly one mission with every kernel, the world, the injector and the detector as ROS nodes of their own.

    In lock-step the flight is bit by bit the one of `mavfi fly`.

    Example: [bold]mavfi ros fly --environment sparse --seed 7 --kill octomap@20[/bold]
    """
    check_seed("--seed", seed)
    check_company(fault, fault_seed, detector, {"--profile": profile, "--models": models, "--coupling": coupling})
    _check_save(save)
    request = _request(fault, known_localization(localization))
    kills = tuple(ros_strike.instant("--kill", text) for text in kill or ())
    chosen, cloud = _coupling(coupling), ros_strike.cloud_node(point_cloud_node)
    strikes = ros_strike.strikes(strike, strike_registers, strike_seed)

    from mavfi.hosts.ros1 import finder

    finder.require()

    from mavfi.hosts.compose import make_scenario
    from mavfi.hosts.ros1.plan import Plan
    from mavfi.hosts.ros1.session import configure

    scenario = make_scenario(environment, seed, stack=stack, platform=platform, localization=localization)
    watching, told = load_watcher(detector, profile, models, scenario)
    drawn = _draw(scenario, request, fault_seed or 0)
    plan = Plan(
        scenario, configure(scenario), drawn, watching, chosen, free_running, kills, cloud_node=cloud, strikes=strikes
    )
    ros_strike.check(plan)
    _fly_and_show(plan, told, allow_bind_all, as_json, save)


def _fly_and_show(plan: Plan, told: str, allow_bind_all: bool, as_json: bool, save: Path | None) -> None:
    with stoppable("Stopped; every process of the flight has ended."):
        flown, flight = _fly(plan, told, allow_bind_all, quiet=as_json)
    if save is not None:
        flight.flight.log.save(save)
    _show(plan, flown, flight, as_json, save)


def _check_save(path: Path | None) -> None:
    if path is not None and path.suffix.lower() != ".npz":
        raise BadInputError(f"--save: {path}: allowed ending: .npz")
    check_writable(path)


def _request(text: str | None, localization: str) -> StateRequest | None:
    if text is None:
        return None
    from mavfi.faults.spec import StateRequest, parse

    request = parse(text, localization)
    if not isinstance(request, StateRequest):
        raise BadInputError(f"--fault: {text!r}: on ROS faults are injected into states: null, or state:STATE...")
    return request


def _coupling(text: str | None) -> Coupling:
    if text is None or text == "inline":
        return "inline"
    if text == "observer":
        return "observer"
    raise BadInputError(f"--coupling: {text}: allowed: inline, observer")


def _draw(scenario: Scenario, request: StateRequest | None, seed: int) -> Fault | None:
    """The fault, drawn from the golden flight as every host draws it."""
    from mavfi.hosts.inprocess import fly as fly_here

    if request is None:
        return None
    profile = fly_here(scenario, want_profile=True).profile if request.needs_profile else None
    return request.resolve(seed, scenario.stack.name, profile)


def _fly(plan: Plan, told: str, allow_bind_all: bool, *, quiet: bool) -> tuple[Flown, RosFlight]:
    """The flight, beside its error-free twin where one can be told from the other."""
    from mavfi.cli.flown import Flown
    from mavfi.hosts.ros1.session import fly as fly_there

    tell = _invite if plan.free_running and not quiet else None
    flight = fly_there(plan, allow_bind_all=allow_bind_all, tell=tell)
    twin = None if plan.fault is None or plan.free_running else ros_strike.twin(plan, with_fault=False)
    fault = None if plan.free_running else plan.fault
    return Flown(plan.scenario, flight.flight, twin, fault, told), flight


def _invite(folder: Path) -> None:
    from mavfi.hosts.ros1.folder import JOIN

    console(error=True).print(f"[dim]join the flight:[/dim] {folder / JOIN} rostopic list", soft_wrap=True)


def _show(plan: Plan, flown: Flown, flight: RosFlight, as_json: bool, written: Path | None) -> None:
    from mavfi.cli.flown import to_json

    log = flight.flight.log
    nodes = [event for event in log.events if event.kind in _NODE_EVENTS]
    if as_json:
        ros = {
            "nodes": list(plan.nodes), "coupling": plan.coupling if plan.detector is not None else None,
            "free_running": plan.free_running, "wall_s": flight.times,
            "lives": [{"time_s": 1e-6 * event.time_us, "event": event.kind, **event.data} for event in nodes],
            **ros_strike.to_json(plan, log),
        }  # fmt: skip
        write_json({**to_json(flown), "ros": ros})
        return
    from mavfi.cli.flight_text import panel

    out = console()
    out.print(panel(flown))
    for event in nodes:
        what = {"node_lost": "lost", "node_back": "back", "node_absent": "still away"}[event.kind]
        detail = event.data.get("why") or f"pid {event.data['pid']}"
        out.print(f"{1e-6 * event.time_us:8.3f} s  node [bold]{event.data['node']}[/bold] {what} [dim]({detail})[/dim]")
    for line in ros_strike.lines(plan, log):
        out.print(line, markup=False)
    if plan.free_running:
        for hit in log.injections:
            out.print(
                f"{hit['time_s']:8.3f} s  fault in {hit['site']} bit {hit['bit']}: {hit['before']} → {hit['after']}"
            )
    spent = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in flight.times.items())
    out.print(f"[dim]{1 + len(plan.nodes) + len(plan.foreign)} nodes · wall clock: {spent}[/dim]")
    if written is not None:
        out.print(f"[dim]wrote[/dim] {written}")
