"""`mavfi explain`: trace the effect of a fault, step by step."""

from pathlib import Path
from typing import Annotated

import typer

from mavfi.cli import options
from mavfi.cli.console import PAGES, PICTURES, check_file, console, write_json


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
        from mavfi.analysis.runs import Runs
        from mavfi.campaign.telling import partner
        from mavfi.cli.flight_pages import page_of_explanation
        from mavfi.report.html.flight_page import write_flight_page

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
