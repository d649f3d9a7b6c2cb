"""`mavfi runs | compare | replay | explain | shrink`: the runs of campaigns, and one of them flown again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from mavfi.cli import options
from mavfi.cli.console import PAGES, PICTURES, answer, check_file, console, say_written, write_json
from mavfi.errors import MavfiError

if TYPE_CHECKING:
    from mavfi.analysis.table import Table
    from mavfi.campaign.replay import Replay
    from mavfi.campaign.shrink import CandidateFlight, Shrunk

HELP_PANEL = "Campaigns"


def runs(
    directory: options.Ledger,
    failed: Annotated[bool, typer.Option("--failed", help="Only missions that did not succeed.")] = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="All columns as comma-separated values.")] = False,
    as_json: options.AsJson = False,
) -> None:
    """List the runs of a campaign: fault, effect, mission status.

    Example: [bold]mavfi runs out/states --failed[/bold]
    """
    from mavfi.analysis.listing import listing
    from mavfi.analysis.runs import Runs
    from mavfi.report.text import show_table

    table = listing(Runs.read(directory), failed=failed, in_words=not as_csv and not as_json)
    if as_csv:
        answer(table.to_csv(), end="")
    elif as_json:
        write_json(table.to_json())
    else:
        out = console()
        show_table(_fitted(_with_short_ids(table), out.width), out)


def _with_short_ids(table: Table) -> Table:
    """A list of runs whose ids have no hash, where that tells them apart."""
    column = [column.key for column in table.columns].index("run_id")
    ids = [row[column].rpartition("-")[0] for row in table.rows]
    if len(set(ids)) < len(ids):
        return table
    rows = [(*row[:column], short, *row[column + 1 :]) for row, short in zip(table.rows, ids, strict=True)]
    return replace(table, rows=rows)


def _fitted(table: Table, width: int) -> Table:
    """A list of runs in one block: with the first columns that fit into a width; the reason always, as a note."""
    from mavfi.report.text import SPACING, shown

    headings, cells = shown(table)
    columns = []
    notes = list(table.notes)
    is_complete = True
    for index, column in enumerate(headings):
        texts = [row[index] for row in cells]
        width -= SPACING + max(map(len, [column.heading, *texts]))
        is_complete = is_complete and width >= 0
        if column.key == "reason":
            notes += [f"# {row[0]}: {text}" for row, text in zip(cells, texts, strict=True) if text]
        elif not is_complete:
            columns.append(column.key)
    if not is_complete:
        notes.append("More columns: in a wider terminal, or with --csv.")
    hidden = {*columns, "reason"}
    shown_columns = [replace(column, hidden=column.hidden or column.key in hidden) for column in table.columns]
    return replace(table, columns=tuple(shown_columns), notes=tuple(notes))


def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="Folder of a ledger.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Folder of another one.")],
    require: options.Require = None,
    as_json: options.AsJson = False,
) -> None:
    """Compare two campaigns: failures, flight time and energy.

    Runs with the same seed and fault are compared in pairs, others as independent samples; intervals are 95 %. Exit
    code 3: a requirement does not hold.

    Example: [bold]mavfi compare out/before out/after --require 'B.lost - A.lost < 2 %'[/bold]
    """
    from mavfi.analysis.comparison import compare as compare_runs
    from mavfi.analysis.requirements import judge_campaigns
    from mavfi.analysis.runs import Runs
    from mavfi.campaign.requirement import Requirement
    from mavfi.cli.campaign import exit_unless_all_hold, show_verdicts
    from mavfi.report.text import show_table

    # what cannot be judged is refused before anything is printed
    requirements = [Requirement.parse(text).of_campaigns() for text in require or ()]
    runs_a = Runs.read(first)
    runs_b = Runs.read(second)
    verdicts = judge_campaigns(runs_a, runs_b, requirements)
    comparison = compare_runs(runs_a, runs_b)
    if as_json:
        data = {"a": str(first), "b": str(second), **comparison.to_json()}
        if verdicts:
            data["requirements"] = [verdict.to_json() for verdict in verdicts]
        write_json(data)
        exit_unless_all_hold(verdicts)
        return
    for sentence in comparison.sentences:
        console().print(sentence, markup=False)
    console().print(f"\nA: {first}\nB: {second}", markup=False, soft_wrap=True)
    for key, (value_a, value_b) in comparison.differing.items():
        console().print(f"   {key}: {value_a} in A, {value_b} in B", markup=False)
    if comparison.are_same:
        for note in comparison.notes:
            console().print(note, style="dim", markup=False)
    else:
        console().print()
        show_table(comparison.table, console())
    show_verdicts(verdicts)
    exit_unless_all_hold(verdicts)


def replay(directory: options.Ledger, run_id: options.RunId, as_json: options.AsJson = False) -> None:
    """Fly a run again, and check that its digest is the same.

    It is flown from its specification. Exit code 1 if the flights differ.

    Example: [bold]mavfi replay out/reproduce sparse-10003-golden-[/bold]
    """
    from mavfi.campaign.replay import replay as fly_again

    again = fly_again(directory, run_id)
    record = again.record
    if as_json:
        write_json(_replay_json(again))
    else:
        end = record.status.replace("_", " ") or record.error
        console().print(Text.assemble((again.run.spec.run_id, "bold"), f": {end}"), soft_wrap=True)
    if not again.same:
        stored = "none"
        if again.run.record is not None:
            stored = again.run.record.digest or again.run.record.error
        reason = "bits are the same only with the same lock file, on x86-64 Linux"
        if not again.is_replayable:
            reason = "not replayable: the fault was in a live process, or in a kernel whose memory belongs to a library"
        raise MavfiError(f"{directory}: another run: {record.digest or 'no flight'}; stored: {stored}; {reason}")
    if not as_json:
        digest = record.digest or "no flight, as stored"
        console().print(Text.assemble(("✓", "green"), f" the same run, bit for bit: {digest}"))


def _replay_json(again: Replay) -> dict[str, Any]:
    """A replayed run beside its stored record, as plain data."""
    record = again.record
    data = {
        "run_id": again.run.spec.run_id,
        "same": again.same,
        "digest": record.digest,
        "stored_digest": None,
        "status": record.status,
        "stored_status": None,
        "replayable": again.is_replayable,
        "flight_time_s": record.flight_time_s,
    }
    stored = again.run.record
    if stored is not None:
        data["stored_digest"] = stored.digest
        data["stored_status"] = stored.status
    return data


def explain(
    directory: options.Ledger,
    run_id: options.RunId,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw both flights: injection, alarms, where they part.")
    ] = None,
    html: options.Html = None,
    as_json: options.AsJson = False,
) -> None:
    """Explain what the fault of a run did to values and mission.

    The run and its golden run are flown again.

    Example: [bold]mavfi explain out/reproduce dense-10000-fi-planning-0[/bold]
    """
    check_file("--picture", picture, PICTURES)
    check_file("--html", html, PAGES)
    from mavfi.campaign.replay import explain as fly_both
    from mavfi.cli.flight_text import story_table
    from mavfi.report.explain import detector_name, lines, to_json
    from mavfi.report.picture import draw_flight

    explanation = fly_both(directory, run_id)
    if picture is not None:
        draw_flight(picture, explanation.flight, explanation.golden, detector=detector_name(explanation.spec))
    if html is not None:
        from mavfi.analysis.listing import partner
        from mavfi.analysis.runs import Runs
        from mavfi.report.html.flight_page import page_of_explanation, write_flight_page

        other = partner(Runs.read(directory).frame, explanation.spec.run_id)
        write_flight_page(html, page_of_explanation(directory, explanation, other, directory))
    if as_json:
        write_json(to_json(explanation))
        return
    console().print(story_table(lines(explanation)))
    say_written(picture, html)


def shrink(
    directory: options.Ledger,
    run_id: options.RunId,
) -> None:
    """Make the fault of a lost mission as small as possible.

    It becomes shorter, flips fewer bits, or a less significant one. Prints the command that flies the smallest fault
    found that still loses the mission.

    Example: [bold]mavfi shrink out/reproduce dense-10000-fi-planning-0[/bold]
    """
    from mavfi.campaign.shrink import shrink as make_smaller
    from mavfi.cli.flight_text import story_table

    progress = console(error=True)
    with progress.status("flying candidates ..." if progress.is_terminal else "") as status:
        shrunk = make_smaller(directory, run_id, lambda count: status.update(f"{count} candidates flown"))
    out = console()
    out.print(story_table(shrink_lines(shrunk)))
    out.print(f"to fly it   {command(shrunk)}", soft_wrap=True, markup=False, highlight=False)  # one line, to be copied


def command(shrunk: Shrunk) -> str:
    """Command that flies the smallest fault."""
    from mavfi.campaign.ledger import stored_campaign
    from mavfi.campaign.store import Store
    from mavfi.faults.fault import find_level
    from mavfi.report.html.flight_page import fly_command

    spec = shrunk.spec
    with Store.open(shrunk.directory) as store:
        campaign = stored_campaign(store)
    overrides = campaign.arms[spec.arm].mission if spec.arm in campaign.arms else {}
    mission = campaign.spec(spec.environment, spec.seed, overrides)
    fault = shrunk.smallest.fault
    profile = spec.detector_profile if spec.model else None
    level = find_level(fault.level)
    return fly_command(mission, level.text_of(fault), level.seed_of(fault), spec.detector or "none", profile, None)


# ---- results of `campaign.shrink` as text --------------------------------------------------------------------------

_STEPS = {
    "publications": "fewer wrong publications",
    "width": "one bit instead of several",
    "bit": "a bit that changes the value less",
}


def shrink_lines(shrunk: Shrunk) -> list[tuple[str, str]]:
    """Headings and sentences: the smallest fault, the original, steps, golden run."""
    rows = [("smallest", _trial(shrunk.smallest)), ("original", _trial(shrunk.original))]
    heading = "steps"
    for step in shrunk.steps:
        result = "none loses the mission" if step.smaller is None else _trial(step.smaller)
        rows.append((heading, f"{_STEPS.get(step.what, step.what)}, {step.tried} tried: {result}"))
        heading = ""  # only above the first step
    golden = shrunk.golden.log
    rows.append(("golden run", f"{golden.status.words} after {float(golden.column('time')[-1]):.2f} s"))
    return rows


def _trial(trial: CandidateFlight) -> str:
    from mavfi.levels.level import text_of
    from mavfi.report.numbers import outcome

    text = text_of(trial.fault)
    end = f"{trial.status.replace('_', ' ')} after {trial.time_s:.2f} s"
    if trial.injection is None:
        return f"{text}: {end}"
    return f"{text}: {outcome(trial.injection)}, {end}"
