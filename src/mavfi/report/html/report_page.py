"""The report of one or more campaigns as one HTML file: headline, sections, runs, flights."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from mavfi.analysis.runs import Runs
from mavfi.analysis.table import Table
from mavfi.errors import BadInputError, write_text
from mavfi.extras.paper.report import StudyReport
from mavfi.report import style
from mavfi.report.campaign_report import REMARKS, Report
from mavfi.report.figures import FIGURES
from mavfi.report.html import page
from mavfi.report.html.figure_svg import svg_of
from mavfi.report.html.flight_page import FlightPage
from mavfi.report.html.run_list import run_list
from mavfi.report.html.table_data import RunSets, table_data
from mavfi.report.text import checks, header

LARGEST = 15_000_000
"""Maximum size of a page (bytes)."""
_LONG = 30
"""Tables with more rows than this are collapsed."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """A figure of a section."""

    name: str
    figure: Figure
    caption: str


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the page: text, tables and figures."""

    title: str
    tables: Sequence[Table] = ()
    figures: Sequence[Drawn] = ()
    text: str = ""


def drawn(runs: Runs) -> list[Drawn]:
    """All general figures that are applicable to these runs."""
    if not runs.has_missions:
        return []
    return _drawn(runs, [name for name, found in FIGURES.items() if found.general])


def _drawn(runs: Runs, names: Iterable[str]) -> list[Drawn]:
    with style.house_style():
        made = [(name, FIGURES[name].draw(runs)) for name in names]
    return [Drawn(name, figure, FIGURES[name].caption_of(runs)) for name, figure in made if figure is not None]


def sections_of_study(study: StudyReport) -> list[Section]:
    """Sections of a study: the headline, then all sections in order, then the times."""
    found = [
        Section(one.section.title, one.tables, _drawn(one.runs, one.section.figures) if one.runs else (),
                one.section.text)
        for one in study.sections
    ]  # fmt: skip
    leading = [found[study.sections.index(one)] for one in study.headline]
    first = [Section(one.title, one.tables[:1], one.figures[:1]) for one in leading[:1]]
    return [*first, *found, Section("Where the time goes", study.times)]


def drawn_of_study(study: StudyReport) -> list[Drawn]:
    """Figures of a study; their names begin with that of the campaign."""
    return [
        replace(found, name=f"{one.runs.campaign['name']}_{found.name}")
        for one in study.sections
        if one.runs is not None
        for found in _drawn(one.runs, one.section.figures)
    ]


def sections_of(report: Report) -> list[Section]:
    """Sections of a campaign: leading table with leading figure, other figures, and one section per other table."""
    figures, (leading, *others) = drawn(report.runs), report.tables or (None,)
    sections = [] if leading is None else [Section(leading.title, [leading], figures[:1])]
    sections += [Section("Figures", (), figures[1:])] if figures[1:] else []
    return sections + [Section(table.title, [table]) for table in others]


@dataclass(frozen=True, slots=True)
class Part:
    """A campaign of the page, and the folder of its ledger as printed in commands."""

    directory: Path
    report: Report


@dataclass(frozen=True, slots=True)
class Headline:
    """Text of the first screen; findings by heading ("" = none)."""

    kind: str
    title: str
    lines: Sequence[str]
    findings: Mapping[str, Sequence[str]]


def headline_of(report: Report) -> Headline:
    """Headline of a campaign."""
    named, *lines = header(report.runs.campaign)
    campaign, _, mission = named.partition(" · ")
    return Headline("campaign", campaign[0].upper() + campaign[1:], [mission, *lines], {"": report.findings})


