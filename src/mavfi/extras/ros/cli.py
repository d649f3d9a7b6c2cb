"""`mavfi ros`: the pipeline as real nodes of ROS 2."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli import options
from mavfi.cli.console import FLIGHTS, check_file, check_number, console, write_json
from mavfi.cli.fly import check_option_dependencies, watched
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError, not_known
from mavfi.extras.registers.options import RegistersOption, SeedOption, instant, register_options
from mavfi.extras.ros.cli_graph import list_graphs, setup, watch
from mavfi.extras.ros.cli_inject import inject, run
from mavfi.mission import MissionSpec

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavfi.extras.registers.fault import RegisterFault
    from mavfi.extras.ros.lockstep.host import RosFlight
    from mavfi.extras.ros.lockstep.plan import FlightPlan
    from mavfi.flight.host import Flight
    from mavfi.levels.level import Request
    from mavfi.mission import Scenario
    from mavfi.record import FlightLog, Injection
    from mavfi.report.flight_result import FlightResult

HELP_PANEL = "Other programs"
_KillOption = Annotated[list[str] | None, typer.Option(metavar="NODE@SECONDS", help="Kill a node; it is restarted.")]
_FaultOption = Annotated[
    list[str] | None,
    typer.Option(metavar="NODE@SECONDS", help="Flip a bit in a register of a node's process, e.g. octomap@5."),
]
_NODE_EVENTS = {"node_lost": "lost", "node_back": "back", "node_absent": "still away"}

app = typer.Typer(no_args_is_help=True)
app.command("setup")(setup)
app.command("list")(list_graphs)
app.command("inject")(inject)
app.command("run")(run)
app.command("watch")(watch)


@app.callback()
def _ros() -> None:
    """The pipeline as nodes of ROS 2; faults in any ROS 2 application.

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
    kill: _KillOption = None,
    register_fault: _FaultOption = None,
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
    # refuse what cannot be flown, before ROS is looked for
    mission = mission_with(mission, detector)
    check_option_dependencies(mission, fault, fault_seed, detector, profile, models)
    check_file("--save", save, FLIGHTS)
    check_number("--pace", pace, 0, 1000)
    request = request_of(fault, mission)
    kills = tuple(instant("--kill", text) for text in kill or ())
    faults = register_faults(register_fault or (), registers, register_seed)
    from mavfi.extras.ros.lockstep.host import configure
    from mavfi.extras.ros.lockstep.plan import FlightPlan
    from mavfi.extras.ros.lockstep.transport import Middleware

    middleware = Middleware.installed()
    middleware.require()

    # plan the flight, and check that its nodes exist
    setup = watched(mission, detector, profile, models)
    plan = FlightPlan(
        middleware,
        setup.scenario,
        configure(setup.scenario),
        draw_fault(setup.scenario, request, fault_seed),
        setup.detector(),
        setup.recovery,
        kills,
        register_faults=faults,
        pace=pace,
    )
    check(plan)

    # fly, and show
    with stoppable("Stopped; every process of the flight has ended."):
        result, flight = _fly(plan, setup.label, allow_bind_all, quiet=as_json)
    _show(plan, result, flight, as_json, save)


def _fly(plan: FlightPlan, label: str, allow_bind_all: bool, *, quiet: bool) -> tuple[FlightResult, RosFlight]:
    """Fly the plan; the result includes the golden run if there is a fault."""
    from mavfi.extras.ros.lockstep.host import fly as fly_there
    from mavfi.report.flight_result import FlightResult

    tell = None
    if plan.pace > 0 and not quiet:
        tell = _invite
    flight = fly_there(plan, allow_bind_all=allow_bind_all, tell=tell)
    golden = None
    if plan.fault is not None:
        golden = without_registers(plan, with_fault=False)
    return FlightResult(plan.scenario, flight.flight, golden, plan.fault, label), flight


def _invite(folder: Path) -> None:
    from mavfi.extras.ros.lockstep.folder import JOIN
    from mavfi.extras.ros.lockstep.transport import JOIN_EXAMPLE

    text = f"[dim]join the flight:[/dim] {folder / JOIN} {JOIN_EXAMPLE}"
    console(error=True).print(text, soft_wrap=True)


