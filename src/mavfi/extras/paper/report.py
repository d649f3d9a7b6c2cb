"""The report of a study: sections in order, each with tables, figures and tested claims."""

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

from mavfi.analysis.findings import findings
from mavfi.analysis.listing import with_flights
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import Table
from mavfi.analysis.views import VIEWS, table, views_for
from mavfi.config import parse
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, not_known, write_text, writing
from mavfi.extras.paper.claims import CLAIMS, NOT_TESTED, UNDECIDED, claims_table
from mavfi.extras.paper.provenance import load_runs
from mavfi.extras.paper.study import Study, StudySection
from mavfi.files import LARGEST_TEXT, is_file, read_file
from mavfi.record import plain
from mavfi.report.campaign_report import markdown_table
from mavfi.report.figures import FIGURES, draw, drawing
from mavfi.report.text import cell, checks, markdown_grid, versions

FIGURES_FOLDER = "figures"
TABLES_FOLDER = "tables"
MARKDOWN = "study.md"
JSON = "study.json"
_FINDINGS = "claims"
"""Name of the table of tested findings."""


@dataclass(frozen=True, slots=True)
class SectionReport:
    """A section of the study with its results."""

    definition: StudySection
    runs: Runs | None  # of its campaign, with the flights needed by its figures
    tables: tuple[Table, ...]  # in the order of the section, without empty ones
    captions: Mapping[str, str] = field(default_factory=dict)  # by figure file, relative to the study's folder


@dataclass(frozen=True, slots=True)
class StudyReport:
    """A study with the runs of its campaigns and the results of its sections."""

    study: Study
    campaigns: Mapping[str, Runs]  # by folder
    sections: tuple[SectionReport, ...]
    flown_in: Sequence[Mapping[str, str]]  # see `load_runs`; empty if `mavfi reproduce` did not fly it
    files: tuple[Path, ...] = ()

    @property
    def headline(self) -> list[SectionReport]:
        """Sections marked as headline, shown first; all sections if none is marked."""
        marked = [section for section in self.sections if section.definition.headline and section.tables]
        return marked or list(self.sections)

    @property
    def findings(self) -> dict[str, list[str]]:
        """Findings in sentences by title of their section: tested claims first, then the headline's campaigns."""
        sentences = {}
        for section in self.sections:
            claims = [entry for table in section.tables if table.name == _FINDINGS for entry in table.entries()]
            if claims:
                sentences[section.definition.title] = _verdicts(claims)
        # the findings of a campaign stand in its first section
        first_sections = {}
        for section in reversed(self.headline):
            if section.runs is not None:
                first_sections[section.definition.campaign] = (section.definition.title, section.runs)
        for title, runs in reversed(first_sections.values()):
            lines = findings(runs)
            if lines:
                sentences.setdefault(title, []).extend(lines)
        return sentences

    @property
    def tables(self) -> dict[str, Table]:
        """All tables by name; those of a campaign begin with its name."""
        tables: dict[str, Table] = {}
        for section in self.sections:
            tables |= {_file_of(section, table): table for table in section.tables}
        return tables

    @property
    def programs(self) -> list[str]:
        """The programs that flew the study, with their commits; empty if it was not flown by `mavfi reproduce`."""
        return list(dict.fromkeys(run["program"] for run in self.flown_in))

    @property
    def provenance(self) -> list[str]:
        """Lines on where, when, by which program and with which versions the study was flown."""
        lines = [f"Machine: {name}." for name in dict.fromkeys(run["machine"] for run in self.flown_in)]
        if self.flown_in:
            resumed = ""
            if len(self.flown_in) > 1:
                resumed = f", last resumed {self.flown_in[-1]['begun']} (run {len(self.flown_in)})"
            lines.append(f"Begun {self.flown_in[0]['begun']}{resumed}.")
            lines.append(f"Program: {'; then '.join(self.programs)}.")

        # campaigns of a resumed study may have been flown with different versions: each is named once
        flown_with: dict[str, str] = {}
        for campaign in self.campaigns.values():
            for name, version in campaign.campaign["versions"].items():
                if name not in flown_with:
                    flown_with[name] = version
                elif version not in flown_with[name].split(" and "):
                    flown_with[name] += f" and {version}"
        return [*lines, f"Versions: {', '.join(versions({'versions': flown_with}))}."]

    @property
    def digests(self) -> list[str]:
        """A line for the ledger of each campaign."""
        return [
            f"Digest of the ledger in {folder} ({flown.campaign['name']}): {flown.campaign['digest']}."
            for folder, flown in self.campaigns.items()
        ]

    def to_json(self) -> dict[str, Any]:
        """Plain data: name, campaigns by folder, programs, provenance; the tables are in files of their own."""
        campaigns = {folder: dict(runs.campaign) for folder, runs in self.campaigns.items()}
        data: dict[str, Any] = plain(
            {
                "study": self.study.name,
                "campaigns": campaigns,
                "programs": self.programs,
                "provenance": [*self.provenance, *self.digests],
            }
        )
        return data


