"""`mavfi train`: fly error-free missions in randomised worlds, and fit the detectors to them."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from mavfi.cli import options
from mavfi.cli.console import check_number, console, titled_table, write_json
from mavfi.cli.stopping import stoppable
from mavfi.files import check_folder
from mavfi.mission import OF_A_DETECTOR, MissionSpec

if TYPE_CHECKING:
    from mavfi.analysis.statistics import EventRate
    from mavfi.detectors.model import Model

HELP_PANEL = "Detectors"
_ENOUGH_FLIGHTS = 100
"""Error-free flights from which on thresholds hold."""
_MOST_CHECKS = 10
"""Largest number of checking flights in an environment by default."""


@partial(
    options.with_mission_options,
    without=("environment", "seed", "start", "goal", "dead_node", "protection", *OF_A_DETECTOR),
)
def train(  # noqa: PLR0913 - one for each option
    mission: MissionSpec,
    flights: Annotated[
        int, typer.Option(help="Error-free missions; fewer than 100 give thresholds that do not hold.")
    ] = 100,
    out: Annotated[Path, typer.Option(help="Folder of the models; made if absent.")] = Path("out/models"),
    workers: Annotated[int, typer.Option(help="Processes; the models do not depend on them.")] = 2,
    check: Annotated[
        int | None,
        typer.Option(
            help="Flights of other seeds in each environment, on which false alarms of each model are counted.",
            show_default="a tenth of --flights, 1 to 10",
        ),
    ] = None,
    environments: Annotated[
        str,
        typer.Option(
            help="Where the missions are flown, separated by commas: --flights in each. By default training, and for "
            "limits factory, too."
        ),
    ] = "",
    check_environments: Annotated[
        str, typer.Option(help="Where false alarms are counted; where the missions are flown by default.")
    ] = "",
    as_json: options.AsJson = False,
) -> None:
    """Fly error-free missions, and fit the detectors to them.

    By default in randomised worlds that are not used for evaluation. Ctrl-C stops (exit code 130); the same command
    resumes.

    Example: [bold]mavfi train --flights 100 --autopilot hardened --out out/models[/bold]
    """
    check_number("--flights", flights, 1, 100_000)
    if check is None:
        check = min(max(flights // 10, 1), _MOST_CHECKS)
    check_number("--check", check, 0, 100_000)
    check_folder(out)

    # slow imports come before the stoppable part, so that Ctrl-C never interrupts an import
    import sklearn.neural_network  # noqa: F401

    from mavfi.campaign.training import count_false_alarms, environments_of, record, training_mission, trainings_of
    from mavfi.detectors.model import Model
    from mavfi.report.progress import Bar

    # environments of the flights; an unknown name is refused before the first of them
    trained_in = _names(environments)
    checked_in = _names(check_environments) or trained_in or environments_of(trainings_of())
    for name in checked_in:
        training_mission(mission, environment=name)

    # fly and fit
    stop_message = f"Stopped. What is flown is kept in {out}; the same command resumes."
    with stoppable(stop_message), Bar("training flights") as bar:
        recorded = record(
            out,
            flights,
            mission,
            workers=workers,
            progress=bar.show,
            environments=trained_in,
        )
    messages = console(error=True)
    with stoppable(stop_message):
        messages.print("fitting the detectors ...")
        files = recorded.fit()
    models = [Model.load(path) for path in files]

    # count false alarms on flights of other seeds
    stop_message = f"Stopped. The models are in {out}; their false alarms are not counted."
    number = check * len(models) * len(checked_in)
    messages.print(f"checking {len(models)} models on {number} flights ...")
    with stoppable(stop_message), Bar("checking flights") as bar:
        counts = count_false_alarms(models, out, check, mission, workers, bar.show, checked_in)
    alarms = [{name: _rate(flights) for name, flights in by_environment.items()} for by_environment in counts]
    if as_json:
        entries = []
        for file, model, rates in zip(files, models, alarms, strict=True):
            false_alarms = {name: asdict(rate) for name, rate in rates.items()}
            entries.append({"file": str(file), **_entry(model), "false_alarms": false_alarms})
        write_json({"models": entries})
        return
    _show(models, alarms, out, flights)


def _names(text: str) -> list[str]:
    """Names in a comma-separated list; an empty name is refused later, like any unknown one."""
    if not text:
        return []
    return [name.strip() for name in text.split(",")]


def _rate(flights: list[tuple[int, float]]) -> EventRate:
    from mavfi.analysis.statistics import event_rate_by_flight

    return event_rate_by_flight([alarms for alarms, _ in flights], [hours for _, hours in flights])


def _entry(model: Model) -> dict[str, Any]:
    """JSON entry of a model: identity, thresholds and provenance."""
    limits = {key: model.parameters[key] for key in ("sigmas", "limit") if key in model.parameters}
    return {
        "kind": model.kind,
        "profile": model.profile,
        "monitored": model.monitored,
        "sha256": model.sha256,
        "thresholds": limits,
        "provenance": model.provenance,
    }


def _show(models: list[Model], alarms: list[dict[str, EventRate]], folder: Path, flights: int) -> None:
    """Print what the models were trained on, and their false alarms by environment."""
    origin = max((model.provenance for model in models), key=lambda provenance: int(provenance["flights"]))
    seeds = origin["seeds"]
    number = origin["flights"]
    of_each = ""
    if number > flights:
        of_each = f", {flights} in each of {origin['environment']}"
    out = console()
    out.print(
        Text(
            f"Trained on {number} error-free flights{of_each}: autopilot {origin['stack']}, {origin['platform']}, "
            f"{origin['planner']}, {origin['v_max']:g} m/s, seeds {min(seeds)} to {max(seeds)}."
        )
    )
    if flights < _ENOUGH_FLIGHTS:
        out.print(Text(f"Too few: the thresholds of fewer than {_ENOUGH_FLIGHTS} flights do not hold.", style="bold"))
    exposure = ", ".join(f"{rate.hours:.2f} h ({name})" for name, rate in alarms[0].items())
    if len(alarms[0]) == 1:
        exposure = exposure.partition(" (")[0]
    shown = titled_table(
        "False alarms per flight hour",
        caption=f"with the 95 % interval, on {exposure} of error-free flight with other seeds\n"
        "thresholds, worlds, hashes: --json",
        caption_justify="left",
        padding=(0, 1, 0, 0),
    )
    for heading in ("detector", "profile"):
        shown.add_column(heading, no_wrap=True)
    for name in alarms[0]:
        shown.add_column(f"in {name}", justify="right")
    for model, rates in zip(models, alarms, strict=True):
        shown.add_row(model.kind, model.profile, *(rate.text or "not counted" for rate in rates.values()))
    out.print(shown)
    out.print(Text(f"The models are in {folder}."), soft_wrap=True)
