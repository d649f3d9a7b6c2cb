"""`mavfi runs | replay | explain | shrink`: the runs of a campaign, and one of them flown again."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from mavfi.cli import options
from mavfi.cli.console import PAGES, PICTURES, check_file, console, write_json
from mavfi.errors import MavfiError

if TYPE_CHECKING:
    from mavfi.campaign.shrink import Shrunk

from mavfi.campaign.shrink import CandidateFlight, Shrunk
from mavfi.levels.level import text_of
from mavfi.report.numbers import change


def runs(
    directory: options.Ledger,
    failed: Annotated[bool, typer.Option("--failed", help="Only missions that did not succeed.")] = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="All columns as comma-separated values.")] = False,
    as_json: options.AsJson = False,
) -> None:
    """List the runs of a campaign: fault, effect, and mission status.

    Example: [bold]mavfi runs out/states --failed[/bold]
    """
    from mavfi.analysis.listing import listing
    from mavfi.analysis.runs import Runs
    from mavfi.report.text import show_table

    table = listing(Runs.read(directory), failed=failed)
    if as_csv:
        typer.echo(table.to_csv(), nl=False)
    elif as_json:
        write_json(table.to_json())
    else:
        show_table(table, console())


def replay(directory: options.Ledger, run_id: options.RunId, as_json: options.AsJson = False) -> None:
    """Replay a run from its specification, and report whether the digest is the same.

    Exit code 1 if it is another run.

    Example: [bold]mavfi replay out/reproduce sparse-10003-golden-[/bold]
    """
    from mavfi.campaign.replay import replay as fly_again

    found = fly_again(directory, run_id)
    record = found.record
    stored = found.run.record
    injections = () if stored is None else stored.injections
    replayable = all(injection.details.get("replayable", True) for injection in injections)
    ended = record.status.replace("_", " ") or record.error
    if as_json:
        write_json(
            {
                "run_id": found.run.spec.run_id,
                "same": found.same,
                "digest": record.digest,
                "stored_digest": None if stored is None else stored.digest,
                "status": record.status,
                "stored_status": None if stored is None else stored.status,
                "replayable": replayable,
                "flight_time_s": record.flight_time_s,
            }
        )
    else:
        console().print(Text.assemble((found.run.spec.run_id, "bold"), f": {ended}"), soft_wrap=True)
    if not found.same:
        held = "none" if stored is None else stored.digest or stored.error
        why = "bits are the same only with the same lock file, on x86-64 Linux"
        if not replayable:
            why = "not replayable: the fault was in a live process, or in a kernel whose memory belongs to a library"
        raise MavfiError(f"{directory}: another run: {record.digest or 'no flight'}; stored: {held}; {why}")
    if not as_json:
        console().print(
            Text.assemble(("✓", "green"), f" the same run, bit for bit: {record.digest or 'no flight, as stored'}")
        )


def explain(
    directory: options.Ledger,
    run_id: options.RunId,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw both flights: injection, alarms, where they part.")
    ] = None,
    html: options.Html = None,
    as_json: options.AsJson = False,
) -> None:
    """Replay a run and its golden run, and explain the effect of the fault on values, path and mission.

    Example: [bold]mavfi explain out/reproduce dense-10000-fi-planning-0[/bold]
    """
    check_file("--picture", picture, PICTURES)
    check_file("--html", html, PAGES)
    from mavfi.campaign.replay import explain as fly_both
    from mavfi.cli.flight_text import story_table
    from mavfi.report.explain import detector_name, lines, to_json
    from mavfi.report.picture import draw_flight

    found = fly_both(directory, run_id)
    if picture is not None:
        draw_flight(picture, found.flight, found.golden, detector=detector_name(found.spec))
    if html is not None:
        from mavfi.analysis.listing import partner
        from mavfi.analysis.runs import Runs
        from mavfi.report.html.flight_page import page_of_explanation, write_flight_page

        other = partner(Runs.read(directory).frame, found.spec.run_id)
        write_flight_page(html, page_of_explanation(directory, found, other, directory))
    if as_json:
        write_json(to_json(found))
        return
    out = console()
    out.print(story_table(lines(found)))
    for path in (picture, html):
        if path is not None:
            out.print(f"wrote {path}", style="dim", markup=False)


def shrink(
    directory: options.Ledger,
    run_id: options.RunId,
) -> None:
    """Reduce the fault of a lost mission: shorter, fewer bits, a less significant bit.

    Prints the command that flies the smallest fault found that still loses the mission.

    Example: [bold]mavfi shrink out/reproduce dense-10000-fi-planning-0[/bold]
    """
    from mavfi.campaign.shrink import shrink as make_smaller
    from mavfi.cli.flight_text import story_table
    from mavfi.cli.runs import lines

    progress = console(error=True)
    with progress.status("flying candidates ..." if progress.is_terminal else "") as shown:
        found = make_smaller(directory, run_id, lambda count: shown.update(f"{count} candidates flown"))
    out = console()
    out.print(story_table(lines(found)))
    out.print(f"to fly it   {command(found)}", soft_wrap=True, markup=False, highlight=False)  # one line, to be copied


def command(found: "Shrunk") -> str:
    """Command that flies the smallest fault."""
    from mavfi.campaign.ledger import stored_campaign
    from mavfi.campaign.store import Store
    from mavfi.faults.fault import find_level
    from mavfi.report.html.flight_page import fly_command

    spec = found.spec
    with Store.open(found.directory) as store:
        campaign = stored_campaign(store)
    if spec.arm in campaign.arms:
        overrides = campaign.arms[spec.arm].mission
    else:
        overrides = {}
    mission = campaign.spec(spec.environment, spec.seed, overrides)
    fault = found.smallest.fault
    profile = spec.detector_profile if spec.model else None
    level = find_level(fault.level)
    return fly_command(mission, level.text_of(fault), level.seed_of(fault), spec.detector or "none", profile, None)


# ---- results of `campaign.shrink` as text --------------------------------------------------------------------------

Lines = list[tuple[str, str]]
_WHAT = {
    "publications": "fewer wrong publications",
    "width": "one bit instead of several",
    "bit": "a bit that changes the value less",
}


def lines(found: Shrunk) -> Lines:
    """Headings and sentences: the smallest fault, the original, steps, golden run."""
    rows = [("smallest", _trial(found.smallest)), ("original", _trial(found.original))]
    for place, step in enumerate(found.steps):
        heading = "steps" if place == 0 else ""
        if step.smaller is None:
            end = "none loses the mission"
        else:
            end = _trial(step.smaller)
        rows.append((heading, f"{_WHAT.get(step.what, step.what)}, {step.tried} tried: {end}"))
    golden = found.golden.log
    rows.append(("golden run", f"{golden.status.words} after {float(golden.column('time')[-1]):.2f} s"))
    return rows


def _trial(trial: CandidateFlight) -> str:
    text = text_of(trial.fault)
    end = f"{trial.status.replace('_', ' ')} after {trial.time_s:.2f} s"
    if trial.injection is None:
        return f"{text}: {end}"
    before, after = change(trial.injection.before, trial.injection.after)
    return f"{text}: {before} → {after}, {end}"
