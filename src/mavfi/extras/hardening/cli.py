"""`mavfi harden`: which instructions of the kernels to duplicate, and the campaign that proves it."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from mavfi.cli import options
from mavfi.cli.console import check_file, check_number, check_writable, console, say_written, write_json
from mavfi.errors import write_text

if TYPE_CHECKING:
    from mavfi.analysis.table import Table
    from mavfi.extras.hardening.harden import HardenedFlight

HELP_PANEL = "Campaigns"
_HEADINGS = ("kernel", "function", "kernel time", "time", "adds", "SDCs removed", "sites")
_NOTE = (
    "kernel time: share of a golden flight's; time: measured, protected / plain; adds: of a flight's kernel time; "
    "SDCs removed: by the faults from which the choice was made; sites: instructions duplicated, of those that can be"
)


def harden(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a campaign with faults in instructions.")],
    plan: Annotated[
        Path | None,
        typer.Option(metavar="FILE.yaml", help="Write the plan, and beside it the campaign that proves it."),
    ] = None,
    budget: Annotated[
        float, typer.Option(metavar="SHARE", help="Share of a flight's kernel time to spend at most.")
    ] = 0.10,
    kernels: Annotated[str, typer.Option(metavar="NAMES", help="These kernels only, separated by commas.")] = "",
    addresses: Annotated[
        bool, typer.Option("--addresses", help="Compare addresses before loads, too: fewer crashes, more time.")
    ] = False,
    as_json: options.AsJson = False,
) -> None:
    """Choose which instructions to duplicate within a budget of time.

    Chooses those that remove most silent corruptions per added time, by the faults of a campaign.  The campaign written
    beside the plan is the proof: fresh missions in plain and in protected code; it exits with code 3 unless protected
    code has fewer silent corruptions.

    Example: [bold]mavfi harden out/kernels --budget 0.10 --plan plan.yaml[/bold]

    Example: [bold]mavfi campaign run plan.proof.yaml --out out/proof[/bold]
    """
    import yaml

    from mavfi.extras.hardening.harden import harden as harden_flights
    from mavfi.extras.hardening.harden import plan_of
    from mavfi.extras.hardening.ledger import HardeningLedger
    from mavfi.extras.hardening.plan import save_plan
    from mavfi.report.text import show_table

    # Refuse what is not allowed before any flight.
    check_number("--budget", budget, 0.0, 10.0)
    check_file("--plan", plan, (".yaml", ".yml"))
    path = plan or Path("plan.yaml")
    proof_path = path.with_suffix(".proof.yaml")
    if plan is not None:
        check_writable(proof_path)
    ledger = HardeningLedger.open(directory, options.listed(kernels))
    losses = ledger.losses
    proof = ledger.proof(path)

    # Fly golden missions, choose, and write the plan and its proof.
    flights = harden_flights(ledger, budget, _tell, addresses=addresses)
    if plan is not None:
        save_plan(plan_of(ledger, flights, budget), plan)
        write_text(proof_path, yaml.safe_dump(proof, sort_keys=False, allow_unicode=True))
    if as_json:
        write_json({**_content(flights), "budget": budget, "losses": losses._asdict(), "proof": proof})
        return

    # The result in a sentence, what it cannot save, and the table of functions.
    out = console()
    out.print(Text(_headline(flights, len(ledger.faults)), style="bold"))
    saved = (
        f"Missions that it may save: {losses.lost_silent} of {losses.silent} flights with an SDC were lost; dead "
        f"kernels, which it does not prevent, lost {losses.lost_dead} of {losses.dead}."
    )
    out.print(Text(saved))
    out.print()
    show_table(_table(flights), out)
    if plan is not None:
        say_written(plan, proof_path)
        out.print(Text.assemble(("The proof: ", "dim"), f"mavfi campaign run {proof_path} --out {directory}_proof"))


def _tell(text: str) -> None:
    console(error=True).print(text, style="dim")


def _headline(flights: Sequence["HardenedFlight"], faults: int) -> str:
    from mavfi.extras.hardening.harden import removed_share
    from mavfi.report.numbers import percent

    targets = [target for flight in flights for target in flight.new]
    protected = dict.fromkeys(target.observed.kernels[0] for target in targets if target.sites)
    if not protected:
        return "Nothing can be protected within this budget."
    added = max(flight.added for flight in flights)
    return (
        f"Protect {', '.join(protected)}: {percent(added, 2)} more kernel time per flight is expected to remove "
        f"{percent(removed_share(targets))} of the silent corruptions (SDC), by {faults:,} faults."
    )


def _table(flights: Sequence["HardenedFlight"]) -> "Table":
    from mavfi.analysis.table import Table
    from mavfi.report.numbers import percent

    rows = [
        (
            row["kernel"],
            row["function"],
            percent(row["share"]),
            f"×{row['time']:.2f}",
            percent(row["added"], 2),
            percent(row["removed"]),
            f"{row['sites']} of {row['all_sites']}",
        )
        for row in _content(flights)["functions"]
    ]
    return Table.of_text("What to protect", _HEADINGS, rows, (_NOTE,))


def _content(flights: Sequence["HardenedFlight"]) -> dict[str, Any]:
    """The choice as plain data."""
    from mavfi.extras.hardening.harden import removed_share

    functions = [
        {
            "kernel": target.observed.kernels[0],
            "function": target.observed.key.function.rpartition(".")[2],
            "share": target.ticks / flight.ticks,
            "time": target.time,
            "added": target.added / flight.ticks,
            "removed": removed_share([target]),
            "sites": len(target.sites),
            "all_sites": len(target.all_sites),
        }
        for flight in flights
        for target in flight.new
        if target.rates is not None
    ]
    return {
        "added": {flight.planner: flight.added for flight in flights},
        "removed": removed_share([target for flight in flights for target in flight.new]),
        "functions": functions,
    }