def headline_of_study(study: StudyReport) -> Headline:
    """Headline of a study: environments, number of runs by level, provenance; the remarks describe each campaign."""
    campaigns = [runs.campaign for runs in study.campaigns.values()]
    done, total = (sum(campaign[key] for campaign in campaigns) for key in ("done", "total"))
    levels = Counter[str]()
    for runs in study.campaigns.values():
        levels.update(runs.injected["level"])
    golden = sum(len(runs.golden) for runs in study.campaigns.values())
    counts = [f"{golden:,} without a fault", *(f"{n:,} with one at {level} level" for level, n in levels.most_common())]
    nulls = sum(len(runs.where(kind="null")) for runs in study.campaigns.values())
    counts += [f"{nulls:,} as with a fault, but without one (null)"] if nulls else []
    places = dict.fromkeys(
        campaign.get("parts", {}).get(name, {}).get("environment") or name
        for campaign in campaigns for name in campaign["environments"]
    )  # fmt: skip
    lines = [
        f"Missions of an autonomous quadrotor in {', '.join(places)}: at most one flipped bit per mission",
        f"{done:,} of {total:,} runs done in {len(campaigns)} campaigns: {', '.join(counts)}",
        *study.provenance,
    ]
    return Headline("study", f"Study {study.study.name}", lines, study.findings)


def write_report_page(
    path: Path, parts: Sequence[Part], sections: Sequence[Section], commands: Sequence[tuple[str, str]],
    flights: Iterable[tuple[str, FlightPage]] = (), *, headline: Headline | None = None, largest: int = LARGEST,
) -> int:  # fmt: skip
    """Write the page of one or more campaigns.

    Args:
        path: File to write.
        parts: The campaigns.
        sections: Sections in order; the first one is the headline.
        commands: Descriptions and commands that reproduce the results.
        flights: Run ids and pages, the most illustrative first; embedded until the file is full.
        headline: Text of the first screen; by default that of the first campaign.
        largest: Maximum size of the file (bytes).

    Returns:
        Number of flights in the page.

    Raises:
        BadInputError: The file cannot be written, or exceeds the maximum size even without flights.
    """
    reports = [part.report for part in parts]
    listed = run_list({str(part.directory): part.report.runs for part in parts})
    sets = RunSets({run_id: place for place, run_id in enumerate(listed["ids"])})
    numbered = list(_section_data(sections, sets))
    remarks = ["; ".join(header(report.runs.campaign)) for report in reports] if len(reports) > 1 else []
    values: dict[str, Any] = {
        "headline": headline or headline_of(reports[0]), "commands": commands, "sections": numbered,
        "checks": [*remarks, *(line for report in reports for line in checks(report.runs)), *REMARKS],
        "csv": {table["id"]: table.pop("csv") for section in numbered for table in section["tables"]},
        "runs": listed | {"sets": list(sets.texts)},
    }  # fmt: skip
    left = largest - len(page.render("report.html.j2", **values, flights={}).encode())
    if left < 0:
        raise BadInputError(f"{path}: the report takes {largest - left} bytes without any flight; allowed: {largest}")
    stored = _as_fit(flights, left)
    write_text(path, page.render("report.html.j2", **values, flights=stored))
    return len(stored)


def _section_data(sections: Sequence[Section], sets: RunSets) -> Iterator[dict[str, Any]]:
    for place, section in enumerate(sections):
        tables = [table_data(table, sets) for table in section.tables]
        yield {
            "id": f"section-{place}", "title": section.title, "text": section.text,
            "tables": [
                table | {"id": f"{place}-{table['name']}", "long": len(table["rows"]) > _LONG} for table in tables
            ],
            "figures": [
                {"svg": svg_of(one.figure, f"s{place}-{one.name}", one.caption, sets), "caption": one.caption}
                for one in section.figures
            ],
        }  # fmt: skip


def _as_fit(flights: Iterable[tuple[str, FlightPage]], left: int) -> Mapping[str, Markup]:
    """JSON of flights by run id, up to the first one that does not fit; stops iterating there."""
    stored: dict[str, Markup] = {}
    for run_id, flight in flights:
        text = page.as_json(flight.to_json())
        left -= len(text.encode()) + len(run_id) + 100  # including its HTML element
        if left < 0:
            break
        stored[run_id] = text
    return stored
