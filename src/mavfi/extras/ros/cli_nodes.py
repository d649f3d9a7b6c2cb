"""Options of `mavfi ros fly` about nodes: killed nodes, and register faults in nodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.errors import BadInputError
from mavfi.extras.registers.cli import instant, register_options

if TYPE_CHECKING:
    from mavfi.extras.ros.ros1.plan import Plan
    from mavfi.faults.fault import RegisterFault
    from mavfi.flight.host import Flight
    from mavfi.levels.level import Request
    from mavfi.mission import MissionSpec, Scenario
    from mavfi.record import FlightLog, Injection

KillOption = Annotated[
    list[str] | None, typer.Option(metavar="NODE@SECONDS", help="Kill a node; roslaunch restarts it.")
]
FaultOption = Annotated[
    list[str] | None,
    typer.Option(metavar="NODE@SECONDS", help="Flip a bit in a register of a node's process, e.g. octomap@5."),
]


def mission_with(mission: MissionSpec, detector: str) -> MissionSpec:
    """Add the mission keys of a detector; raises `BadInputError` if the mission is not supported on ROS.

    A detector's grain `message` becomes `kernel`, since nodes keep no copy of sent messages.
    """
    from mavfi.extras.ros.ros1.plan import check_supported
    from mavfi.flight.watching import with_keys_of

    resolved = with_keys_of(mission, detector)
    if "grain" not in mission.model_fields_set and resolved.grain == "message":
        resolved = resolved.model_copy(update={"grain": "kernel"})
    check_supported(resolved)
    return resolved


def request_of(text: str | None, mission: MissionSpec) -> Request | None:
    """The requested fault, of a level that the nodes or their world inject; raises `BadInputError` for another one."""
    from mavfi.extras.ros.ros1.host import Ros1Host
    from mavfi.levels.level import parse

    return None if text is None else parse(text, mission.localization, Ros1Host.levels)


def drawn(scenario: Scenario, request: Request | None, seed: int | None) -> Any:  # noqa: ANN401 - a fault of these levels
    """The fault that a request of `request_of` draws in a mission; None without a request."""
    from mavfi.flight.host import ArmSetup

    return None if request is None else request.draw(ArmSetup(scenario), seed or 0)[0]


def register_faults(texts: Sequence[str], registers: str | None, seed: int | None) -> tuple[RegisterFault, ...]:
    """Faults in registers of nodes, each "NODE@SECONDS", with consecutive seeds starting at `--register-seed`."""
    from mavfi.extras.ros.ros1.register_injector import fault_in_node

    kind, first_seed = register_options(registers, seed, has_fault=bool(texts))
    named = (instant("--register-fault", text) for text in texts)
    return tuple(fault_in_node(*each, kind, first_seed + place) for place, each in enumerate(named))


def check(plan: Plan) -> None:
    """Refuse nodes that are not part of the flight."""
    named = [("--kill", node) for node, _ in plan.kills]
    named += [("--register-fault", fault.node) for fault in plan.register_faults]
    for option, node in named:
        if node not in plan.nodes:
            raise BadInputError(f"{option}: no node {node!r} in this flight; allowed: {', '.join(plan.nodes)}")


def without_registers(plan: Plan, with_fault: bool) -> Flight:
    """The flight in this process, without faults in registers, with or without the fault in a state.

    Its digest is that of the flight on ROS.
    """
    from mavfi.flight.fly import fly

    return fly(plan.scenario, plan.fault if with_fault else None, plan.detector, recovery=plan.recovery)


def effect(plan: Plan, log: FlightLog) -> str | None:
    """Effect of the faults in registers; None without an injection.

    "crash" or "hang": an injected node died, or was killed because it did not respond; "masked" or "sdc": the flight is
    bit-identical to that without the injection, or not; "unknown": no reference flight (nodes were killed).
    """
    from mavfi.extras.ros.ros1.register_injector import end_of_nodes

    end = end_of_nodes(log.injections, log.events)
    if end != "alive":
        return end
    if plan.kills:
        return "unknown"
    return "masked" if without_registers(plan, with_fault=True).log.digest() == log.digest() else "sdc"


def to_json(plan: Plan, log: FlightLog) -> dict[str, Any]:
    """Keys of `--json` about nodes; register injections are listed with those of the flight."""
    return {"register_effect": effect(plan, log)}


def lines(plan: Plan, log: FlightLog) -> list[str]:
    """Injections into registers as lines of text, and their effect; the other fault is in the flight's panel."""
    injections = [_line(injection) for injection in log.injections if "node" in injection.details]
    register_effect = effect(plan, log)
    return injections if register_effect is None else [*injections, f"           effect: {register_effect}"]


def _line(injection: Injection) -> str:
    """One injection in one line, or the reason for its absence."""
    details = injection.details
    what = details.get("why")
    if what is None:
        instruction = f" of {details['instruction']!r}" if "instruction" in details else ""
        what = f"{injection.site} bit {injection.bit}{instruction}: {injection.before} → {injection.after}"
    return f"{injection.time_s:8.3f} s  register of {details['node']}: {what}"
