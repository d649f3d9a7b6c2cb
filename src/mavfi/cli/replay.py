"""`mavfi replay`: fly a stored run again, and say whether the same flight came out."""

from pathlib import Path
from typing import Annotated

import typer

from mavfi.cli.console import JSON_HELP, console, write_json


def replay(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the ledger.")],
    run_id: Annotated[str, typer.Argument(metavar="RUN_ID", help="The run, or an unambiguous beginning of its id.")],
    as_json: Annotated[bool, typer.Option("--json", help=JSON_HELP)] = False,
) -> None:
    """Fly a run again from its spec, and say whether the digest is the same.

    Example: [bold]mavfi replay out/states sparse-10003-golden[/bold]
    """
    from mavfi.campaign.replay import replay as fly_again

    found = fly_again(directory, run_id)
    spec, record = found.run.spec, found.run.record or {}
    if as_json:
        write_json({
            "run_id": spec.run_id, "same": found.same, "digest": found.digest, "stored_digest": record.get("digest"),
            "status": found.flight.log.status.label, "stored_status": record.get("status"),
            "replayable": all(injection.get("replayable", True) for injection in record.get("injections", ())),
            "flight_time_s": float(found.flight.log.column("time")[-1]),
        })  # fmt: skip
        return
    out = console()
    out.print(f"[bold]{spec.run_id}[/bold]: {found.flight.log.status.value}")
    if found.same:
        out.print(f"[green]✓[/green] the same flight, bit for bit: {found.digest}")
        return
    out.print(f"[yellow]✗ another flight:[/yellow] {found.digest}\n  stored:         {record.get('digest', 'none')}")
    if not all(injection.get("replayable", True) for injection in record.get("injections", ())):
        out.print("[dim]Not replayable: an address or a branch was struck, and addresses could not be fixed.[/dim]")
        return
    out.print("[dim]Bits are the same only with the same lock file, on x86-64 Linux.[/dim]")