def _show(plan: FlightPlan, result: FlightResult, flight: RosFlight, as_json: bool, written: Path | None) -> None:
    """Print the flight, or write it as JSON, with what happened to its nodes and registers."""
    log = flight.flight.log
    if written is not None:
        log.save(written)
    nodes = [event for event in log.events if event.kind in _NODE_EVENTS]

    # as JSON: the flight as of `mavfi fly`, with what ROS adds to it
    if as_json:
        coupling = None
        if plan.detector is not None:
            coupling = plan.recovery.coupling
        from mavfi.extras.ros.lockstep.host import LockstepHost

        ros = {
            "host": LockstepHost.name,
            "nodes": list(plan.nodes),
            "coupling": coupling,
            "wall_s": flight.times,
            "lives": [{"time_s": 1e-6 * event.time_us, "event": event.kind, **event.data} for event in nodes],
            "register_effect": effect(plan, log),
        }
        write_json({**result.to_json(), "ros": ros})
        return
    from mavfi.cli.flight_text import panel

    # the mission, then the events of nodes and the faults in registers, then the wall time
    out = console()
    out.print(panel(result))
    for event in nodes:
        node = event.data["node"]
        what = _NODE_EVENTS[event.kind]
        detail = event.data.get("why") or f"pid {event.data['pid']}"
        out.print(f"{1e-6 * event.time_us:8.3f} s  node [bold]{node}[/bold] {what} [dim]({detail})[/dim]")
    for injection in log.injections:  # into registers; the other fault is in the panel
        if "node" in injection.details:
            out.print(_line(injection), markup=False)
    register_effect = effect(plan, log)
    if register_effect is not None:
        out.print(f"           effect: {register_effect}")
    spent = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in flight.times.items())
    out.print(f"[dim]{1 + len(plan.nodes)} nodes of {plan.middleware.title} · wall clock: {spent}[/dim]")
    if written is not None:
        out.print(f"[dim]wrote[/dim] {written}")


# ---- killed nodes and register faults --------------------------------------------------------------------------------


def mission_with(mission: MissionSpec, detector: str) -> MissionSpec:
    """Add the mission keys of a detector; raises `BadInputError` if the mission is not supported on ROS.

    A detector's grain `message` becomes `kernel`, since nodes keep no copy of sent messages.
    """
    from mavfi.extras.ros.lockstep.plan import check_supported
    from mavfi.flight.compose import with_keys_of

    resolved = with_keys_of(mission, detector)
    if "grain" not in mission.model_fields_set and resolved.grain == "message":
        resolved = resolved.model_copy(update={"grain": "kernel"})
    check_supported(resolved)
    return resolved


def request_of(text: str | None, mission: MissionSpec) -> Request | None:
    """The requested fault, of a level that the nodes or their world inject; raises `BadInputError` for another one."""
    from mavfi.extras.ros.lockstep.host import LockstepHost
    from mavfi.levels.level import parse

    if text is None:
        return None
    return parse(text, mission.localization, LockstepHost.levels)


def draw_fault(scenario: Scenario, request: Request | None, seed: int | None) -> Any:  # noqa: ANN401 - a fault of these levels
    """The fault that a request of `request_of` draws in a mission; None without a request."""
    from mavfi.flight.host import ArmSetup

    if request is None:
        return None
    return request.draw(ArmSetup(scenario), seed or 0)[0]


def register_faults(texts: Sequence[str], registers: str | None, seed: int | None) -> tuple[RegisterFault, ...]:
    """Faults in registers of nodes, each "NODE@SECONDS", with consecutive seeds starting at `--register-seed`."""
    from mavfi.extras.ros.lockstep.register_injector import fault_in_node

    kind, first_seed = register_options(registers, seed, has_fault=bool(texts))
    faults = []
    for index, text in enumerate(texts):
        node, time_us = instant("--register-fault", text)
        faults.append(fault_in_node(node, time_us, kind, first_seed + index))
    return tuple(faults)


def check(plan: FlightPlan) -> None:
    """Refuse nodes that are not part of the flight."""
    named = [("--kill", node) for node, _ in plan.kills]
    named += [("--register-fault", fault.node) for fault in plan.register_faults]
    for option, node in named:
        if node not in plan.nodes:
            raise BadInputError(f"{option}: node {not_known(node, plan.nodes)}")


def without_registers(plan: FlightPlan, with_fault: bool) -> Flight:
    """The flight in this process, without faults in registers, with or without the fault in a state.

    Its digest is that of the flight on ROS.
    """
    from mavfi.flight.fly import fly

    fault = None
    if with_fault:
        fault = plan.fault
    return fly(plan.scenario, fault, plan.detector, recovery=plan.recovery)


def effect(plan: FlightPlan, log: FlightLog) -> str | None:
    """Effect of the faults in registers; None without an injection.

    "crash" or "hang": an injected node died, or was killed because it did not respond; "masked" or "sdc": the flight is
    bit-identical to that without the injection, or not; "unknown": no reference flight (nodes were killed).
    """
    from mavfi.extras.ros.lockstep.register_injector import end_of_nodes

    end = end_of_nodes(log.injections, log.events)
    if end != "alive":
        return end
    if plan.kills:
        return "unknown"
    if without_registers(plan, with_fault=True).log.digest() == log.digest():
        return "masked"
    return "sdc"


def _line(injection: Injection) -> str:
    """One injection in one line, or the reason for its absence."""
    details = injection.details
    what = details.get("why")
    if what is None:
        instruction = ""
        if "instruction" in details:
            instruction = f" of {details['instruction']!r}"
        what = f"{injection.site} bit {injection.bit}{instruction}: {injection.before} → {injection.after}"
    return f"{injection.time_s:8.3f} s  register of {details['node']}: {what}"