def _file_of(section: SectionReport, table: Table) -> str:
    """Name of the file of a table; that of a campaign begins with its name."""
    if section.runs is None:
        return table.name
    return f"{section.runs.campaign['name']}_{table.name}"


def _verdicts(claims: Sequence[Mapping[str, Any]]) -> list[str]:
    """Sentences on tested claims: their number by verdict, and those that were contradicted."""
    counts = Counter(claim["verdict"] for claim in claims)
    parts = ", ".join(f"{counts[verdict]} {verdict}" for verdict in sorted(counts))
    against = "; ".join(claim["statement"] for claim in claims if claim["verdict"] == "contradicted")
    sentences = [f"{len(claims)} claims: {parts}."]
    if against:
        sentences.append(f"Contradicted: {against}.")
    return sentences


def check_names(study: Study, where: str) -> None:
    """Check that all views, figures and claims of a study exist.

    Raises:
        BadInputError: A name is unknown; `where` identifies the study in the message.
    """
    catalogues: dict[str, Mapping[str, Any]] = {"views": VIEWS, "figures": FIGURES, "claims": CLAIMS}
    for section in study.sections:
        used = {
            "views": section.views,
            "figures": section.figures,
            "claims": (*section.claims, *(name for claims in section.claims_at.values() for name in claims)),
        }
        for key, allowed in catalogues.items():
            for name in used[key]:
                if dropped_name(key, name):
                    raise BadInputError(f"{where}: section {section.title!r}: {dropped_name(key, name)}")
                if name not in allowed:
                    raise BadInputError(f"{where}: section {section.title!r}: {key}: {not_known(name, allowed)}")


def study_report(study: Study, folder: Path) -> StudyReport:
    """Compute the tables of a study from its ledgers, and write its figures; no other file is written.

    Args:
        study: The study, with sections in order.
        folder: Folder of its ledgers; figures are written to its subfolder `FIGURES_FOLDER`.

    Raises:
        BadInputError: A campaign does not exist, a name is unknown, or the folder cannot be written.
    """
    campaigns = {name: Runs.read(folder / name) for name in study.campaigns}
    sections = study.sections or _leading_sections(campaigns)
    reports = tuple(_section_report(section, campaigns, folder) for section in sections)
    return StudyReport(study, campaigns, reports, load_runs(folder))


def _leading_sections(campaigns: Mapping[str, Runs]) -> tuple[StudySection, ...]:
    """Sections of a study that defines none: the leading view of each campaign."""
    sections = []
    for name, runs in campaigns.items():
        views = views_for(runs)
        if views:
            sections.append(StudySection(title=views[0].title, campaign=name, views=(views[0].name,)))
    return tuple(sections)


def _section_report(section: StudySection, campaigns: Mapping[str, Runs], folder: Path) -> SectionReport:
    """Compute the tables of a section, and draw its figures."""
    tables = []
    captions: dict[str, str] = {}
    runs = campaigns.get(section.campaign)
    if section.claims:
        tables.append(claims_table(section.claims, campaigns.values(), section.untested))
    if runs is not None:
        tables += [table(runs, name) for name in section.views]
        # some figures draw flights, which are replayed only for them
        flight_ids = [run_id for name in section.figures for run_id in drawing(name).cases(runs)]
        runs = with_flights(runs, folder / section.campaign, flight_ids)
        pictures = folder / FIGURES_FOLDER
        if section.figures:
            with writing(pictures):
                pictures.mkdir(parents=True, exist_ok=True)
        written = draw(runs, pictures, section.figures, f"{runs.campaign['name']}_")
        captions = {f"{FIGURES_FOLDER}/{file}": text for file, text in written.items()}
    return SectionReport(section, runs, tuple(table for table in tables if table.rows), captions)


def write_study(study: Study, scale: str, folder: Path) -> StudyReport:
    """Analyse a study flown at a scale, and write study.md, study.json, tables (CSV) and figures to its folder.

    Raises:
        BadInputError: See `study_report`.
    """
    report = study_report(study, folder)
    files = write_texts(report, scale, folder)
    for section in report.sections:
        files += section.captions
    return replace(report, files=tuple(folder / name for name in files))


