"""`mavfi mavlink inject`: faults in the messages between a program and the autopilot that it flies."""

from __future__ import annotations

import signal
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated

import typer

from mavfi.cli import options
from mavfi.cli.console import check_name, check_number, check_seed, console, counted, write_json

if TYPE_CHECKING:
    from mavfi.record import Injection

HELP_PANEL = "Other programs"
EXIT_NOTHING_CHANGED = 3
_MAX_DURATION_S = 7 * 86_400.0
_DIRECTIONS = ("to", "from")

app = typer.Typer(no_args_is_help=True)


@app.callback()
def _mavlink() -> None:
    r"""Faults between a program and the autopilot that it flies.

    Neither is modified. Needs pip install 'mavfi\[mavlink]'.

    Example: [bold]mavfi mavlink inject --from udpin:127.0.0.1:14551 --to tcp:127.0.0.1:5760
    --fault SET_POSITION_TARGET_LOCAL_NED.vx:bit=31@n=10[/bold]
    """


@app.command("inject")
def inject(
    program: Annotated[
        str, typer.Option("--from", metavar="ADDRESS", help="Where the program is, e.g. udpin:127.0.0.1:14550.")
    ],
    autopilot: Annotated[
        str, typer.Option("--to", metavar="ADDRESS", help="Where the autopilot is, e.g. udpout:127.0.0.1:14560.")
    ],
    fault: Annotated[
        list[str],
        typer.Option(
            metavar="TEXT", help=r"MESSAGE\[.FIELD]:OPERATION\[@WHEN], e.g. ATTITUDE.roll:set=nan@10; repeatable."
        ),
    ],
    direction: Annotated[str, typer.Option(help="Messages that are changed: to the autopilot, or from it.")] = "to",
    duration: options.Duration = None,
    seed: Annotated[int, typer.Option(help="Draws bits, and messages of share=.")] = 0,
    as_json: options.AsJson = False,
) -> None:
    """Pass on the messages of a program and an autopilot, some of them changed; until Ctrl-C.

    Addresses are those of pymavlink: udpin, udpout, tcp, tcpin with host and port, or a serial device. Messages without
    a fault pass byte for byte. The exit code is 3 if nothing was changed.

    Example: [bold]mavfi mavlink inject --from udpin:127.0.0.1:14551 --to tcp:127.0.0.1:5760
    --fault SET_POSITION_TARGET_LOCAL_NED.vx:bit=31@n=10[/bold]
    """
    check_name("--direction", direction, _DIRECTIONS)
    check_seed("--seed", seed)
    check_number("--duration", duration, 0.0, _MAX_DURATION_S)
    from mavfi.extras.shared.mavlink_frames import mavlink_dialect

    dialect = mavlink_dialect("mavfi mavlink inject")
    from mavfi.extras.mavlink.faults import FaultyStream, MavlinkFault
    from mavfi.extras.mavlink.link import MavlinkLink, connect

    faults = [MavlinkFault(text, dialect, seed + index) for index, text in enumerate(fault)]
    injections: list[Injection] = []

    def report(injection: Injection) -> None:
        injections.append(injection)
        if not as_json:
            console().print(_line(injection), markup=False, soft_wrap=True)

    changed = FaultyStream(faults, report)
    unchanged = FaultyStream([], report)
    streams = {"to": changed, "from": unchanged}
    if direction == "from":
        streams = {"to": unchanged, "from": changed}
    link = MavlinkLink((connect(program), streams["to"]), (connect(autopilot), streams["from"]), dialect)
    if not as_json:
        console().print(f"{program} <-> {autopilot}; Ctrl-C ends the link", markup=False)

    # Ctrl-C and SIGTERM are how a link usually ends.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with suppress(KeyboardInterrupt):
        link.run(duration or _MAX_DURATION_S)

    passed = {name: stream.frames for name, stream in streams.items()}
    if as_json:
        counts = [
            {"fault": each.text, "passed": each.passed, "changed": each.changed, "refusals": each.refusals}
            for each in faults
        ]
        write_json({"frames": passed, "faults": counts, "injections": [item.to_json() for item in injections]})
    else:
        lines = [f"{counted(passed['to'], 'frame')} to the autopilot, {counted(passed['from'], 'frame')} from it"]
        for each in faults:
            lines.append(f"{each.text}: {each.changed} of {each.passed} {each.kind.msgname} changed")
            lines += [f"  {count} NOT changed: {reason}" for reason, count in each.refusals.items()]
        console().print("\n".join(lines), markup=False, soft_wrap=True)
    if not any(each.changed for each in faults):
        raise typer.Exit(EXIT_NOTHING_CHANGED)


def _line(injection: Injection) -> str:
    """An injection in one line."""
    details = injection.details
    line = f"{injection.time_s:8.3f} s  {injection.site} message {details['message']}: {details['operation']}"
    if injection.before is not None:
        line += f": {injection.before} → {injection.after}"
    return line
