"""Rendering of reports in the terminal."""

from collections.abc import Sequence

from rich import box
from rich.console import Console, Group, JustifyMethod
from rich.markup import escape
from rich.panel import Panel
from rich.table import Table as RichTable
from rich.text import Text

from mavfi.analysis.table import TEXT, Column, Table
from mavfi.report.text import shown

_BETWEEN = 2
"""Spacing of columns (characters)."""
_NUMBER = Column("number", "#")


def show_header(lines: Sequence[str], console: Console) -> None:
    """Print the lines of `text.header` in a frame."""
    first, *rest = lines
    inside, title = Group(*(Text(line, style="dim") for line in rest)), f"[bold]{escape(first)}[/bold]"
    console.print(Panel(inside, title=title, title_align="left", box=box.ROUNDED, expand=False))


def show_table(table: Table, console: Console) -> None:
    """Print a table and its notes."""
    console.print(rendered(table, console.width))
    for note in table.notes:
        console.print(Text(note, style="dim"))
    console.print()


def rendered(table: Table, width: int) -> Group:
    """Render a table in lines of `width` characters; rows with equal first cells are grouped.

    Words are not broken: columns that do not fit continue in further blocks below, which repeat the key columns.
    """
    columns, rows = shown(table)
    keys = list(range(min(table.keys, len(columns))))
    least, whole = _sizes(columns, rows)
    if any(_room([*(least[key] for key in keys), size]) > width for size in least[len(keys) :]):
        # a column does not fit next to the keys: row numbers replace the keys
        columns, rows, keys = [_NUMBER, *columns], [[str(i), *row] for i, row in enumerate(rows, start=1)], [0]
        least, whole = _sizes(columns, rows)
    parts: list[Text | RichTable] = [Text(table.title, style="bold")]  # not wrapped to a narrow table
    for block in _blocks(least, keys, width):
        widths = _widths([least[place] for place in block], [whole[place] for place in block], width)
        cells = [[row[place] for place in block] for row in rows]
        parts.append(_grid([columns[place].heading for place in block], cells, widths, len(keys)))
    return Group(*parts)


def _sizes(columns: Sequence[Column], rows: Sequence[Sequence[str]]) -> tuple[list[int], list[int]]:
    """Minimum widths of columns and full widths (longest cell).

    The minimum is the longest word; for names and for numbers with their units, the longest cell.
    """
    least, whole = [], []
    for place, column in enumerate(columns):
        cells = [column.heading, *(row[place] for row in rows)]
        whole.append(max(map(len, cells)))
        words = max(len(word) for cell in cells for word in cell.split() or [""])
        is_name = column.form == TEXT and not any(" " in cell for cell in cells[1:])
        is_number = column.form.startswith("number")
        least.append(max(words, *map(len, cells[1:])) if is_number and rows else whole[-1] if is_name else words)
    return least, whole


def _blocks(least: Sequence[int], keys: Sequence[int], width: int) -> list[list[int]]:
    """Split columns into blocks that fit the width; each block starts with the keys and has at least one column."""
    blocks, own = [], list(keys)
    for place in range(len(keys), len(least)):
        if len(own) > len(keys) and _room([least[p] for p in (*own, place)]) > width:
            blocks.append(own)
            own = list(keys)
        own.append(place)
    return [*blocks, own]


def _room(widths: Sequence[int]) -> int:
    return sum(widths) + _BETWEEN * len(widths)


def _widths(least: Sequence[int], whole: Sequence[int], width: int) -> list[int]:
    """Widths of columns: the minimum, plus the remaining space, given first to columns that need the least."""
    given, left = list(least), width - _room(least)
    needy = sorted(range(len(least)), key=lambda place: whole[place] - least[place])
    for number, place in enumerate(needy):
        more = max(0, min(whole[place] - given[place], left // (len(needy) - number)))
        given[place] += more
        left -= more
    return given


def _grid(headings: Sequence[str], rows: Sequence[Sequence[str]], widths: Sequence[int], keys: int) -> RichTable:
    grid = RichTable(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for place, (heading, wide) in enumerate(zip(headings, widths, strict=True)):
        justify: JustifyMethod = "left" if place < max(2, keys) else "right"
        grid.add_column(escape(heading), justify=justify, overflow="fold", width=wide)
    grouped = len({row[0] for row in rows}) < len(rows)
    before = None
    for row in rows:
        if grouped and before is not None and row[0] != before:
            grid.add_section()
        grid.add_row("" if row[0] == before else f"[bold]{escape(row[0])}[/bold]", *map(escape, row[1:]))
        before = row[0]
    return grid
