"""Tables in the terminal: no word is broken, nothing is lost, at any width that holds the longest word."""

from io import StringIO

import pytest
from rich.console import Console

from mavfi.analysis.table import Table
from mavfi.report.text import rendered

RUN = "sparse-10016-fi-collision_check-16-1f14e4b6"
TABLE = Table.of_text(
    "Lines",
    ("kernel", "rate", "run", "worst flight time"),
    [("collision_check", "12.0 [3.0, 44.0] 1/9", RUN, "+12.5 %"), ("pid", "—", RUN, "—")],
    (),
)


def printed(table, width):
    console = Console(file=StringIO(), width=width)
    console.print(rendered(table, console.width))
    return console.file.getvalue()


@pytest.mark.parametrize("width", [140, 90, 80, 76, 62])
def test_no_word_is_broken(width):
    shown = printed(TABLE, width)
    assert all(len(line) <= width for line in shown.splitlines())
    shown_words = shown.split()
    for cell in (*(column.heading for column in TABLE.columns), *(cell for row in TABLE.rows for cell in row)):
        assert set(cell.split()) <= set(shown_words), cell


def test_rows_that_begin_alike_are_grouped():
    table = Table.of_text("T", ("environment", "n"), [("sparse", "1"), ("sparse", "2"), ("dense", "3")], ())
    assert printed(table, 80).count("sparse") == 1


def test_markup_in_cells_is_text():
    assert "[r9]" in printed(Table.of_text("[r8]", ("[a]",), [("[r9]",)], ()), 80)
