"""`mavfi bench`: compare detectors and recovery schemes on the same flights and faults; measure their overhead."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from mavfi.cli import options
from mavfi.cli.console import check_number, console, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError, not_known
from mavfi.files import check_folder

if TYPE_CHECKING:
    from mavfi.analysis.table import Table
    from mavfi.extras.bench.bench import Bench
    from mavfi.extras.bench.leaderboard import BenchFlights

HELP_PANEL = "Detectors"
_DEFAULT_BENCH = "mavfi-bench-1"
app = typer.Typer(
    help="Compare detectors on the same flights and faults.\n\n"
    "Example: [bold]mavfi bench detectors --level state[/bold]",
    no_args_is_help=False,
)


@app.callback()
def _bench() -> None:
    pass


@app.command("detectors")
def detectors(  # noqa: PLR0913 - one parameter per option
    bench: Annotated[
        str, typer.Argument(metavar="[BENCH.yaml]", help="A YAML file, or a shipped bench.")
    ] = _DEFAULT_BENCH,
    level: Annotated[
        list[str] | None,
        typer.Option(help="Only faults of this level: state, message, memory, instruction, sensor; may be repeated."),
    ] = None,
    part: Annotated[
        list[str] | None, typer.Option(help="Only this part of the bench; may be given several times.")
    ] = None,
    scheme: Annotated[
        list[str] | None, typer.Option(help="Only this scheme of the bench; may be given several times.")
    ] = None,
    detector: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="This one, e.g. package:Class, in the place of the bench's schemes.",
            autocompletion=options.complete_detector,
        ),
    ] = None,
    profile: Annotated[str | None, typer.Option(help="Of --detector: paper or tuned.", show_default="paper")] = None,
    models: options.Models = None,
    scale: Annotated[str, typer.Option(help="quick, or paper: enough for narrow intervals.")] = "quick",
    out: Annotated[
        Path | None, typer.Option(help="Folder of ledgers and leaderboard; out/bench-SCALE[-NAME] by default.")
    ] = None,
    workers: options.Workers = 2,
    everything: Annotated[
        bool, typer.Option("--all", help="Print all columns and notes, not only what decides.")
    ] = False,
    as_json: options.AsJson = False,
) -> None:
    """Fly every scheme of a bench on the same faults; print the missions recovered by each, and its false alarms.

    Ctrl-C stops (exit code 130); the same command resumes.

    Example: [bold]mavfi bench detectors --level state --detector my_package:MyDetector[/bold]
    """
    from mavfi.extras.bench.bench import load_bench, select_parts
    from mavfi.extras.bench.leaderboard import BenchFlights, default_folder, write_leaderboard
    from mavfi.extras.bench.verdict import results_of, sentences

    # Check the options, and select schemes and parts.
    whole_bench = load_bench(bench)
    flown_bench = _with_requested_schemes(whole_bench, scale, scheme, detector, profile)
    flown_parts = select_parts(flown_bench, scale, levels=level or (), parts=part or (), models_dir=models)
    user_schemes: Sequence[str] = ()
    if detector or scheme:
        user_schemes = tuple(flown_bench.arms)
    if out is None:
        out = default_folder(scale, user_schemes)
    check_folder(out)

    # Fly, and write the tables; a bench with other schemes than its own is shown beside its own.
    flights = BenchFlights(whole_bench, flown_parts, scale, out)
    with stoppable(f"Stopped. What is done is kept in {out}; the same command resumes."):
        flights.fly(workers, models)
        scores_by_arm = flights.scores(workers, models)
    tables = flights.tables(scores_by_arm)
    compared_tables = tables
    if user_schemes:
        compared_tables = {name: flights.beside_others(name, table) for name, table in tables.items()}
    own_command = _command(bench, level or (), part or (), scale, "my_package:MyDetector")
    write_leaderboard(flights, tables, compared_tables, scores_by_arm, own_command)
    if as_json:
        write_json({name: table.to_json() for name, table in tables.items()})
        return

    # The verdict comes first: a sentence on each part.
    for name, table in compared_tables.items():
        for sentence in sentences(results_of(table), user_schemes):
            console().print(Text(f"{name}: {sentence}"))
        if user_schemes and name in flights.parts and table is tables[name]:
            command = _command(bench, (), [name], scale)
            advice = (
                f"  Compared with nothing yet: `{command}` flies the bench's own schemes on these faults; this command "
                "then shows them, too."
            )
            console().print(Text(advice))
    console().print()
    if everything:
        _show_all(list(compared_tables.values()))
    else:
        _show_short(flights, tables, compared_tables, user_schemes)
    console().print(Text(f"The tables are in {out / 'leaderboard.md'}."), soft_wrap=True)


def _with_requested_schemes(
    bench: "Bench", scale: str, schemes: list[str] | None, detectors: list[str] | None, profile: str | None
) -> "Bench":
    """The bench with the schemes or detectors that the options select; refuses options that do not go together."""
    from mavfi.extras.bench.bench import scales, with_only, with_schemes

    if scale not in scales(bench):
        raise BadInputError(f"--scale: bench {bench.name}: {not_known(scale, scales(bench))}")
    if schemes and detectors:
        raise BadInputError("--scheme and --detector: allowed: one of them")
    if profile is not None and not detectors:
        raise BadInputError(f"--profile: {profile!r}: allowed: with --detector; a scheme of the bench has its own")
    if schemes:
        return with_schemes(bench, schemes)
    if detectors:
        return with_only(bench, detectors, profile or "paper")
    return bench


def _show_short(
    flights: "BenchFlights",
    tables: "Mapping[str, Table]",
    compared_tables: "Mapping[str, Table]",
    user_schemes: Sequence[str],
) -> None:
    """Print what decides, with remarks on the faults, schemes that are not flown, and rows that are not flown here."""
    from mavfi.extras.bench.verdict import short_table

    for name, table in compared_tables.items():
        console().print(short_table(table, user_schemes))
        if table is not tables[name]:
            console().print(Text(table.notes[0], style="dim"))  # which rows are published ones
        if name in flights.parts:
            for remark in flights.remarks(name):
                console().print(Text(remark, style="dim"))
        console().print()
    console().print(
        Text("late, back: late missions in time again; alarm after: median, from the fault on", style="dim")
    )
    console().print(Text("All columns, and what they mean: --all.", style="dim"))


def _show_all(tables: "Sequence[Table]") -> None:
    """Print whole tables; a note that several of them share is printed once, below the last of them."""
    from mavfi.report.text import show_table

    for number, table in enumerate(tables):
        later_notes = {note for later_table in tables[number + 1 :] for note in later_table.notes}
        notes = tuple(note for note in table.notes if note not in later_notes)
        show_table(replace(table, notes=notes), console())


def _command(bench: str, levels: Sequence[str], parts: Sequence[str], scale: str, detector: str = "") -> str:
    """The command that flies parts of a bench with a detector; without one, with the bench's own schemes."""
    words = ["mavfi", "bench", "detectors"]
    if bench != _DEFAULT_BENCH:
        words.append(bench)
    for level in levels:
        words += ["--level", level]
    for part in parts:
        words += ["--part", part]
    if detector:
        words += ["--detector", detector]
    if scale != "quick":
        words += ["--scale", scale]
    return shlex.join(words)


