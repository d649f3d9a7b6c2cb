"""`mavfi train`: fly error-free missions in randomised worlds, and fit the detectors to them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich import box
from rich.table import Table

from mavfi.cli.console import JSON_HELP, check_folder, check_number, console, write_json

if TYPE_CHECKING:
    from mavfi.detectors.model import Model

_STOPPED = 130


def train(  # noqa: PLR0913 - one parameter per option
    flights: int = typer.Option(100, help="Error-free missions; fewer than 100 give thresholds that do not hold."),
    out: Path = typer.Option(Path("out/models"), help="Folder of the models; made if absent."),
    stack: str = typer.Option("published", help="published, hardened, or a YAML file."),
    platform: str = typer.Option("i9-9940x", help="Computer whose latencies are charged: a name, or a YAML file."),
    planner: str = typer.Option("rrt_connect", help="Name, or package:Class."),
    v_max: float = typer.Option(None, help="Speed limit, m/s; the environment's by default."),
    workers: int = typer.Option(2, help="Processes; the models do not depend on them."),
    as_json: bool = typer.Option(False, "--json", help=JSON_HELP),
) -> None:
    """Fly error-free missions in randomised worlds (none of the evaluation's), and fit every detector to them.

    Example: [bold]mavfi train --flights 100 --stack hardened --out out/models[/bold]
    """
    check_number("--flights", flights, 1, 100_000)
    check_number("--v-max", v_max, 0.1, 20.0)
    check_folder(out)

    from mavfi.campaign.training import train as train_models
    from mavfi.cli.progress import Bar
    from mavfi.detectors.model import Model

    try:
        with Bar("training flights") as bar:
            files = train_models(
                out, flights, stack=stack, platform=platform, planner=planner, v_max=v_max, workers=workers,
                progress=bar.show,
            )  # fmt: skip
    except KeyboardInterrupt:
        raise typer.Exit(_STOPPED) from None
    models = [Model.load(path) for path in files]
    if as_json:
        write_json({"models": [{"file": str(f), **told(m)} for f, m in zip(files, models, strict=True)]})
        return
    console().print(table(models, files))


def told(model: Model) -> dict[str, Any]:
    """What is printed of a model: where it comes from, and where its alarm begins."""
    parameters = model.parameters
    limits = {key: parameters[key] for key in ("sigmas", "limit") if key in parameters}
    return {
        "kind": model.kind, "profile": model.profile, "monitored": model.monitored, "sha256": model.sha256,
        "thresholds": limits, "provenance": model.provenance,
    }  # fmt: skip


def table(models: list[Model], files: list[Path]) -> Table:
    """The models for people."""
    origin = models[0].provenance
    seeds = origin["seeds"]
    shown = Table(
        title=f"Trained on {origin['flights']} error-free flights · stack {origin['stack']} · {origin['platform']} · "
        f"{origin['planner']} · {origin['v_max']:g} m/s", title_style="bold", title_justify="left", box=box.SIMPLE_HEAD,
        pad_edge=False, caption=f"worlds: {origin['environment']}, seeds {min(seeds)} to {max(seeds)}; "
        "false alarms are counted by campaigns, on golden flights of other seeds", caption_justify="left",
    )  # fmt: skip
    for heading in ("detector", "profile", "alarm above", "sha256", "file"):
        shown.add_column(heading, overflow="fold")
    for model, path in zip(models, files, strict=True):
        shown.add_row(model.kind, model.profile, _threshold(model), model.sha256[:12], str(path))
    return shown


def _threshold(model: Model) -> str:
    parameters = model.parameters
    if "sigmas" in parameters:
        return f"{parameters['sigmas']:g} deviations, {len(parameters['statistics'])} fields"
    limits = parameters["limit"]
    count = sum(len(row) for row in limits)
    if count == 1:
        return f"mean squared error {limits[0][0]:.4g}"
    flat = [value for row in limits for value in row]
    return f"{count} limits, {min(flat):.3g} to {max(flat):.3g}"