def write_texts(report: StudyReport, scale: str, folder: Path) -> list[str]:
    """Write study.md, study.json and tables (CSV) of a study flown at a scale; returns their names.

    Raises:
        BadInputError: A file cannot be written.
    """
    today = date.today().isoformat()
    flown = {"date": today, "scale": scale, "definition": report.study.model_dump(mode="json", exclude_defaults=True)}
    texts = {
        MARKDOWN: _markdown(report, today, scale),
        JSON: json.dumps({**flown, **report.to_json()}, indent=1, allow_nan=False) + "\n",
        **{f"{TABLES_FOLDER}/{name}.csv": table.to_csv() for name, table in report.tables.items()},
    }
    with writing(folder / TABLES_FOLDER):
        (folder / TABLES_FOLDER).mkdir(exist_ok=True)
    for name, content in texts.items():
        write_text(folder / name, content)
    return list(texts)


def stored_study(folder: Path) -> tuple[Study, str] | None:
    """The study that was reported in a folder, and its scale; None if the folder holds no study.

    Raises:
        BadInputError: The file is invalid, or was written by a version that did not store the study.
    """
    path = folder / JSON
    if not is_file(path):
        return None
    try:
        stored = json.loads(read_file(path, LARGEST_TEXT))
        definition = stored["definition"]
        scale = str(stored["scale"])
    except (ValueError, TypeError, KeyError) as error:
        raise BadInputError(f"{path}: is no record of a study ({error!r}); `mavfi reproduce` writes it again") from None
    return parse(Study, definition, f"{path}: definition"), scale


def title_of(study: Study) -> str:
    """Title of a study's report."""
    return study.title or f"Study {study.name}"


def _markdown(report: StudyReport, today: str, scale: str) -> str:
    """What is read first: findings, the leading table of each headline campaign, figures; the rest is linked."""
    head = [f"- {line}" for line in (*report.provenance, *report.digests)]
    for runs in report.campaigns.values():
        if len(runs.null) or runs.where(judged=False)["run_id"]:
            head += [f"- {runs.campaign['name']}: {line}" for line in checks(runs)]
    parts = [f"# {title_of(report.study)}", f"Study {report.study.name}, report of {today}, scale {scale}."]
    parts.append("\n".join(head))
    campaigns_shown = set()
    for section in report.sections:
        definition = section.definition
        parts += [f"## {definition.title}", definition.text]
        for name, caption in section.captions.items():
            parts += [f"![{name}]({name})", caption]

        # the findings, or the first table of a headline campaign
        leading = next(iter(section.tables), None)
        if leading is not None and leading.name == _FINDINGS:
            parts.append(findings_in_short(leading))
        elif leading is not None and section in report.headline and definition.campaign not in campaigns_shown:
            campaigns_shown.add(definition.campaign)
            parts.append(markdown_table(replace(leading, notes=())))

        links = [f"[{part.name}]({TABLES_FOLDER}/{_file_of(section, part)}.csv)" for part in section.tables]
        if links:
            parts.append(f"All rows: {', '.join(links)}.")
    # campaigns share captions and texts: each stands where it is first needed
    return "\n\n".join(part for part in dict.fromkeys(parts) if part) + "\n"


_DETAILS = re.compile(r" \[[^]]*\]| \(n = \d+\)|, \d+ worlds$")
"""Intervals and numbers of flights in a finding: the file of the table has them."""
_TABLE_OF_LEVEL = re.compile(r"^Table I, [^:]*: ")
"""What all findings on Table I of one campaign begin with."""


def findings_in_short(table: Table) -> str:
    """The findings in Markdown, by campaign: verdict, corrected p, and what was measured if it decides."""
    by_campaign: dict[str, list[list[str]]] = {}
    for entry in table.entries():
        statement = _TABLE_OF_LEVEL.sub("", str(entry["statement"]))
        measured = ""
        if entry["verdict"] != UNDECIDED:
            measured = _DETAILS.sub("", str(entry["here"]))
        row = [statement, str(entry["verdict"]), cell(entry["holm_p"], "number .2g"), measured]
        by_campaign.setdefault(str(entry["campaign"]), []).append(row)
    rows = []
    for campaign, findings_of_campaign in by_campaign.items():
        rows += [[f"*campaign {campaign}*", "", "", ""], *findings_of_campaign]
    definition, *others = table.notes
    notes = [definition, *(note for note in others if note.startswith(NOT_TESTED))]
    lines = "\n".join(f"- {note}" for note in notes)
    return f"{markdown_grid(['the paper', 'verdict', 'p (Holm)', 'here'], rows)}\n\n{lines}"
