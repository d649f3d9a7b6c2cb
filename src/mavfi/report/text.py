"""Formatting of numbers, sentences and tables, shared by all reports."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from rich import box
from rich.console import Console, Group, JustifyMethod
from rich.markup import escape
from rich.panel import Panel
from rich.table import Table as RichTable
from rich.text import Text

from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate
from mavfi.analysis.table import (
    DIFFERENCE,
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


def _p(test: Any) -> str:
    """The p value of a test, to be appended; empty if it has none."""
    if test.p_value is None:
        return ""
    return f" p = {test.p_value:.2g}"


def rate(value: Rate | float | None) -> str:
    """A rate in per cent with its interval and n: "93.3 [78.7, 98.2] 28/30"; a weighted rate has no count: "n=30".

    A float is a published rate: "93.3".
    """
    if isinstance(value, float):
        return f"{100 * value:.1f}"
    if value is None or value.rate is None:
        return ABSENT
    count = f"n={value.n}" if value.successes is None else f"{value.successes}/{value.n}"
    return f"{100 * value.rate:.1f} {value.interval} {count}"


def number(value: float | None, digits: int = 1) -> str:
    """A number without a unit."""
    if value is None:
        return ABSENT
    return f"{value:.{digits}f}"


def _small(value: float) -> str:
    """A value of any order of magnitude; 0 is exact."""
    if value == 0.0:
        return "0"
    return f"{value:.1e}"


def _difference(rate: Rate) -> str:
    """A difference in per cent, or in points of it, if its interval shows one; the interval, shortened where wide."""
    if rate.rate is None:
        return ABSENT
    text = f"{100 * rate.rate:+z.1f}"
    if rate.low is None or rate.high is None:
        return f"{text} [?]"
    if rate.low == rate.high == 0.0:
        return "equal"
    if rate.low <= 0.0 <= rate.high:
        text = "not shown"
    low, high = (f"{100 * bound:z.{int(abs(bound) < 0.1)}f}" for bound in (rate.low, rate.high))
    return f"{text} [{low}, {high}]"


FORMS: dict[str, Callable[[Any], str]] = {
    RATE: rate,
    PERCENT: lambda share: percent(share.rate if isinstance(share, Rate) else share),  # measured, or published
    "percent with interval": lambda rate: f"{percent(rate.rate)} {rate.interval}",
    POINTS: lambda rate: f"{100 * (rate.rate or 0.0):+z.1f} {rate.interval}",
    DIFFERENCE: _difference,
    POINTS_TEST: lambda test: f"{100 * test.rate:+z.1f} {test.interval}{_p(test)}",
    PERCENT_TEST: lambda test: f"{percent(test.rate)} {test.interval}{_p(test)}",
    TIMES_TEST: lambda test: f"{test.rate:.2f}× [{test.low:.2f}, {test.high:.2f}]{_p(test)}",
    SIGNED: signed_percent,
    "signed points": lambda share: f"{100 * share:+z.1f}",
    SMALL: lambda share: f"{100 * share:.3g} %",
    PER_HOUR: lambda alarms: alarms.text or ABSENT,
    ESTIMATE: lambda estimate: f"{_small(estimate.value)} [{_small(estimate.low)}, {_small(estimate.high)}]",
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
    visible = [index for index, column in enumerate(table.columns) if not column.hidden]
    columns = [table.columns[index] for index in visible]
    rows = [[cell(row[index], table.columns[index].form) for index in visible] for row in table.rows]
    return columns, rows


def grouped(rows: Iterable[Sequence[str]]) -> Iterator[tuple[list[str], bool]]:
    """Rows, whose first cell is left empty if it equals the one above; whether a further group of such rows begins."""
    above = None
    for first, *others in rows:
        if first == above:
            yield ["", *others], False
        else:
            yield [first, *others], above is not None
        above = first


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
    """Ids of the null runs that differ from their golden runs in the flight, or in the number of alarms."""
    golden_alarms = {(row["environment"], row["seed"], row["arm"]): row["alarms_total"] for row in runs.golden}
    differing = []
    for row in runs.null:
        alarms = golden_alarms.get((row["environment"], row["seed"], row["arm"]))
        if row["effect"] != "masked" or row["alarms_total"] != alarms:
            differing.append(row["run_id"])
    return differing


def null_line(runs: Runs) -> str:
    """Line on whether the null runs equal their golden runs."""
    count = len(runs.null)
    differing = differing_null_runs(runs)
    if not count:
        return "Null runs: none flown."
    if not differing:
        return f"Null runs: all {count} with an empty mask have the digest of their golden runs."
    return f"Null runs: {len(differing)} of {count} DIFFER from their golden runs: {', '.join(differing)}"


def has_failed_checks(runs: Runs) -> bool:
    """Whether null runs differ, or runs could not be judged: what is said before any figure."""
    return bool(differing_null_runs(runs)) or len(runs.where(judged=False)) > 0


def checks(runs: Runs) -> list[str]:
    """Lines on the null runs and, if there are any, on runs that could not be judged (a defect)."""
    unknown = runs.where(judged=False)["run_id"]
    lines = [null_line(runs)]
    if unknown:
        lines.append(f"Unknown: {len(unknown)} runs could not be judged: {', '.join(unknown[:5])}")
    return lines


def markdown_grid(headings: Sequence[str], rows: Iterable[Iterable[str]], left: int | None = None) -> str:
    """A Markdown table; columns behind the first `left` are aligned to the right, None = none."""
    left = len(headings) if left is None else left
    alignment = ["---"] * left + ["---:"] * (len(headings) - left)
    lines = []
    for cells in (headings, alignment, *rows):
        escaped = (text.replace("|", "\\|") for text in cells)
        lines.append(f"| {' | '.join(escaped)} |")
    return "\n".join(lines)


# ---- in a terminal ---------------------------------------------------------------------------------------------------

SPACING = 2
"""Spacing of columns (characters)."""
TITLE_SPACING = 6
"""Of a frame: its corners, and a line and a space on each side of the title (characters)."""
_ROW_NUMBER = Column("number", "#")


def show_header(lines: Sequence[str], console: Console) -> None:
    """Print the lines of `text.header` in a frame."""
    first, *rest = lines
    if len(first) + TITLE_SPACING > console.width:  # a frame would cut it
        first, _, mission = first.partition(" · ")
        rest = [mission, *rest]
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
    limits = _width_limits(columns, rows)
    key_limits = [limits[key] for key in keys]
    if any(_total_width([*key_limits, limit]) > width for limit in limits[len(keys) :]):
        # a column does not fit next to the keys: row numbers replace the keys
        columns = [_ROW_NUMBER, *columns]
        rows = [[str(number), *row] for number, row in enumerate(rows, start=1)]
        keys = [0]
        limits = _width_limits(columns, rows)
    parts: list[Text | RichTable] = [Text(table.title, style="bold")]  # not wrapped to a narrow table
    for block in _blocks(limits, keys, width):
        widths = _widths([limits[index] for index in block], width)
        cells = [[row[index] for index in block] for row in rows]
        parts.append(_grid([columns[index].heading for index in block], cells, widths, len(keys)))
    return Group(*parts)


class _WidthLimits(NamedTuple):
    """Widths of a column (characters): the minimum, and that of its longest cell, beyond which it needs no space."""

    minimum: int
    full: int


def _width_limits(columns: Sequence[Column], rows: Sequence[Sequence[str]]) -> list[_WidthLimits]:
    """Width limits of columns.

    The minimum is the longest word; for names and for numbers with their units, the longest cell.
    """
    limits = []
    for index, column in enumerate(columns):
        cells = [row[index] for row in rows]
        full = max(map(len, [column.heading, *cells]))
        minimum = max(len(word) for text in (column.heading, *cells) for word in text.split() or [""])
        if column.form.startswith("number"):
            minimum = max([minimum, *map(len, cells)])
        elif column.form == TEXT and not any(" " in text for text in cells):
            minimum = full
        limits.append(_WidthLimits(minimum, full))
    return limits


def _blocks(limits: Sequence[_WidthLimits], keys: Sequence[int], width: int) -> list[list[int]]:
    """Split columns into blocks that fit the width; each block starts with the keys and has at least one column."""
    blocks = []
    block = list(keys)
    for index in range(len(keys), len(limits)):
        if len(block) > len(keys) and _total_width([limits[i] for i in (*block, index)]) > width:
            blocks.append(block)
            block = list(keys)
        block.append(index)
    return [*blocks, block]


def _total_width(limits: Sequence[_WidthLimits]) -> int:
    """Width of columns at their minimum, with spacing."""
    return sum(limit.minimum for limit in limits) + SPACING * len(limits)


def _widths(limits: Sequence[_WidthLimits], width: int) -> list[int]:
    """Widths of columns: the minimum, plus the remaining space, given first to columns that need the least."""
    widths = [limit.minimum for limit in limits]
    space = width - _total_width(limits)
    by_need = sorted(range(len(limits)), key=lambda index: limits[index].full - limits[index].minimum)
    for number, index in enumerate(by_need):
        fair_share = space // (len(by_need) - number)
        addition = max(0, min(limits[index].full - widths[index], fair_share))
        widths[index] += addition
        space -= addition
    return widths


def _grid(headings: Sequence[str], rows: Sequence[Sequence[str]], widths: Sequence[int], keys: int) -> RichTable:
    """One block; a first cell equal to the one above is left empty, and a line separates groups of them."""
    grid = RichTable(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for index, (heading, width) in enumerate(zip(headings, widths, strict=True)):
        justify: JustifyMethod = "left" if index < max(2, keys) else "right"
        grid.add_column(escape(heading), justify=justify, overflow="fold", width=width)
    has_groups = any(above[0] == below[0] for above, below in pairwise(rows))
    for (first, *others), begins_group in grouped(rows):
        if has_groups and begins_group:
            grid.add_section()
        first_cell = ""
        if first:
            first_cell = f"[bold]{escape(first)}[/bold]"
        grid.add_row(first_cell, *map(escape, others))
    return grid
