"""The report of a campaign: report.md, figures, a block for the results page, and all numbers as JSON."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import date
from itertools import takewhile
from pathlib import Path
from typing import Any

from mavfi.analysis import views_for
from mavfi.analysis.findings import findings
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import TEXT, Table
from mavfi.errors import write_text
from mavfi.record import plain
from mavfi.report.figures import draw
from mavfi.report.text import (
    checks,
    differing_null_runs,
    header,
    markdown_grid,
    null_line,
    shown,
    versions,
)

REMARKS = (
    "Rates are conditional on one fault per mission.",
    "Recomputation is charged in the platform's modelled time; nothing was measured on that hardware.",
    "Faults without a site and faults that were not activated are kept in every rate (intention to treat).",
)


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
    found = report_of(Runs.read(directory))
    today = date.today().isoformat()
    captions = draw(found.runs, directory)
    texts = {
        "report.md": _markdown(found, captions, today),
        "summary.json": json.dumps({"date": today, **found.to_json()}, indent=1, allow_nan=False) + "\n",
    }
    if found.tables:
        texts["readme_block.md"] = _readme_block(found.runs, found.tables[0], today)
    for name, content in texts.items():
        write_text(directory / name, content)
    return replace(found, files=tuple(directory / name for name in (*texts, *captions)))


def _markdown(found: CampaignReport, captions: Mapping[str, str], today: str) -> str:
    """The complete report in Markdown, with figures and captions."""
    first, *rest = header(found.runs.campaign)
    parts = [
        f"# {first[0].upper()}{first[1:]}",
        _list([*rest, f"report of {today}"]),
        *(["## Findings", _list(found.findings)] if found.findings else []),
        *(f"![{name}]({name})\n\n{caption}" for name, caption in captions.items()),
        *map(markdown_table, found.tables),
        "## Checks",
        *checks(found.runs),
        "## Remarks",
        _list(REMARKS),
    ]
    return "\n\n".join(parts) + "\n"


def _readme_block(runs: Runs, table: Table, today: str) -> str:
    """The leading table of a report, with campaign, versions, digest and notes."""
    c = runs.campaign
    own, *others = versions(c)
    head = (
        f"Generated on {today} by {own} ({', '.join(others)}): {'; '.join([c['title'], *c['lines']])}; "
        f"{c['done']} runs, digest `{c['digest'][:16]}`."
    )
    parts = [f"**{table.title}**", head, _grid(table), _list(table.notes)]
    return "\n\n".join(parts + ([null_line(runs)] if len(runs.null) else [])) + "\n"


def markdown_table(table: Table) -> str:
    """Format a table with its notes in Markdown."""
    return "\n\n".join(part for part in (f"## {table.title}", _grid(table), _list(table.notes)) if part)


def _grid(table: Table) -> str:
    """Format the cells; a first cell equal to the one above is left empty."""
    columns, rows = shown(table)
    firsts = [row[0] for row in rows]
    found = (["" if row[0] == above else row[0], *row[1:]] for row, above in zip(rows, ["", *firsts], strict=False))
    texts = sum(1 for _ in takewhile(lambda column: column.form == TEXT, columns))
    return markdown_grid([column.heading for column in columns], found, max(2, table.keys, texts))


def _list(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)
