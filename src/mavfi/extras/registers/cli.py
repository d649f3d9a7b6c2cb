"""`mavfi inject`: flip a bit in a register of a running process."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from mavfi.cli import options
from mavfi.cli.console import check_seed, console, write_json
from mavfi.errors import BadInputError
from mavfi.extras.registers.fault import DEFAULT_WALK
from mavfi.plugins import extensions

if TYPE_CHECKING:
    from mavfi.record import Injection

HELP_PANEL = "Other programs"
PROCESSES = "mavfi.processes"
"""Group of entry points: objects with `options` (see `with_extra_options`), each of which names a process in another
way than its id, and `pid_of(values)`, the process id; None = their options are not set."""


@options.with_extra_options(PROCESSES)
def inject(  # noqa: PLR0913 - one parameter per option
    pid: Annotated[int | None, typer.Option(help="Process to inject; one of your own.")] = None,
    symbol: Annotated[
        str, typer.Option(help="Inject at the next call of this function: its name, or a part that no other has.")
    ] = "",
    registers: Annotated[str, typer.Option(help="general (with the flags), fp (XMM, YMM), or all.")] = "all",
    access: Annotated[
        str,
        typer.Option(
            help="Inject what the next instruction reads, or what it has written: read, write, either.",
            show_default="either with --symbol, otherwise read",
        ),
    ] = "",
    walk: Annotated[
        int,
        typer.Option(
            help="From the stop on, fewer than this many instructions are executed before the injection.",
            show_default=f"{DEFAULT_WALK} with --symbol, otherwise 1",
        ),
    ] = 0,
    count: Annotated[int, typer.Option(help="How many injections.")] = 1,
    timeout: Annotated[float, typer.Option(help="Longest wait for an injection, s.")] = 10.0,
    seed: Annotated[int, typer.Option(help="Draws length of walk, register and bit.")] = 0,
    null: Annotated[bool, typer.Option("--null", help="Do everything but flip the bit.")] = False,
    as_json: options.AsJson = False,
    **others: Any,  # noqa: ANN401 - of the options of extras
) -> None:
    """Flip one bit in a register of a running process.

    On x86-64 Linux; the injection is reported. The process needs no preparation. Its busiest thread, or the first to
    call --symbol, is injected. It is stopped for about a millisecond, then continues.

    Example: [bold]mavfi inject --pid 1234 --registers fp --seed 3[/bold]
    """
    check_seed("--seed", seed)

    from mavfi.extras.registers import inject as inject_register
    from mavfi.extras.registers.fault import RegisterFault

    fault = RegisterFault(registers, access, symbol, walk=walk, timeout=timeout, null=null, seed=seed)
    process = _process(pid, others)
    if not as_json:
        inject_register(process, fault, count, _report)
        return
    injections = [injection.to_json() for injection in inject_register(process, fault, count)]
    write_json({"pid": process, "fault": fault.to_json(), "injections": injections})


def _process(pid: int | None, others: dict[str, Any]) -> int:
    """Process id from --pid or another option that names a process, exactly one of which must be given."""
    count = sum(value is not None for value in (pid, *others.values()))
    if count != 1:
        names = ", ".join(map(options.option_name, ("pid", *others)))
        raise BadInputError(f"{names}: {count} given; allowed: one of them, the process to inject")
    if pid is not None:
        return pid
    numbers = (extra.pid_of(others) for extra in extensions(PROCESSES).values())
    return int(next(number for number in numbers if number is not None))


def _report(injection: Injection) -> None:
    """Print one injection in two lines; operands and names are never interpreted as markup."""
    details = injection.details
    when = "after"
    if details["access"] == "read":
        when = "before"
    effect = "injected"
    values = f"{injection.before} → {injection.after}"
    if not injection.activated:
        effect = "NOT injected as planned"
    elif injection.before == injection.after:
        effect = "not flipped (null injection)"
        values = f"{injection.before}, unchanged"
    # What was changed, then where.
    out = console()
    out.print(
        Text.assemble(
            f"pid {details['pid']}, thread {details['thread']}: ",
            (injection.site, "bold"),
            f" bit {injection.bit} {effect} {when} ",
            (details["instruction"], "bold"),
            f": {values}",
        )
    )
    out.print(
        Text(
            f"  at {details['address']}, {details['symbol'] or details['offset']} in {details['library']}; "
            f"stood still for {details['stopped_us'] / 1000:.2f} ms",
            style="dim",
        )
    )
