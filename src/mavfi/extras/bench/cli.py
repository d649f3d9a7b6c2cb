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
from mavfi.errors import BadInputError, write_text
from mavfi.files import check_folder, is_file

if TYPE_CHECKING:
    from mavfi.analysis.table import Table
    from mavfi.extras.bench.bench import Bench, Entry
    from mavfi.extras.bench.scores import Scores

_BENCH = "mavfi-bench-1"
app = typer.Typer(
    help="Compare schemes on the same flights and faults.\n\nExample: [bold]mavfi bench detectors --level state[/bold]",
    no_args_is_help=False,
)


@app.callback()
def _bench() -> None:
    pass


@app.command("detectors")
def detectors(  # noqa: PLR0913 - one parameter per option
    bench: Annotated[str, typer.Argument(metavar="[BENCH.yaml]", help="A YAML file, or a shipped bench.")] = _BENCH,
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
        typer.Option(metavar="NAME", help="This one, e.g. package:Class, in the place of the bench's schemes."),
    ] = None,
    profile: Annotated[str | None, typer.Option(help="Of --detector: paper or tuned.", show_default="paper")] = None,
    models: options.Models = None,
    scale: Annotated[str, typer.Option(help="quick, or paper: enough for narrow intervals.")] = "quick",
    out: Annotated[
        Path | None, typer.Option(help="Folder of ledgers and leaderboard; out/bench-SCALE[-NAME] by default.")
    ] = None,
    workers: options.Workers = 2,
    as_json: options.AsJson = False,
) -> None:
    """Fly every scheme of a bench on the same faults; print the missions recovered by each, and its false alarms.

    Ctrl-C stops (exit code 130); the same command resumes.

    Example: [bold]mavfi bench detectors --level state --detector my_package:MyDetector[/bold]
    """
    from mavfi.extras.bench.bench import entries, load_bench, scales, with_only, with_schemes
    from mavfi.extras.bench.leaderboard import leaderboard

    chosen = load_bench(bench)
    if scale not in scales(chosen):
        raise BadInputError(
            f"--scale: {scale!r}: not known in bench {chosen.name}; allowed: {', '.join(scales(chosen))}"
        )
    if scheme and detector:
        raise BadInputError("--scheme and --detector: allowed: one of them")
    if profile is not None and not detector:
        raise BadInputError(f"--profile: {profile!r}: allowed: with --detector; a scheme of the bench has its own")
    if scheme:
        chosen = with_schemes(chosen, scheme)
    if detector:
        chosen = with_only(chosen, detector, profile or "paper")
    flown = entries(chosen, scale, levels=level or (), parts=part or (), models_dir=models)
    out = out or Path("out") / "-".join(["bench", scale, *(chosen.arms if detector or scheme else ())])
    check_folder(out)
    with stoppable(f"Stopped. What is done is kept in {out}; the same command resumes."):
        _fly(flown, out, workers, models)
        scored = _scores(flown, out, workers, models)
    tables = {name: _table(chosen, name, entry, out / name, scale) for name, entry in flown.items()}
    own = tables = tables | _score_tables(flown, scored)
    if detector or scheme:
        tables = {name: _beside(chosen, name, found, out / name, scale) for name, found in own.items()}
    command = _command(bench, level or (), part or (), scale)
    _write(own, scored, leaderboard(tables, chosen.name, scale, command), out)
    if as_json:
        write_json({name: table.to_json() for name, table in own.items()})
        return
    _show(tables, out)


def _command(bench: str, levels: Sequence[str], parts: Sequence[str], scale: str) -> str:
    """The command that flies the same parts of the same bench with a custom detector."""
    words = ["mavfi", "bench", "detectors", *([] if bench == _BENCH else [bench])]
    words += [word for level in levels for word in ("--level", level)]
    words += [word for part in parts for word in ("--part", part)]
    words += ["--detector", "my_package:MyDetector", *([] if scale == "quick" else ["--scale", scale])]
    return shlex.join(words)


def _beside(bench: "Bench", name: str, own: "Table", ledger: Path, scale: str) -> "Table":
    """The table with the published rows, if the faults are the published ones."""
    from mavfi.extras.bench.bench import frozen_faults, published_rows
    from mavfi.extras.bench.leaderboard import beside_published

    faults = ledger / "faults.csv"
    if not is_file(faults) or faults.read_text(encoding="utf-8") != frozen_faults(bench, name, scale):
        return own
    return beside_published(own, published_rows(bench, name, scale), bench.name)


