"""The levels side by side, from the pages of results."""

import pytest

from tools.fault_levels import HEADINGS, level_table


@pytest.fixture(scope="module")
def rows():
    """Cells by level."""
    lines = level_table().strip().splitlines()
    cells = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in (lines[0], *lines[2:])]
    assert cells[0] == list(HEADINGS)
    return {one[0]: dict(zip(HEADINGS, one, strict=True)) for one in cells[1:]}


def count(cell):
    return int(cell.split()[-1])


def test_there_is_a_row_for_each_level_and_policy(rows):
    assert [name.split(",")[0] for name in rows] == ["instruction (IR)", "instruction (IR)", "state", "register"]


@pytest.mark.parametrize("name", ["instruction (IR), node restarts", "register, firmware"])
def test_every_fault_has_one_outcome(rows, name):
    outcomes = [rows[name][one] for one in ("masked", "other result", "crash", "hang", "exception")]
    assert sum(count(cell) for cell in outcomes if cell != "–") == int(rows[name]["n"])
