"""A report as Markdown, and the block of it that the results page shows."""

from collections.abc import Iterable, Mapping, Sequence

from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.table import Table
from mavfi.reports.text import checks, header, null_line, shown, versions

REMARKS = (
    "Rates are conditional on one fault per mission.",
    "Recomputation is charged in the platform's modelled time; nothing was measured on that hardware.",
    "Faults without a site and faults that were not activated are kept in every rate (intention to treat).",
)


def report(
    runs: Runs, tables: Sequence[Table], findings: Sequence[str], figures: Mapping[str, str], date: str
) -> str:  # fmt: skip
    """The whole report; `figures` holds the caption of each file that was drawn."""
    first, *rest = header(runs.campaign)
    parts = [
        f"# {first[0].upper()}{first[1:]}", _list([*rest, f"report of {date}"]),
        *(["## Findings", _list(findings)] if findings else []),
        *(f"![{name}]({name})\n\n{caption}" for name, caption in figures.items()), *map(markdown_table, tables),
        "## Checks", *checks(runs), "## Remarks", _list(REMARKS),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def readme_block(runs: Runs, table: Table, date: str) -> str:
    """The table that leads a report, with what one must know to read it."""
    c = runs.campaign
    own, *others = versions(c)
    head = (
        f"Generated on {date} by {own} ({', '.join(others)}): {'; '.join([c['title'], *c['lines']])}; "
        f"{c['done']} runs, digest `{c['digest'][:16]}`."
    )
    parts = [f"**{table.title}**", head, _grid(table), _list(table.notes)]
    return "\n\n".join(parts + ([null_line(runs)] if len(runs.null) else [])) + "\n"


def markdown_table(table: Table) -> str:
    """One table with its notes."""
    return "\n\n".join(part for part in (f"## {table.title}", _grid(table), _list(table.notes)) if part)


def _grid(table: Table) -> str:
    """The cells; in a row the first cell is empty where it is that of the row above."""
    columns, rows = shown(table)
    left = max(2, table.keys)
    lines = [_row([column.heading for column in columns]), _row(["---"] * left + ["---:"] * (len(columns) - left))]
    before = ""
    for row in rows:
        lines.append(_row(["" if row[0] == before else row[0], *row[1:]]))
        before = row[0]
    return "\n".join(lines)


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _list(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)
