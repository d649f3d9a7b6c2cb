"""The HTML report for `mavfi report`: chooses runs, flies them again, hands all to the page."""

from collections.abc import Generator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.executors.executor import map_each
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.mission import host_of
from mavfi.campaign.replay import explain
from mavfi.campaign.run import stored_campaign
from mavfi.campaign.store import FILE, Store
from mavfi.campaign.telling import ordered, partner
from mavfi.cli.flight_pages import page_of_explanation
from mavfi.cli.progress import Bar
from mavfi.errors import BadInputError
from mavfi.reports.campaign_report import Report
from mavfi.reports.html.flight_page import FlightPage
from mavfi.reports.html.report_page import LARGEST, Part, sections_of, write_report_page

Case = tuple[str, str | None]
"""A run, and one with the same fault in another setting; None = there is none."""

_SMALLEST = 30_000
"""About the smallest page of a flight with its golden run (bytes)."""


def write_html(path: Path, directory: Path, report: Report, flights: int | None, workers: int) -> int:
    """Write the page of a campaign, with flights that are flown again.

    Args:
        path: File to write.
        directory: Of the ledger.
        report: Its report.
        flights: At most so many; None = as many as fit.
        workers: Processes that fly.

    Returns:
        Number of flights in the page.
    """
    cases = _cases(directory, report, flights)
    executor = LocalExecutor(min(workers, max(1, len(cases))))
    part = Part(directory, report)
    with Bar("flights of the page") as bar, closing(_flown(directory, cases, executor, bar)) as pages:
        return write_report_page(path, [part], sections_of(report), commands(directory), pages)


def _cases(directory: Path, report: Report, most: int | None) -> list[Case]:
    """Runs for the page, those first that say most; none where runs cannot be flown again."""
    frame = report.runs.frame
    with Store.open(directory) as store:
        deterministic = host_of(stored_campaign(store)).deterministic
    most = LARGEST // _SMALLEST if most is None else most
    chosen = ordered(frame)[:most] if deterministic and report.runs.has_missions else []
    return [(run_id, partner(frame, run_id)) for run_id in chosen]


def _flown(
    directory: Path, cases: Sequence[Case], executor: LocalExecutor, bar: Bar
) -> Generator[tuple[str, FlightPage], None, None]:  # fmt: skip
    """Pages in the order of the cases, whichever worker is done first."""
    done: dict[Case, FlightPage] = {}
    waiting = iter(cases)
    case = next(waiting, None)
    for count, (flown, page) in enumerate(map_each(executor, partial(_page, directory), cases), start=1):
        done[flown] = page
        bar.show(count, len(cases))
        while case is not None and case in done:
            yield case[0], done.pop(case)
            case = next(waiting, None)


def _page(directory: Path, case: Case) -> FlightPage:
    run_id, other = case
    return page_of_explanation(directory, explain(directory, run_id), other, directory)


def commands(directory: Path) -> list[tuple[str, str]]:
    """How to repeat a campaign and its report."""
    return [
        *_flying(directory),
        (f"Check {FILE}, and fly a share of it again", f"mavfi campaign verify {directory} --share 0.02"),
        ("Write this page", f"mavfi report {directory} --html report.html"),
    ]


def _flying(directory: Path) -> list[tuple[str, str]]:
    """The command that flies a campaign, where it is a shipped one at one of its sizes."""
    with Store.open(directory) as store:
        held = stored_campaign(store)
    try:
        shipped = load_campaign(held.name)
    except BadInputError:
        return []
    for scale in ("quick", *shipped.scales):
        if _same(shipped.at_scale(scale), held):
            command = f"mavfi campaign run {held.name} --scale {scale} --out {directory}"
            return [("Fly the campaign, or what is left of it", command)]
    return []


def _same(first: Campaign, second: Campaign) -> bool:
    """Whether two campaigns fly the same; the sizes that they could have do not matter."""
    return first.model_dump(exclude={"scales"}) == second.model_dump(exclude={"scales"})
