"""The report of a campaign: report.md, figures, a block for the results page, and all numbers as JSON."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import date
from itertools import takewhile
from pathlib import Path
from typing import Any

from mavfi.analysis.findings import findings
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import TEXT, Table
from mavfi.analysis.views import views_for
from mavfi.errors import write_text
from mavfi.record import plain
from mavfi.report.figures import draw
from mavfi.report.text import (
    checks,
    differing_null_runs,
    grouped,
    header,
    markdown_grid,
    null_line,
    shown,
    versions,
)

_REMARKS = (
    "Recomputation is charged in the platform's modelled time; nothing was measured on that hardware.",
    "Faults without a site and faults that were not activated are kept in every rate (intention to treat).",
)


def remarks_on(runs: Runs) -> tuple[str, ...]:
    """What holds of all tables."""
    return f"Rates are conditional on {runs.per_mission} per mission.", *_REMARKS


@dataclass(frozen=True, slots=True)
class CampaignReport:
    """Tables of all applicable views (the leading one first), findings in sentences, and written files."""

    runs: Runs
    tables: tuple[Table, ...]
    findings: tuple[str, ...]
    files: tuple[Path, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain data: `campaign`, `findings`, `null_runs`, `unknown` runs, and `tables` by name."""
        data: dict[str, Any] = plain(
            {
                "campaign": self.runs.campaign,
                "findings": self.findings,
                "null_runs": {"n": len(self.runs.null), "differing": differing_null_runs(self.runs)},
                "unknown": self.runs.where(judged=False)["run_id"],
                "tables": {table.name: table.to_json() for table in self.tables},
            }
        )
        return data


def report_of(runs: Runs) -> CampaignReport:
    """Compute tables and findings of a campaign, without writing files."""
    return CampaignReport(runs, tuple(views_for(runs)), tuple(findings(runs)))


def write_report(directory: Path) -> CampaignReport:
    """Analyse a campaign, and write report.md, readme_block.md, summary.json and PNG figures to its folder.

    Raises:
        BadInputError: The campaign does not exist, or the folder cannot be written.
    """
    report = report_of(Runs.read(directory))
    today = date.today().isoformat()
    captions = draw(report.runs, directory)
    texts = {
        "report.md": _markdown(report, captions, today),
        "summary.json": json.dumps({"date": today, **report.to_json()}, indent=1, allow_nan=False) + "\n",
    }
    if report.tables:
        texts["readme_block.md"] = _readme_block(report.runs, report.tables[0], today)
    for name, content in texts.items():
        write_text(directory / name, content)
    return replace(report, files=tuple(directory / name for name in (*texts, *captions)))


def _markdown(report: CampaignReport, captions: Mapping[str, str], today: str) -> str:
    """The complete report in Markdown, with figures and captions."""
    first, *others = header(report.runs.campaign)
    parts = [f"# {first[0].upper()}{first[1:]}", _list([*others, f"report of {today}"])]
    if report.findings:
        parts += ["## Findings", _list(report.findings)]
    parts += [f"![{name}]({name})\n\n{caption}" for name, caption in captions.items()]
    parts += map(markdown_table, report.tables)
    parts += ["## Checks", *checks(report.runs), "## Remarks", _list(remarks_on(report.runs))]
    return "\n\n".join(parts) + "\n"


def _readme_block(runs: Runs, table: Table, today: str) -> str:
    """The leading table of a report, with campaign, versions, digest and notes."""
    campaign = runs.campaign
    version_of_mavfi, *package_versions = versions(campaign)
    origin = (
        f"Generated on {today} by {version_of_mavfi} ({', '.join(package_versions)}): "
        f"{'; '.join([campaign['title'], *campaign['lines']])}; "
        f"{campaign['done']} runs, digest `{campaign['digest'][:16]}`."
    )
    parts = [f"**{table.title}**", origin, _grid(table), _list(table.notes)]
    if len(runs.null):
        parts.append(null_line(runs))
    return "\n\n".join(parts) + "\n"


def markdown_table(table: Table) -> str:
    """Format a table with its notes in Markdown."""
    return "\n\n".join(part for part in (f"## {table.title}", _grid(table), _list(table.notes)) if part)


def _grid(table: Table) -> str:
    """Format the cells; a first cell equal to the one above is left empty."""
    columns, rows = shown(table)
    cells = [row for row, _ in grouped(rows)]
    # leading columns that are aligned left: those that identify the row, and other texts
    leading_texts = sum(1 for _ in takewhile(lambda column: column.form == TEXT, columns))
    return markdown_grid([column.heading for column in columns], cells, max(2, table.keys, leading_texts))


def _list(lines: Iterable[str]) -> str:
    """Format lines as an unordered list."""
    return "\n".join(f"- {line}" for line in lines)