def _fly(flown: "Mapping[str, Entry]", out: Path, workers: int, models: Path | None) -> None:
    """Fly the parts together: those that fly the same missions share their golden flights."""
    from mavfi.campaign.executors.local import LocalExecutor
    from mavfi.campaign.run import run_campaigns
    from mavfi.cli.progress import Bar

    names = list(flown)
    with Bar(f"bench: {names[0] if len(names) == 1 else f'{len(names)} parts'}", "runs") as bar:
        run_campaigns(
            {out / name: entry.campaign for name, entry in flown.items()}, executor=LocalExecutor(workers),
            models_dir=models, progress=bar.show_campaigns,
        )  # fmt: skip


def _score_tables(flown: "Mapping[str, Entry]", scored: "Mapping[str, Scores]") -> "dict[str, Table]":
    """The table from the scores: detection at fixed rates of false alarms."""
    from mavfi.extras.bench.bench import SCORES
    from mavfi.extras.bench.scores import table, unscored

    if not scored:
        return {}
    judged = {name: entry.campaign for name, entry in flown.items() if entry.part.scores}
    return {SCORES: table(scored, list(judged), unscored(judged.values(), scored))}


def _scores(
    flown: "Mapping[str, Entry]", out: Path, workers: int, models: Path | None
) -> "dict[str, Scores]":  # fmt: skip
    """Scores of the detectors, in the parts with `scores` enabled."""
    from mavfi.campaign.executors.local import LocalExecutor
    from mavfi.cli.progress import Bar
    from mavfi.extras.bench.scores import scores

    own = [out / name for name, entry in flown.items() if entry.part.scores]
    if not own:
        return {}
    with Bar("bench: scores of all detectors", "missions") as bar:
        return scores(own, LocalExecutor(workers), models, bar.show)


def _table(bench: "Bench", name: str, entry: "Entry", ledger: Path, scale: str) -> "Table":
    """The table of a part, with notes on agreement with the frozen faults and on omitted schemes."""
    from mavfi.analysis import Runs, table
    from mavfi.extras.bench.bench import checksum, faults_of, frozen_faults

    runs = Runs.read(ledger)
    faults = faults_of(ledger)
    write_text(ledger / "faults.csv", faults)
    frozen = frozen_faults(bench, name, scale)
    same = {None: "no list of them is published", faults: f"as published in {bench.name}"}
    drawn = f"{faults.count(chr(10)) - 1} faults, sha256 {checksum(faults)[:16]}…: "
    drawn += same.get(frozen, f"NOT those published in {bench.name} (sha256 {checksum(frozen or '')[:16]}…)")
    reasons = {
        reason: [arm for arm in entry.left_out if entry.left_out[arm] == reason] for reason in entry.left_out.values()
    }
    left_out = [f"{', '.join(arms)}: not flown ({reason})" for reason, arms in reasons.items()]
    found = table(runs, entry.part.view)
    return replace(found, name=name, title=entry.part.title, notes=(drawn, *left_out, *found.notes))


def _write(own: "Mapping[str, Table]", scored: "Mapping[str, Scores]", page: str, out: Path) -> None:
    from mavfi.extras.bench.leaderboard import draw_curves

    texts = {"leaderboard.md": page, **{f"{name}.csv": table.to_csv() for name, table in own.items()}}
    if scored:
        draw_curves(scored, out / "curves.png")
    for name, content in texts.items():
        write_text(out / name, content)


def _show(tables: "Mapping[str, Table]", out: Path) -> None:
    from mavfi.report.text import show_table

    terminal = console()
    names = list(tables)
    for name, table in tables.items():
        later = {note for other in names[names.index(name) + 1 :] for note in tables[other].notes}  # shared ones once
        show_table(replace(table, notes=tuple(note for note in table.notes if note not in later)), terminal)
    terminal.print(Text(f"The tables are in {out / 'leaderboard.md'}."), soft_wrap=True)


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
    from mavfi.analysis import Runs, table
    from mavfi.campaign.ledger import stored_campaign
    from mavfi.campaign.store import Store
    from mavfi.cli.progress import Bar
    from mavfi.extras.paper.overheads import measure, save
    from mavfi.report.text import show_table

    check_number("--missions", missions, 1, 1000)
    with Store.open(directory) as store:
        campaign, models = stored_campaign(store), store.models_dir
    with stoppable("Stopped. Nothing is written."), Bar("timed flights") as bar:
        measured = measure(campaign, missions, models, bar.show)
    path = save(measured, directory)
    found = table(Runs.read(directory), "overheads_as_in_the_paper")
    if as_json:
        write_json(found.to_json())
        return
    show_table(found, console())
    console().print(Text(f"The measured shares are in {path}."), soft_wrap=True)