@app.command("overheads")
def overheads(
    directory: options.Ledger,
    missions: Annotated[int, typer.Option(help="Golden flights per environment and arm.")] = 3,
    as_json: options.AsJson = False,
) -> None:
    """Measure the time overhead of a campaign's detectors on this machine, and print it as the paper's Table II.

    Golden flights run in a single process so that they do not disturb the timing. The result is saved in the campaign's
    folder and shown in its overhead table from then on.

    Example: [bold]mavfi bench overheads out/reproduce[/bold]
    """
    from mavfi.analysis.runs import Runs
    from mavfi.analysis.views import table
    from mavfi.campaign.ledger import stored_campaign
    from mavfi.campaign.store import Store
    from mavfi.extras.paper.overheads import measure, save
    from mavfi.report.progress import Bar
    from mavfi.report.text import show_table

    check_number("--missions", missions, 1, 1000)
    with Store.open(directory) as store:
        campaign = stored_campaign(store)
        models = store.models_dir
    with stoppable("Stopped. Nothing is written."), Bar("timed flights") as bar:
        measured = measure(campaign, missions, models, bar.show)
    path = save(measured, directory)
    shares = table(Runs.read(directory), "overheads_as_in_the_paper")
    if as_json:
        write_json(shares.to_json())
        return
    show_table(shares, console())
    console().print(Text(f"The measured shares are in {path}."), soft_wrap=True)
