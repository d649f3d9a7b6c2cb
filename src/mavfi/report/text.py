"""Formatting of numbers, sentences and tables, shared by all reports."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console, Group, JustifyMethod
from rich.markup import escape
from rich.panel import Panel
from rich.table import Table as RichTable
from rich.text import Text

from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import EventRate, Rate
from mavfi.analysis.table import (
    ESTIMATE,
    PER_HOUR,
    PERCENT,
    PERCENT_TEST,
    POINTS,
    POINTS_TEST,
    RATE,
    SIGNED,
    SMALL,
    TEXT,
    TIMES_TEST,
    Cell,
    Column,
    Table,
)
from mavfi.report.numbers import ABSENT as ABSENT
from mavfi.report.numbers import percent as percent
from mavfi.report.numbers import signed_percent


def _small_percent(share: float) -> str:
    """A share as per cent with three significant digits."""
    return f"{100 * share:.3g} %"


def _interval(found: Rate) -> str:
    if found.low is None or found.high is None:
        return ""
    return f"[{100 * found.low:.1f}, {100 * found.high:.1f}]"


def _p(found: Any) -> str:
    if found.p_value is None:
        return ""
    return f" p = {found.p_value:.2g}"


def rate(found: Rate | float | None) -> str:
    """A rate in per cent with its interval and n: "93.3 [78.7, 98.2] 28/30"; a weighted rate has no count: "n=30".

    A float is a published rate: "93.3".
    """
    if isinstance(found, float):
        return f"{100 * found:.1f}"
    if found is None or found.rate is None:
        return ABSENT
    if found.successes is None:
        count = f"n={found.n}"
    else:
        count = f"{found.successes}/{found.n}"
    return f"{100 * found.rate:.1f} {_interval(found)} {count}"


def number(value: float | None, digits: int = 1) -> str:
    """A number without a unit."""
    if value is None:
        return ABSENT
    return f"{value:.{digits}f}"


def _per_hour(found: EventRate) -> str:
    if found.per_hour is None:
        return ABSENT
    return f"{found.per_hour:.1f} [{found.low:.1f}, {found.high:.1f}]"


FORMS: dict[str, Callable[[Any], str]] = {
    RATE: rate,
    PERCENT: lambda share: percent(share.rate if isinstance(share, Rate) else share),
    "percent with interval": lambda found: f"{percent(found.rate)} {_interval(found)}",
    POINTS: lambda found: f"{100 * (found.rate or 0.0):+z.1f} {_interval(found)}",
    POINTS_TEST: lambda found: f"{100 * found.rate:+z.1f} {_interval(found)}{_p(found)}",
    PERCENT_TEST: lambda found: f"{percent(found.rate)} {_interval(found)}{_p(found)}",
    TIMES_TEST: lambda found: f"{found.rate:.2f}× [{found.low:.2f}, {found.high:.2f}]{_p(found)}",
    SIGNED: signed_percent,
    "signed points": lambda share: f"{100 * share:+z.1f}",
    SMALL: _small_percent,
    PER_HOUR: _per_hour,
    ESTIMATE: lambda found: f"{found.value:.1e} [{found.low:.1e}, {found.high:.1e}]",
    "number .1f kJ": lambda joule: f"{joule / 1000:.1f} kJ",
}
"""Formatter by display format; other formats are "number", optionally with a Python format and a unit."""


def cell(value: Cell, form: str) -> str:
    """Format a cell in the display format of its column; text is returned unchanged."""
    if value is None:
        return ABSENT
    if isinstance(value, str):
        return value
    if form in FORMS:
        return FORMS[form](value)
    kind, _, rest = form.partition(" ")
    digits, _, unit = rest.partition(" ")
    if kind == "number" and digits:
        return f"{value:{digits}}{unit and ' ' + unit}"
    return str(value)


def shown(table: Table) -> tuple[list[Column], list[list[str]]]:
    """Visible columns of a table, and their cells as text."""
    places = [place for place, column in enumerate(table.columns) if not column.hidden]
    columns = [table.columns[place] for place in places]
    return columns, [[cell(row[place], table.columns[place].form) for place in places] for row in table.rows]


def header(campaign: Mapping[str, Any]) -> list[str]:
    """Header lines of a report: campaign (from `analysis.runs.describe`), progress, digest, versions, caveats."""
    lines = [
        campaign["title"],
        *campaign["lines"],
        f"{campaign['done']} of {campaign['total']} runs done · digest {short(campaign['digest'])}…",
        " · ".join(versions(campaign)),
    ]
    if campaign["on_design_seeds"]:
        lines.append("Flown on design seeds: no figure for publication.")
    if campaign["done"] < campaign["total"]:
        lines.append("Not complete: what follows is of the runs that are done.")
    return lines


def short(digest: str) -> str:
    """The digits of a digest that are shown, at the end of a study and in README.md alike."""
    return digest[:16]


def versions(campaign: Mapping[str, Any]) -> list[str]:
    """Versions of the packages that determine the bits of a flight, mavfi first."""
    ordered = sorted(campaign["versions"].items(), key=lambda item: item[0] != "mavfi")
    return [f"{name} {version}" for name, version in ordered]


def differing_null_runs(runs: Runs) -> list[str]:
    """Ids of the null runs that differ from their golden runs."""
    return [row["run_id"] for row in runs.null if row["effect"] != "masked"]


def null_line(runs: Runs) -> str:
    """Line on whether the null runs equal their golden runs."""
    count = len(runs.null)
    differing = differing_null_runs(runs)
    if not count:
        return "Null runs: none flown."
    if not differing:
        return f"Null runs: all {count} with an empty mask have the digest of their golden runs."
    return f"Null runs: {len(differing)} of {count} DIFFER from their golden runs: {', '.join(differing)}"


def checks(runs: Runs) -> list[str]:
    """Lines on the null runs and, if there are any, on runs that could not be judged (a defect)."""
    unknown = runs.where(judged=False)["run_id"]
    lines = [null_line(runs)]
    if unknown:
        lines.append(f"Unknown: {len(unknown)} runs could not be judged: {', '.join(unknown[:5])}")
    return lines


def markdown_grid(headings: Sequence[str], rows: Iterable[Iterable[str]], left: int | None = None) -> str:
    """A Markdown table; columns behind the first `left` are aligned to the right, None = none."""
    count = len(headings) if left is None else left
    lines = [headings, ["---"] * count + ["---:"] * (len(headings) - count), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


# ---- in a terminal ---------------------------------------------------------------------------------------------------

_BETWEEN = 2
"""Spacing of columns (characters)."""
_NUMBER = Column("number", "#")


def show_header(lines: Sequence[str], console: Console) -> None:
    """Print the lines of `text.header` in a frame."""
    first, *rest = lines
    inside = Group(*(Text(line, style="dim") for line in rest))
    title = f"[bold]{escape(first)}[/bold]"
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
        columns = [_NUMBER, *columns]
        rows = [[str(i), *row] for i, row in enumerate(rows, start=1)]
        keys = [0]
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
    least = []
    whole = []
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
    blocks = []
    own = list(keys)
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
    given = list(least)
    left = width - _room(least)
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
