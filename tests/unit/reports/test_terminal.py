"""Tables in the terminal: names stay whole where the line is long enough."""

from collections import Counter
from io import StringIO

import pytest
from rich.console import Console

from mavfi.reports.table import Table
from mavfi.reports.terminal import rendered

RUN = "sparse-10016-fi-collision_check-16-1f14e4b6"
TABLE = Table("Lines", ("kernel", "rate", "run"), (("collision_check", "12.0 [3.0, 44.0] 1/9", RUN),), ())


def printed(width):
    console = Console(file=StringIO(), width=width)
    console.print(rendered(TABLE, console.width))
    return console.file.getvalue()


@pytest.mark.parametrize("width", [90, 80, 76])
def test_names_are_not_broken_where_rates_can_be(width):
    assert RUN in printed(width)
    assert "collision_check" in printed(width)
    assert all(len(line) <= width for line in printed(width).splitlines())


def test_nothing_is_lost_in_a_narrow_terminal():
    shown = printed(40)
    assert max(map(len, shown.splitlines())) <= 40
    told = "".join((TABLE.title, *TABLE.columns, *TABLE.rows[0]))
    assert letters(shown) == letters(told)


def letters(text):
    """How often each letter and digit is there."""
    return Counter(filter(str.isalnum, text))
