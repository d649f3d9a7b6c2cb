"""A report as Markdown, and the block of it that the README shows."""

from collections.abc import Iterable, Mapping

from mavfi.reports.header import each, header, null_line
from mavfi.reports.table import Table
from mavfi.reports.tables import Analysis, tables

FIGURES = {
    "success.png": "Success with 95 % intervals (sign + exponent); black: the paper's figure.",
    "flight_time.png": "Share of missions that arrived, by flight time over the golden twin's; failures never arrive.",
    "states.png": "Share of missions that fail or take more than 5 % longer, by what was struck (sign + exponent).",
    "flight.png": "One telling run.",
}
"""What a report may draw, and what it says below it."""


def report(analysis: Analysis, figures: Iterable[str], date: str, captions: Mapping[str, str]) -> str:
    """The whole report.

    Args:
        analysis: As of `mavfi.campaign.analysis.analyse`.
        figures: Names of the files that were drawn.
        date: Of the report.
        captions: Instead of the default ones, by file.
    """
    first, *rest = header(analysis)
    parts = [f"# {first[0].upper()}{first[1:]}", "\n".join(f"- {line}" for line in [*rest, f"report of {date}"])]
    parts += [f"![{name}]({name})\n\n{captions.get(name, FIGURES[name])}" for name in figures]
    parts += [markdown_table(table) for table in tables(analysis)]
    parts += ["## Checks", null_line(analysis), "## Remarks", "\n".join(f"- {line}" for line in analysis["remarks"])]
    return "\n\n".join(parts) + "\n"


def readme_block(analysis: Analysis, date: str) -> str:
    """The success table with what one must know to read it."""
    c = analysis["campaign"]
    table = tables(analysis)[0]
    versions = ", ".join(f"{name} {version}" for name, version in sorted(c["versions"].items()) if name != "mavfi")
    head = (
        f"Generated on {date} by mavfi {c['versions']['mavfi']} ({versions}): campaign `{c['name']}`, stack "
        f"`{c['stack']}`, platform `{c['platform']}`, planner `{c['planner']}`, {c['flights']} missions "
        f"per environment (seeds {c['seeds'][0]} to {c['seeds'][1]}), {c['faults']} faults per {each(analysis)}, "
        f"{c['done']} flights, digest `{c['digest'][:16]}`."
    )
    parts = [f"**{table.title}**", head, _grid(table), _notes(table)]
    return "\n\n".join(parts + ([null_line(analysis)] if analysis["null_check"]["n"] else [])) + "\n"


def markdown_table(table: Table) -> str:
    """One table with its notes."""
    return "\n\n".join(part for part in (f"## {table.title}", _grid(table), _notes(table)) if part)


def _grid(table: Table) -> str:
    lines = [_row(table.columns), _row(["---", "---", *(["---:"] * (len(table.columns) - 2))])]
    before = ""
    for row in table.rows:
        lines.append(_row(["" if row[0] == before else row[0], *row[1:]]))
        before = row[0]
    return "\n".join(lines)


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _notes(table: Table) -> str:
    return "\n".join(f"- {note}" for note in table.notes)
