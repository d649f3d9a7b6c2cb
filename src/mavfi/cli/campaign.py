"""`mavfi campaign run | status | digest`: fly many missions, see how far they are, prove what came out."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from mavfi.cli.console import JSON_HELP, console, write_json
from mavfi.cli.stopping import stoppable

app = typer.Typer(
    help="Fly a campaign, see how far it is, prove what came out.\n\n"
    "Example: [bold]mavfi campaign run smoke --out out/smoke[/bold]",
    no_args_is_help=False,
)

DEFAULT_WORKERS = 2


@app.command("run")
def run(
    config: Annotated[
        str, typer.Argument(metavar="CONFIG.yaml", help="A YAML file, or the name of a shipped campaign.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the ledger; made if absent, gone on with if it holds this campaign.  out/<name> by default."
        ),
    ] = None,
    workers: Annotated[int, typer.Option(help="Processes; the result does not depend on them.")] = DEFAULT_WORKERS,
    scale: Annotated[str, typer.Option(help="quick, or another size that the campaign names, e.g. paper.")] = "quick",
    models: Annotated[Path | None, typer.Option(help="Folder of trained models; the shipped ones by default.")] = None,
    forking: Annotated[
        bool, typer.Option(help="Begin faulty flights where their golden twins were; the result does not depend on it.")
    ] = True,
) -> None:
    """Fly a campaign, or what is left of it.  Ctrl-C stops it (exit code 130); the same command goes on.

    Example: [bold]mavfi campaign run configs/campaigns/states.yaml --out out/states[/bold]
    """
    from mavfi.campaign.config import load_any
    from mavfi.campaign.nodes.config import NodeCampaign
    from mavfi.campaign.nodes.run import run_node_campaign
    from mavfi.campaign.run import run_campaign
    from mavfi.cli.progress import Bar, import_host

    campaign = load_any(config).at_scale(scale)
    ledger = out or Path("out") / campaign.name
    told = f"Stopped. What is done is kept in {ledger}; the same command goes on."
    if isinstance(campaign, NodeCampaign):
        with stoppable(told), Bar(f"campaign {campaign.name}", "trials") as bar:
            run_node_campaign(campaign, ledger, workers=workers, progress=bar.show_campaign)
    else:
        import_host()
        with stoppable(told), Bar(f"campaign {campaign.name}") as bar:
            run_campaign(
                campaign, ledger, workers=workers, models_dir=models, forking=forking, progress=bar.show_campaign
            )
    console().print(f"Done. Tables and figures: [bold]mavfi report {ledger}[/bold]")


@app.command("status")
def status(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the ledger.")],
    as_json: Annotated[bool, typer.Option("--json", help=JSON_HELP)] = False,
) -> None:
    """Print how far a campaign is, and how many missions succeeded in each setting.

    Example: [bold]mavfi campaign status out/states[/bold]
    """
    from mavfi.campaign.run import status as status_of
    from mavfi.cli.progress import success_counts

    found = status_of(directory)
    if as_json:
        settings = {
            name: dict(zip(("planned", "flown", "succeeded"), counts, strict=True))
            for name, counts in found.settings.items()
        }
        write_json({**asdict(found), "complete": found.complete, "settings": settings})
        return
    out = console()
    out.print(f"{found.done} of {found.total} flights" + (", complete" if found.complete else ""))
    out.print(success_counts(found.settings))


@app.command("digest")
def digest(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the ledger.")],
    as_json: Annotated[bool, typer.Option("--json", help=JSON_HELP)] = False,
) -> None:
    """Print the hash of plan and records: the same for any number of workers, and after any stop.

    Of a campaign that is not complete it is that of the runs so far; stderr says so.

    Example: [bold]mavfi campaign digest out/states[/bold]
    """
    from mavfi.campaign.run import status as status_of
    from mavfi.campaign.store import Store

    with Store.open(directory) as store:
        found = store.digest()
    progress = status_of(directory)
    if as_json:
        write_json({
            "digest": found, "partial": not progress.complete, "done": progress.done, "total": progress.total
        })  # fmt: skip
        return
    typer.echo(found)
    if not progress.complete:
        console(error=True).print(
            f"partial: {progress.done} of {progress.total} flights are flown; the rest will change this digest"
        )
