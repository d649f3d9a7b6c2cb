"""A rate that is copied from a table or sentence has its n, its interval, and the rate without a fault beside it."""

import csv
import re

import pytest

from mavfi.analysis.findings import findings
from mavfi.analysis.table import PERCENT, RATE
from mavfi.analysis.views import VIEWS, applicable
from mavfi.report.text import ABSENT, cell
from tests.core.architecture.source import ROOT

COMPLETE = re.compile(r"-?[\d.]+ \[[-\d.]+, [-\d.]+\] (\d+/\d+|n=\d+)")
TABLES = sorted((ROOT / "docs" / "results" / "tables").rglob("*.csv"))


def test_each_rate_of_a_table_has_interval_and_n(fake):
    rates = 0
    for view in applicable(fake):
        table = view.table(fake)
        for row in table.entries():
            for column in table.columns:
                value = row[column.key]
                if column.form not in (RATE, PERCENT) or value is None or column.key.startswith("paper"):
                    continue
                text = cell(value, column.form)
                is_published = isinstance(value, float)
                assert text == ABSENT or is_published or COMPLETE.fullmatch(text), (view.name, column.key, text)
                rates += 1
    assert rates > 50


def test_each_table_of_success_with_a_fault_has_that_without_one(fake):
    seen = []
    for view in applicable(fake):
        table = view.table(fake)
        shows_success = any(column.form == RATE and column.key.startswith("success") for column in table.columns)
        if not table.rows or not shows_success:
            continue
        has_golden = any("golden" in str(key).lower() for row in table.rows for key in row[: table.keys + 1])
        has_note = any(note.startswith("success without a fault: ") for note in table.notes)
        assert has_golden or has_note, view.name
        seen.append(view.name)
    assert len(seen) > 3 and "by_field" in VIEWS


def test_each_rate_of_a_sentence_has_its_interval_and_n(fake):
    for sentence in findings(fake):
        for number in re.finditer(r"(?<![-+\d.])\d+\.\d %", sentence):
            assert sentence[number.end() :].startswith(" ["), sentence
        if "%" in sentence and "+" not in sentence:
            assert re.search(r"n = \d+|of \d+", sentence), sentence


@pytest.mark.parametrize("path", TABLES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_each_bound_of_a_shipped_table_has_its_other_end_and_n(path):
    with path.open(encoding="utf-8", newline="") as file:
        columns = next(csv.reader(file), [])
    for name in columns:
        key, _, end = name.rpartition("_")
        if end not in ("low", "high"):
            continue
        assert f"{key}_low" in columns and f"{key}_high" in columns, name
