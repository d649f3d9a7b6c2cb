"""A report in the terminal."""

from rich import box
from rich.console import Console, Group
from rich.markup import escape
from rich.panel import Panel
from rich.table import Table as RichTable
from rich.text import Text

from mavfi.reports.header import header, null_line
from mavfi.reports.table import Table
from mavfi.reports.tables import Analysis, tables

_BETWEEN = 2
"""Characters between two columns."""


def show(analysis: Analysis, console: Console) -> None:
    """Print the tables of an analysis; those of single environments and fields are in the file only.

    Args:
        analysis: As of `mavfi.campaign.analysis.analyse`.
        console: Where to.
    """
    first, *rest = header(analysis)
    console.print(Panel(Group(*(Text(line, style="dim") for line in rest)), title=f"[bold]{escape(first)}[/bold]",
                        title_align="left", box=box.ROUNDED, expand=False))  # fmt: skip
    for table in tables(analysis):
        if not table.detail:
            console.print(rendered(table, console.width))
            for note in table.notes:
                console.print(Text(note, style="dim"))
            console.print()
    console.print(null_line(analysis))


def rendered(table: Table, width: int) -> RichTable:
    """One table; rows that begin with the same cell are grouped.

    Args:
        table: Of a report.
        width: Characters of a line; where they suffice, columns of single words stay whole: names can be copied.
    """
    lines = (table.columns, *table.rows)
    words = [max((len(word) for line in lines for word in line[place].split()), default=0)
             for place in range(len(table.columns))]  # fmt: skip
    whole = sum(words) + _BETWEEN * len(words) + 1 <= width
    shown = RichTable(title=escape(table.title), title_style="bold", title_justify="left", box=box.SIMPLE_HEAD,
                      pad_edge=False, padding=(0, 1, 0, 0))  # fmt: skip
    for place, heading in enumerate(table.columns):
        shown.add_column(escape(heading), justify="left" if place < 2 else "right", overflow="fold",
                         no_wrap=whole and not any(" " in row[place] for row in table.rows))  # fmt: skip
    before = None
    for row in table.rows:
        if before is not None and row[0] != before:
            shown.add_section()
        shown.add_row("" if row[0] == before else f"[bold]{escape(row[0])}[/bold]", *map(escape, row[1:]))
        before = row[0]
    return shown
