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


def test_a_mission_of_which_a_node_dies_succeeds_only_if_it_restarts(rows):
    restarts, ends = (rows[f"instruction (IR), {policy}"] for policy in ("node restarts", "mission ends with its node"))
    assert restarts["n, missions"] == ends["n, missions"]
    assert count(restarts["mission succeeds"]) > count(ends["mission succeeds"])


def test_a_mission_with_a_masked_fault_in_the_firmware_succeeds(rows):
    assert count(rows["register, firmware"]["mission succeeds"]) >= count(rows["register, firmware"]["masked"])
