"""Options of `mavfi ros fly` that name nodes: who computes the point cloud, is killed, or struck in registers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, cast, get_args

import typer

from mavfi.cli.console import check_seed
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.flight_log import Event, FlightLog
    from mavfi.hosts.inprocess import Flight
    from mavfi.hosts.ros1.plan import CloudNode, Plan, Strike

_LONGEST_S = 1e6

KillOption = Annotated[
    list[str] | None, typer.Option(metavar="NODE@SECONDS", help="Kill a node; roslaunch starts it anew.")
]
CloudOption = Annotated[
    str, typer.Option(help="Who computes the point cloud: mavfi, or depth_image_proc, Debian's C++ nodelet.")
]
StrikeOption = Annotated[
    list[str] | None,
    typer.Option(metavar="NODE@SECONDS", help="Flip a bit in a register of a node's process, e.g. point_cloud_xyz@5."),
]
RegistersOption = Annotated[
    str | None, typer.Option(help="Of strikes: general (with the flags), fp (XMM, YMM), or all (the default).")
]
SeedOption = Annotated[int | None, typer.Option(help="Draws instruction, register and bit of strikes; 0 by default.")]


def cloud_node(text: str) -> CloudNode:
    """Who computes the point cloud.

    Raises:
        BadInputError: It is not known.
    """
    from mavfi.hosts.ros1.plan import CloudNode

    allowed = get_args(CloudNode)
    if text not in allowed:
        raise BadInputError(f"--point-cloud-node: {text!r}: allowed: {', '.join(allowed)}")
    return cast("CloudNode", text)


def instant(option: str, text: str) -> tuple[str, int]:
    """Node and instant (microseconds) of "octomap@20".

    Raises:
        BadInputError: It is something else.
    """
    node, separator, seconds = text.partition("@")
    try:
        time_s = float(seconds)
    except ValueError:
        separator, time_s = "", 0.0
    if not separator or not 0.0 <= time_s < _LONGEST_S:
        raise BadInputError(f"{option}: {text!r}: allowed: NODE@SECONDS, e.g. octomap@20")
    return node, round(1e6 * time_s)


def strikes(texts: list[str] | None, registers: str | None, seed: int | None) -> tuple[Strike, ...]:
    """Strikes at register level.

    Args:
        texts: "NODE@SECONDS" each.
        registers: Which; None = all.
        seed: Of the first one; each has the next; None = 0.

    Raises:
        BadInputError: Something is not allowed.
    """
    from mavfi.faults.register.request import REGISTERS
    from mavfi.hosts.ros1.plan import Strike

    for option, value in (("--strike-registers", registers), ("--strike-seed", seed)):
        if value is not None and not texts:
            raise BadInputError(f"{option}: {value}: allowed: with --strike only")
    if registers is not None and registers not in REGISTERS:
        raise BadInputError(f"--strike-registers: {registers!r}: allowed: {', '.join(REGISTERS)}")
    check_seed("--strike-seed", seed or 0)
    named = (instant("--strike", text) for text in texts or ())
    return tuple(Strike(*each, (seed or 0) + place, registers or "all") for place, each in enumerate(named))


def check(plan: Plan) -> None:
    """Refuse nodes that are not in the flight.

    Raises:
        BadInputError: Names those that are.
    """
    allowed = (*plan.nodes, *plan.foreign)
    named = [("--kill", node) for node, _ in plan.kills] + [("--strike", strike.node) for strike in plan.strikes]
    for option, node in named:
        if node not in allowed:
            raise BadInputError(f"{option}: no node {node!r} in this flight; allowed: {', '.join(allowed)}")


def twin(plan: Plan, with_fault: bool) -> Flight:
    """The flight without strikes, in this process; in lock-step its digest is the same.

    Args:
        plan: The flight.
        with_fault: Whether the fault at a state strikes.
    """
    from mavfi.hosts.inprocess import fly
    from mavfi.hosts.observed import fly_observed
    from mavfi.hosts.ros1.pinhole import twin_functions

    fault, functions = plan.fault if with_fault else None, twin_functions(plan)
    if plan.observed and plan.detector is not None:
        return fly_observed(plan.scenario, fault, plan.detector, functions)
    return fly(plan.scenario, fault, plan.detector, functions=functions)


def happened(log: FlightLog) -> list[Event]:
    """What the strikes of a flight did, or why they did not."""
    from mavfi.hosts.ros1.strikes import FAILED, STRUCK

    return [event for event in log.events if event.kind in (STRUCK, FAILED)]


def outcome(plan: Plan, log: FlightLog) -> str | None:
    """What strikes at register level did; None where nothing was struck.

    Returns:
        "crash" or "hang": a struck node ended, or was ended as it did not answer; "masked": the flight is bit by bit
        that without a strike; "sdc": it is not; "unknown": there is no flight to compare it with (free-running, or
        nodes were killed besides).
    """
    from mavfi.hosts.ros1.strikes import fate

    end = fate(log.events)
    if end is None or end != "alive":
        return end
    if plan.free_running or plan.kills:
        return "unknown"
    return "masked" if twin(plan, with_fault=True).log.digest() == log.digest() else "sdc"


def to_json(plan: Plan, log: FlightLog) -> dict[str, Any]:
    """What `--json` says of all this."""
    done = [{"time_s": 1e-6 * event.time_us, "event": event.kind, **event.data} for event in happened(log)]
    return {"point_cloud_node": plan.cloud_node, "strikes": done, "strike_outcome": outcome(plan, log)}


def lines(plan: Plan, log: FlightLog) -> list[str]:
    """The same for people."""
    told = []
    for event in happened(log):
        data = event.data
        what = data.get("why") or (
            f"{data['register']} bit {data['bit']} of {data['instruction']!r}: {data['before']} → {data['after']}"
        )
        told.append(f"{1e-6 * event.time_us:8.3f} s  register of {data['node']}: {what}")
    if (end := outcome(plan, log)) is not None:
        told.append(f"           outcome: {end}")
    return told
